# SPDX-License-Identifier: Apache-2.0
"""The environments that the scripts make: chosen interpreter, one installation, recovery; with impostors for Python."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")

#: Behaves like an interpreter as far as environment.sh looks, and writes down what it was asked for.
IMPOSTOR = """#!/usr/bin/env bash
version=$(basename "$0"); version=${version#python}
[[ $version == 3.* ]] || version=%(version)s
case "$*" in
    *ensurepip*) exit %(no_venv)d ;;
    *"print("*) echo "$version" ;;
    *platform*) echo "$version.0" ;;
    *"-m venv"*) mkdir -p "$3/bin"; cp "$0" "$3/bin/python"; echo "venv $version" >>"$LOG" ;;
    *"-m pip --version"*) ;;
    *lock.py*) echo "${@: -1}" ;;
    *"-m pip install"*--requirement*) echo "${@:3:$#-3} $(cat "${@: -1}")" >>"$LOG.locked" ;;
    *"-m pip install"*--no-index*)
        [[ ! -e $LOG.broken ]] || exit 1
        last=${@: -1}; echo "install ${last##*/}" >>"$LOG" ;;
    *) echo "unexpected: $*" >&2; exit 99 ;;
esac
"""
#: A shim of pyenv for a version that is not switched on.
SHIM = "#!/bin/sh\necho 'command not found' >&2\nexit 127\n"


class Sandbox:
    """A copy of the repository's scripts with impostors for the interpreters on PATH."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "repository with space"
        self.programs = folder / "bin"
        self.log = folder / "log"
        (self.root / "scripts").mkdir(parents=True)
        self.programs.mkdir()
        for name in ("environment.sh", "lock.py"):
            shutil.copy(REPOSITORY / "scripts" / name, self.root / "scripts")
        for name in ("setup.py", "setup.cfg", "package.xml", "constraints.txt"):
            (self.root / name).write_text(name)
        # The real interpreters of this machine stay out of sight.
        for name in ("python3.14", "python3.13", "python3.12", "python3.11", "python3"):
            self.program(name, SHIM)

    def program(self, name: str, text: str) -> None:
        path = self.programs / name
        path.write_text(text)
        path.chmod(0o755)

    def python(self, name: str, version: str = "3.12", has_venv: bool = True) -> None:
        self.program(name, IMPOSTOR % {"version": version, "no_venv": 0 if has_venv else 1})

    def run(self, extras: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
        make = f'make_environment "$ROOT/.venv" constraints.txt "{extras}"'
        code = f"set -euo pipefail; source scripts/environment.sh; {make}"
        variables = {
            "PATH": f"{self.programs}:{os.defpath}",
            "HOME": str(self.root),
            "LOG": str(self.log),
            **environment,
        }
        return subprocess.run(
            ["bash", "-c", code, "scripts/demo"],
            cwd=self.root,
            env=variables,
            capture_output=True,
            text=True,
            timeout=30,
        )

    def asked(self) -> list[str]:
        """Return what was asked for since the last call."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        self.log.unlink(missing_ok=True)
        return lines


@pytest.fixture
def sandbox(tmp_path: Path) -> Sandbox:
    return Sandbox(tmp_path)


def test_second_run_does_nothing(sandbox: Sandbox) -> None:
    sandbox.python("python3.12")
    first, second = sandbox.run("ros,test"), sandbox.run("ros,test")
    assert (first.returncode, second.returncode) == (0, 0), first.stderr + second.stderr
    assert sandbox.asked() == ["venv 3.12", "install repository with space[ros,test]"]
    assert "installing" in first.stderr
    assert second.stderr == ""


def test_more_serves_less(sandbox: Sandbox) -> None:
    sandbox.python("python3.12")
    asked = [(sandbox.run(extras).returncode, sandbox.asked()) for extras in ("", "ros,test", "")]
    assert asked == [
        (0, ["venv 3.12", "install repository with space"]),
        (0, ["install repository with space[ros,test]"]),
        (0, []),
    ]


def test_only_what_is_locked_is_installed(sandbox: Sandbox) -> None:
    sandbox.python("python3.12")
    assert sandbox.run("ros,test").returncode == 0
    lines = Path(f"{sandbox.log}.locked").read_text().splitlines()
    assert [line.split()[-1] for line in lines] == ["build", "imgu_ros,ros,test"]
    assert all({"--require-hashes", "--no-deps"} <= set(line.split()) for line in lines)


@pytest.mark.parametrize("changed", ["constraints.txt", "setup.py", "setup.cfg", "package.xml"])
def test_change_installs_again(sandbox: Sandbox, changed: str) -> None:
    sandbox.python("python3.12")
    sandbox.run()
    sandbox.asked()
    (sandbox.root / changed).write_text("other")
    assert sandbox.run().returncode == 0
    assert sandbox.asked() == ["install repository with space"]


def test_interrupted_installation_starts_afresh(sandbox: Sandbox) -> None:
    sandbox.python("python3.12")
    broken = Path(f"{sandbox.log}.broken")
    broken.touch()
    assert sandbox.run().returncode != 0
    broken.unlink()
    (sandbox.root / ".venv" / "half a package").touch()
    assert sandbox.run().returncode == 0
    assert sandbox.asked() == ["venv 3.12", "venv 3.12", "install repository with space"]
    assert not (sandbox.root / ".venv" / "half a package").exists()


def test_moved_repository_starts_afresh(sandbox: Sandbox) -> None:
    sandbox.python("python3.12")
    sandbox.run()
    sandbox.root = sandbox.root.rename(sandbox.root.parent / "elsewhere")
    sandbox.asked()
    assert sandbox.run().returncode == 0
    assert sandbox.asked() == ["venv 3.12", "install elsewhere"]


def test_environment_of_somebody_else_is_left_alone(sandbox: Sandbox) -> None:
    sandbox.python("python3.12")
    (sandbox.root / ".venv").mkdir()
    (sandbox.root / ".venv" / "precious").touch()
    done = sandbox.run()
    assert done.returncode == 1
    assert "IMGU_VENV" in done.stderr
    assert (sandbox.root / ".venv" / "precious").exists()


def test_interpreter_that_runs_is_chosen(sandbox: Sandbox) -> None:
    sandbox.python("python3", version="3.11")
    assert sandbox.run().returncode == 0
    assert sandbox.asked()[0] == "venv 3.11"


def test_interpreter_of_pyenv_is_found_behind_its_shim(sandbox: Sandbox) -> None:
    folder = sandbox.root / ".pyenv" / "versions" / "3.12.4" / "bin"
    folder.mkdir(parents=True)
    sandbox.python("python")
    shutil.move(sandbox.programs / "python", folder / "python")
    assert sandbox.run().returncode == 0
    assert sandbox.asked()[0] == "venv 3.12"


@pytest.mark.parametrize(
    ("name", "version", "has_venv", "need"),
    [
        ("python3", "3.9", True, "no Python 3.12 or 3.11 or 3.13 or 3.14 found on PATH"),
        ("python3", "3.15", True, "no Python 3.12 or 3.11 or 3.13 or 3.14 found on PATH"),
        ("python3.11", "3.11", False, "sudo apt install python3.11-venv"),
        ("python", "3.12", True, "IMGU_PYTHON"),
    ],
)
def test_what_is_missing_is_said(sandbox: Sandbox, name: str, version: str, has_venv: bool, need: str) -> None:
    sandbox.python(name, version, has_venv)
    done = sandbox.run()
    assert done.returncode == 1
    assert done.stderr.startswith("demo: error: ")
    assert need in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_wrong_interpreter_on_request_is_refused(sandbox: Sandbox) -> None:
    sandbox.python("python3.12")
    done = sandbox.run(IMGU_PYTHON="python3.11")
    assert done.returncode == 1
    assert "IMGU_PYTHON=python3.11" in done.stderr


def wheel(folder: Path, content: str) -> str:
    """Write a package of one module, as a wheel; return its digest."""
    path = folder / "harmless-1.0-py3-none-any.whl"
    info = "harmless-1.0.dist-info"
    files = {
        "harmless.py": content,
        f"{info}/METADATA": "Metadata-Version: 2.1\nName: harmless\nVersion: 1.0\nRequires-Dist: unlocked\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    files[f"{info}/RECORD"] = "".join(f"{name},,\n" for name in [*files, f"{info}/RECORD"])
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("tampered", [False, True])
def test_a_file_with_another_digest_is_refused(tmp_path: Path, tampered: bool) -> None:
    pytest.importorskip("pip")
    lock = tmp_path / "lock.txt"
    lock.write_text(f"# header\n\n# test\nharmless==1.0 \\\n    --hash=sha256:{wheel(tmp_path, 'x = 1')}\n")
    if tampered:
        wheel(tmp_path, "x = 2")
    code = f'set -euo pipefail; source scripts/environment.sh; PYTHON="{sys.executable}"; install_locked "{lock}" test'
    target = tmp_path / "installed"
    # From this folder alone, to a folder of its own; nothing is asked of an index.
    variables = {
        "PIP_NO_INDEX": "1",
        "PIP_FIND_LINKS": str(tmp_path),
        "PIP_TARGET": str(target),
        "PIP_CONFIG_FILE": os.devnull,
        "PIP_NO_CACHE_DIR": "1",
    }
    done = subprocess.run(
        ["bash", "-c", code],
        cwd=REPOSITORY,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode == 0) is not tampered, done.stderr
    assert (target / "harmless.py").exists() is not tampered
    assert ("THESE PACKAGES DO NOT MATCH THE HASHES" in done.stderr) is tampered


@pytest.mark.parametrize(
    "text",
    [
        "# header\n\n# test\nharmless==1.0\n",
        "# header\n\nharmless==1.0 \\\n    --hash=sha256:" + 64 * "0" + "\n",
        "# header\n\n# test\nharmless>=1.0 \\\n    --hash=sha256:" + 64 * "0" + "\n",
        "# header\n\n# test\nharmless==1.0 \\\n    --hash=md5:" + 32 * "0" + "\n",
        "--extra-index-url=https://elsewhere.invalid\n\n",
        "# header\n\n--extra-index-url=https://elsewhere.invalid\n",
        "",
    ],
)
def test_a_lock_without_digests_is_refused(tmp_path: Path, text: str) -> None:
    lock = tmp_path / "lock.txt"
    lock.write_text(text)
    command = [sys.executable, str(REPOSITORY / "scripts" / "lock.py"), str(lock), "test"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (1, "", 1), done.stderr


#: What .ci/run takes from scripts/environment.sh; Python 3.13 and 3.14 are missing, and the suite passes everything.
STAGE = """
OFFLINE=(offline) LIVE=(live)
_find_python() { [[ $1 == 3.1[12] ]] || exit 1; FOUND_PYTHON=python$1; }
make_environment() { PYTHON=true; }
available_extras() { echo "$1"; }
install_locked() { return 0; }
"""


@pytest.mark.parametrize("broken", ["", "docs"])
def test_ci_names_slow_and_failed_steps(tmp_path: Path, broken: str) -> None:
    (tmp_path / ".ci").mkdir()
    (tmp_path / "scripts").mkdir()
    shutil.copy(REPOSITORY / ".ci" / "run", tmp_path / ".ci")
    (tmp_path / "scripts" / "environment.sh").write_text(STAGE)
    programs = {f"scripts/{name}": "exit 0" for name in ("test", "audit", "sbom", "docs", "colcon")}
    programs |= {"scripts/colcon": "sleep 2", "bin/chromium": "exit 0"}
    # An interpreter whose environments hold the command, and no rclpy.
    make = 'mkdir -p "$3/bin"; cp "$0" "$3/bin/python"; printf "#!/bin/sh\\n" >"$3/bin/imgu"; chmod +x "$3/bin/imgu"'
    programs["bin/python3.11"] = f'case "$*" in *"import rclpy"*) exit 1 ;; *"-m venv"*) {make} ;; esac'
    if broken:
        programs[f"scripts/{broken}"] = "exit 3"
    for name, text in programs.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(f"#!/bin/bash\n{text}\n")
        (tmp_path / name).chmod(0o755)
    variables = {"PATH": f"{tmp_path / 'bin'}:{os.defpath}", "HOME": str(tmp_path)}
    done = subprocess.run(
        ["bash", str(tmp_path / ".ci" / "run")], env=variables, capture_output=True, text=True, timeout=60
    )
    slowest = done.stdout.partition("=== slowest steps\n")[2].splitlines()
    assert slowest[0].endswith(" s  colcon")
    assert "=== without ROS, Python 3.11" in done.stdout
    assert "no Python 3.13 on this machine" in done.stdout and "Python 3.12" not in done.stdout
    assert (done.returncode, done.stderr) == ((1, ".ci/run: FAILED: documentation\n") if broken else (0, ""))


SCRIPTS = (
    "scripts/demo",
    "scripts/test",
    "scripts/pin",
    "scripts/colcon",
    "scripts/audit",
    "scripts/sbom",
    "scripts/docs",
    "scripts/release",
    "scripts/environment.sh",
    ".ci/run",
)


@pytest.mark.parametrize("script", SCRIPTS)
def test_scripts_parse(script: str) -> None:
    path = REPOSITORY / script
    assert subprocess.run(["bash", "-n", str(path)], capture_output=True, text=True, timeout=30).stderr == ""
    assert os.access(path, os.X_OK) == (path.suffix != ".sh")
