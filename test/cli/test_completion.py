# SPDX-License-Identifier: Apache-2.0
"""Tab completion: what the shells themselves make of the scripts."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from imgu_ros.cli.completion import SHELLS
from imgu_ros.cli.main import COMMANDS, main


@pytest.fixture(scope="module")
def bash_script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("completion") / "imgu.bash"
    done = subprocess.run(
        [sys.executable, "-m", "imgu_ros.cli.main", "--print-completion", "bash"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    path.write_text(done.stdout)
    return path


def completed(script: Path, *words: str) -> set[str]:
    """What bash offers for the last word."""
    quoted = " ".join(f"'{word}'" for word in words)
    code = (
        f"source {script}; COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}; _shtab_imgu imgu '{words[-1]}'; "
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True)
    assert not done.stderr
    return set(done.stdout.split())


def test_commands(bash_script):
    assert completed(bash_script, "imgu", "") >= set(COMMANDS)
    assert completed(bash_script, "imgu", "re") == {"replay"}


def test_options_nodes_and_parameters(bash_script):
    assert {"--target", "--width-m", "--camera-info", "--out"} <= completed(bash_script, "imgu", "replay", "--")
    assert completed(bash_script, "imgu", "node", "per") == {"perception"}
    assert completed(bash_script, "imgu", "replay", "-p", "targets.wid") == {"targets.widths_m:="}


def test_files(bash_script, tmp_path, monkeypatch):
    (tmp_path / "clip.mp4").touch()
    monkeypatch.chdir(tmp_path)
    assert completed(bash_script, "imgu", "replay", "cl") == {"clip.mp4"}


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_reads_its_script(shell, capsys, tmp_path):
    assert main(["--print-completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(command in script for command in COMMANDS)
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    (tmp_path / "script").write_text(script)
    done = subprocess.run([shell, "-n", str(tmp_path / "script")], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_another_shell_is_refused(capsys):
    assert main(["--print-completion", "cmd.exe"]) == 2
    assert "fish" in capsys.readouterr().err


def test_without_shtab_the_message_says_what_to_install(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--print-completion", "bash"]) == 1
    assert "pip install shtab" in capsys.readouterr().err
