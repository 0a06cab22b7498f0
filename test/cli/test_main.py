# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from imgu_ros.cli import main as main_module
from imgu_ros.cli.main import COMMANDS, main
from imgu_ros.errors import ParameterError

HEAVY = ("numpy", "scipy", "cv2", "matplotlib", "jinja2", "tqdm", "rclpy", "rosbags", "yaml")


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch):
    """Install a command `fake` whose run raises or returns what the test says."""

    def install(outcome: object) -> None:
        def run(_: object) -> int:
            if isinstance(outcome, BaseException):
                raise outcome
            return outcome

        module = SimpleNamespace(HELP="a fake", __doc__="A fake.", add_arguments=lambda parser: None, run=run)
        monkeypatch.setitem(main_module.COMMANDS, "fake", "fake_module")
        monkeypatch.setitem(sys.modules, "fake_module", module)

    return install


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"    {name} " in out for name in COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--help"]) == 0
    assert f"imgu {name}" in capsys.readouterr().out


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from imgu_ros.cli.main import main; main(['--help']); "
        f"sys.exit(' '.join(m for m in {HEAVY} if m in sys.modules) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert re.fullmatch(r"imgu_ros \d+\.\d+\.\d+\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ([], "usage: imgu"),
        (["--no-such-option"], "unrecognized arguments"),
        (["replya"], "did you mean replay?"),
        (["replay"], "required"),
        (["replay", "bag", "--ou", "x"], "--out"),
        (["demosaic", "a", "b", "--pattern", "rgbg"], "invalid choice"),
        (["demosaic", "a", "b", "--pattern", "rggb", "--gains", "1,x,2"], "need three numbers"),
    ],
)
def test_wrong_usage_exits_2(argv: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(argv) == 2
    assert said in capsys.readouterr().err


def test_an_error_is_one_line(command, capsys: pytest.CaptureFixture[str]) -> None:
    command(ParameterError("a.b: 3;\nneed 4"))
    assert main(["fake"]) == 1
    assert capsys.readouterr().err == "imgu: error: a.b: 3;\\nneed 4\n"


def test_a_system_error_with_a_file_is_one_line(command, capsys: pytest.CaptureFixture[str]) -> None:
    command(PermissionError(13, "Permission denied", "/some/file"))
    assert main(["fake"]) == 1
    assert capsys.readouterr().err == "imgu: error: /some/file: Permission denied\n"


@pytest.mark.parametrize(
    "error",
    [
        ModuleNotFoundError("No module named 'rclpy'", name="rclpy"),
        ImportError("librmw_fastrtps_cpp.so: cannot open shared object file"),
    ],
)
def test_without_the_ros_extra(command, error: ImportError, capsys: pytest.CaptureFixture[str]) -> None:
    command(error)
    assert main(["fake"]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert 'pip install ".[ros]"' in err


def test_a_bug_keeps_its_traceback(command) -> None:
    command(ModuleNotFoundError("No module named 'imgu_ros.nothing'", name="imgu_ros.nothing"))
    with pytest.raises(ModuleNotFoundError):
        main(["fake"])


def test_interrupt(command, capsys: pytest.CaptureFixture[str]) -> None:
    command(KeyboardInterrupt())
    assert main(["fake"]) == 130
    assert capsys.readouterr().err == "imgu: interrupted\n"


def test_a_reader_that_goes_away_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "imgu_ros.cli.main", "params"],
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
        )
    assert (done.returncode, done.stderr) == (141, "")


def test_opencv_does_not_speak_beside_the_error(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (64, 64), np.uint8)
    (tmp_path / "cut.png").write_bytes(cv2.imencode(".png", noise)[1].tobytes()[:2000])
    command = [sys.executable, "-m", "imgu_ros.cli.main", "match", str(tmp_path / "cut.png"), str(tmp_path / "cut.png")]
    environment = {name: value for name, value in os.environ.items() if name != "OPENCV_LOG_LEVEL"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert done.returncode == 1
    # OpenCV 4 hands libpng's own line through.
    said = [line for line in done.stderr.splitlines() if not line.startswith("libpng")]
    assert len(said) == 1
    assert said[0].startswith("imgu: error: ")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_one_line() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "imgu_ros.cli.main", "params"],
            stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == "imgu: error: output: No space left on device; need room for what is written\n"


def test_what_is_printed_goes_through_one_place() -> None:
    """Where names from outside become harmless; `imgu params --yaml` is for programs, and exact."""
    package = Path(str(main_module.__file__)).parent
    allowed = {("terminal.py", "print"), ("params.py", "write")}
    found = {
        (path.name, name)
        for path in package.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and (name := ast.unparse(node.func).removeprefix("sys.stdout.").removeprefix("sys.stderr."))
        in ("print", "write", "writelines")
    }
    assert found == allowed


@pytest.mark.parametrize(
    "argv",
    [
        ["caf\x1b[2J\udce9"],
        ["replay", "--x\x1b[2J\u202e"],
        ["node", "\x1b[2J"],
        ["warp", "a\x1b[2J", "b.png", "--scale", "2"],
    ],
)
def test_arguments_do_not_act_on_the_terminal(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(argv) in (1, 2)
    said = capsys.readouterr()
    assert "\x1b" not in said.err + said.out and "\u202e" not in said.err


def test_a_terminal_without_the_characters_gets_escapes(tmp_path: Path) -> None:
    (name := tmp_path / "caf\udce9漢\n").mkdir()
    ascii_only = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [sys.executable, "-m", "imgu_ros.cli.main", "replay", os.fsencode(name), "--out", tmp_path / "out"],
        env=os.environ | ascii_only, capture_output=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith(b"imgu: error: ") and done.stderr.count(b"\n") == 1
    assert rb"caf\udce9" in done.stderr and rb"\n" in done.stderr
