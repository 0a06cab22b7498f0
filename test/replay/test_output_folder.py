# SPDX-License-Identifier: Apache-2.0
"""An output folder: one run at a time, and nobody else's file is ever removed."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from imgu_ros.errors import FileError
from imgu_ros.replay import folder_lock
from imgu_ros.replay.output_folder import OutputFiles, RunFolder, check_output_folder, output_folder

CONTENTS = OutputFiles(
    "replay", ("table.csv", "bag/data.mcap", "bag/metadata.yaml", "bag.part/bag/data.mcap", "end"), "end"
)
MANIFEST, LOCK = ".imgu_files.json", ".imgu_lock"


@contextmanager
def run(out: Path, *, overwrite: bool = True, contents: OutputFiles = CONTENTS) -> Iterator[RunFolder]:
    with output_folder(out, contents, overwrite=overwrite) as folder:
        yield folder


def write(out: Path) -> None:
    """A complete run."""
    with run(out) as folder:
        (out / "table.csv").write_text("1\n")
        (out / "bag.part" / "bag").mkdir(parents=True)
        (out / "bag.part" / "bag" / "data.mcap").write_bytes(b"data")
        folder.publish(("bag.part/bag", "bag"))
        (out / "end").write_text("{}")


def everything(out: Path) -> dict[str, tuple[str, bytes]]:
    """What is in the folder, but for what it says of itself."""
    found = {}
    for path in sorted(out.rglob("*")):
        content = os.fsencode(os.readlink(path)) if path.is_symlink() else path.read_bytes() if path.is_file() else b""
        found[str(path.relative_to(out))] = (oct(path.lstat().st_mode), content)
    return {name: value for name, value in found.items() if name not in (MANIFEST, LOCK)}


def test_an_earlier_run_is_replaced_and_others_files_stay(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out)
    assert set(everything(out)) == {"table.csv", "bag", "bag/data.mcap", "end"}
    (out / "notes.txt").write_text("mine")
    (out / ".hidden").write_text("mine")
    (out / "poses_groundtruth.tum").write_text("mine")
    (out / "recordings.mcap").mkdir()
    (out / "recordings.mcap" / "a.mcap").write_text("mine")
    (out / "link").symlink_to(tmp_path)
    before = everything(out)
    with pytest.raises(FileError, match="not empty"):
        check_output_folder(out, CONTENTS, overwrite=False)
    with run(out):
        mine = everything(out)
    assert mine == {name: before[name] for name in before if name not in ("table.csv", "bag", "bag/data.mcap", "end")}


def test_the_mark_goes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    write(out)
    removed: list[str] = []
    unlink = os.unlink
    monkeypatch.setattr(os, "unlink", lambda path, **where: (removed.append(path), unlink(path, **where)))
    with run(out):
        pass
    assert removed[0] == "end"


def in_the_way(out: Path, kind: str) -> str:
    """Put something that is no run's where a run writes; return how it is called."""
    if kind == "file":
        (out / "table.csv").write_text("mine")
        return "table.csv"
    if kind == "changed":
        os.utime(out / "table.csv", (time.time() + 60,) * 2)
        return "table.csv"
    if kind == "older":
        os.utime(out / "table.csv", (time.time() - 60,) * 2)
        return "table.csv"
    if kind == "folder":
        (out / "table.csv").unlink()
        (out / "table.csv").mkdir()
        (out / "table.csv" / "mine").write_text("mine")
        return "table.csv"
    if kind == "link":
        (out / "table.csv").rename(out.parent / "elsewhere.csv")
        (out / "table.csv").symlink_to(out.parent / "elsewhere.csv")
        return "table.csv"
    if kind == "link to a folder":
        (out / "bag").rename(out.parent / "elsewhere")
        (out / "bag").symlink_to(out.parent / "elsewhere")
        return "bag"
    if kind == "recording":
        (out / "bag" / "mine.mcap").write_text("mine")
        return "bag/mine.mcap"
    if kind == "folder in the bag":
        (out / "bag" / "data.mcap").unlink()
        (out / "bag" / "data.mcap").mkdir()
        return "bag/data.mcap"
    (out / "bag.part").mkdir()
    (out / "bag.part" / "mine").write_text("mine")
    return "bag.part/mine"


KINDS = ("changed", "older", "folder", "link", "link to a folder", "recording", "folder in the bag", "unfinished")


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_runs_is_refused_and_named(tmp_path: Path, kind: str) -> None:
    out = tmp_path / "out"
    write(out)
    name = in_the_way(out, kind)
    before = everything(tmp_path)
    for _ in range(2):  # a refusal does not make it a run's
        with pytest.raises(FileError, match=f"{out / name}: .*; it is not removed"), run(out):
            pass
    with pytest.raises(FileError, match=f"{out / name}: "):
        check_output_folder(out, CONTENTS, overwrite=True)
    assert everything(tmp_path) == before


def test_what_a_run_writes_at_its_very_end_is_its_own(tmp_path: Path) -> None:
    with run(tmp_path) as folder:
        os.utime(folder.lock, (time.time() - 60,) * 2)  # as if its last sign of life were a while ago
        os.utime(tmp_path / MANIFEST, (time.time() - 60,) * 2)
        (tmp_path / "table.csv").write_text("1")
    check_output_folder(tmp_path, CONTENTS, overwrite=True)


def test_results_of_an_earlier_version_are_refused(tmp_path: Path) -> None:
    in_the_way(tmp_path, "file")
    with pytest.raises(FileError, match=r"no list of a run .* it is yours, or of an earlier version; .* move it away"):
        check_output_folder(tmp_path, CONTENTS, overwrite=True)


def test_another_kind_of_run_is_refused(tmp_path: Path) -> None:
    write(tmp_path)
    with (
        pytest.raises(FileError, match="holds the files of a replay"),
        run(tmp_path, contents=OutputFiles("simulation", ("other",), "other")),
    ):
        pass


def test_a_run_that_was_killed_is_replaced(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys; from pathlib import Path; from test_output_folder import *\n"
        "with run(Path(sys.argv[1])) as folder:\n"
        "    (folder.path / 'table.csv').write_text('1')\n"
        "    (folder.path / 'bag.part' / 'bag').mkdir(parents=True)\n"
        "    (folder.path / 'bag.part' / 'bag' / 'data.mcap').write_text('1')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], cwd=Path(__file__).parent, timeout=60, check=False
    )
    assert done.returncode == -9
    (tmp_path / "mine").write_text("mine")
    with run(tmp_path):
        assert set(everything(tmp_path)) == {"mine"}


HOSTILE = {
    "not JSON": b"frames.csv\n",
    "nested": b"[" * 100_000,
    "huge": b'{"version": 1, "kind": "replay", "files": ["' + b"a" * 5_000_000 + b'"]}',
    "a list": b"[]",
    "a number of many digits": b'{"version": ' + b"1" * 10_000 + b"}",
    "numbers as names": b'{"version": 1, "kind": "replay", "files": [1]}',
    "not UTF-8": b"\xff\xfe",
    **{
        name: json.dumps({"version": 1, "kind": "replay", "files": [name]}).encode()
        for name in (
            *("../mine", "/etc/passwd", "a/../../mine", "a//b", ".", "", "a/b/c/d", "a\0b", "\ud800"),
            *(LOCK, MANIFEST),
        )
    },
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_list_is_trusted_in_nothing(tmp_path: Path, name: str) -> None:
    out = tmp_path / "out"
    write(out)
    (tmp_path / "mine").write_text("mine")
    (out / MANIFEST).write_bytes(HOSTILE[name])
    before = everything(tmp_path)
    with pytest.raises(FileError, match=r"\.imgu_files\.json: not a run's list of files") as error, run(out):
        pass
    assert len(str(error.value)) < 500
    assert everything(tmp_path) == before


@pytest.mark.parametrize("name", [MANIFEST, LOCK])
@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_what_the_folder_says_of_itself_is_a_file(tmp_path: Path, name: str, kind: str) -> None:
    (tmp_path / "real").write_text("{}")
    path = tmp_path / "out" / name
    path.parent.mkdir()
    if kind == "link":
        path.symlink_to(tmp_path / "real")
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()
    with pytest.raises(FileError, match=name), run(path.parent):
        pass
    assert (tmp_path / "real").read_text() == "{}"


def test_a_second_run_is_told_whose_the_folder_is(tmp_path: Path) -> None:
    with run(tmp_path):
        for overwrite in (False, True):
            with pytest.raises(FileError, match=rf"another run writes there: .*process {os.getpid()} of .* on .*since"):
                check_output_folder(tmp_path, CONTENTS, overwrite=overwrite)
        with pytest.raises(FileError, match="another run writes there"), folder_lock.locked_folder(tmp_path):
            pass
    check_output_folder(tmp_path, CONTENTS, overwrite=True)


def test_what_a_lock_says_is_shown_as_text(tmp_path: Path) -> None:
    with run(tmp_path):
        owner = {"pid": "\x1b[2J" * 500, "command": "\n\x07", "user": [1], "host": None}
        (tmp_path / LOCK).write_text(json.dumps(owner)[:8000])
        with pytest.raises(FileError) as error:
            check_output_folder(tmp_path, CONTENTS, overwrite=True)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 2100


def test_a_lock_is_held_by_whoever_inherits_it(tmp_path: Path) -> None:
    with run(tmp_path) as folder:
        assert pickle.loads(pickle.dumps(folder)).lock == folder.lock
        child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=(folder.lock,))
    with pytest.raises(FileError, match="another run writes there"):
        check_output_folder(tmp_path, CONTENTS, overwrite=True)
    child.communicate(b"\n", timeout=60)
    check_output_folder(tmp_path, CONTENTS, overwrite=True)


def test_without_locks_the_user_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", refused)
    said: list[str] = []
    with output_folder(tmp_path, CONTENTS, overwrite=False, on_warning=said.append):
        pass
    assert len(said) == 1
    assert "no locks" in said[0]


@pytest.mark.parametrize("replaced", [False, True])
def test_a_folder_that_is_taken_away_ends_the_run(tmp_path: Path, replaced: bool) -> None:
    out = tmp_path / "out"
    with run(out) as folder:
        out.rename(tmp_path / "away")
        if replaced:
            out.mkdir()
        with pytest.raises(FileError, match="need a folder that stays"):
            folder.renew()
    assert not (out.exists() and list(out.iterdir()))


def test_inputs_are_not_removed(tmp_path: Path) -> None:
    write(tmp_path)
    for path in (tmp_path, tmp_path / "bag", tmp_path / "bag" / "data.mcap", tmp_path / "table.csv"):
        with pytest.raises(FileError, match="is to be read"):
            check_output_folder(tmp_path, CONTENTS, overwrite=True, inputs=[path])


def test_a_folder_whose_name_begins_as_the_runs_own_files(tmp_path: Path) -> None:
    contents = OutputFiles("simulation", (".imgu_x.mcap", "metadata.yaml"), "metadata.yaml")
    for text in ("1", "2"):
        with run(tmp_path / ".imgu_x", contents=contents):
            for name in contents.files:
                (tmp_path / ".imgu_x" / name).write_text(text)
        assert (tmp_path / ".imgu_x" / ".imgu_x.mcap").read_text() == text
