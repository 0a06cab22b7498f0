# SPDX-License-Identifier: Apache-2.0
"""No file is ever seen in part."""

from __future__ import annotations

import os
import resource
import signal
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from imgu_ros.errors import FileError
from imgu_ros.file_access import atomic_files as whole_files
from imgu_ros.file_access.atomic_files import LineFile, write_whole


def test_a_file_is_replaced_whole_and_keeps_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "a"
    write_whole(path, b"one")
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~_umask()
    path.chmod(0o640)
    with path.open("rb") as reader:
        write_whole(path, b"two")
        assert reader.read() == b"one"
    assert path.read_bytes() == b"two"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_an_error_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"one")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(whole_files.os, "fsync", full)
    with pytest.raises(FileError, match="No space left on device"):
        write_whole(path, b"two")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a", b"one")]


def test_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real/a")
    for content in (b"one", b"two"):
        write_whole(tmp_path / "link", content)
        assert (tmp_path / "real" / "a").read_bytes() == content
    assert (tmp_path / "link").is_symlink()
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(FileError, match="Too many levels of symbolic links"):
        write_whole(tmp_path / "loop", b"")


def test_what_another_left_beside_it_stays(tmp_path: Path) -> None:
    (tmp_path / ".a.part").write_bytes(b"mine")
    write_whole(tmp_path / "a", b"one")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {".a.part": b"mine", "a": b"one"}


def test_long_names(tmp_path: Path) -> None:
    for name in ("a" * 255, "ä" * 127):
        write_whole(tmp_path / name, b"one")
        assert (tmp_path / name).read_bytes() == b"one"
    with pytest.raises(FileError, match="File name too long"):
        write_whole(tmp_path / ("a" * 256), b"")


def test_pipes_and_open_files_are_written_directly(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append((tmp_path / "pipe").read_bytes()))
    reader.start()
    write_whole(tmp_path / "pipe", b"one")
    reader.join(timeout=30)
    assert read == [b"one"]
    code = "import pathlib, imgu_ros.file_access.atomic_files as w; w.write_whole(pathlib.Path('/dev/stdout'), b'one')"
    with (tmp_path / "out").open("wb") as out:
        subprocess.run([sys.executable, "-c", code], stdout=out, check=True, timeout=60)
        assert os.fstat(out.fileno()).st_ino == (tmp_path / "out").stat().st_ino
    assert (tmp_path / "out").read_bytes() == b"one"


def test_lines_are_there_at_once(tmp_path: Path) -> None:
    with LineFile(tmp_path / "a", "head\n") as file:
        assert (tmp_path / "a").read_text() == "head\n"
        file.write("one\n")
        assert (tmp_path / "a").read_text() == "head\none\n"
        file.write("\udcff\n")
    assert (tmp_path / "a").read_text() == "head\none\n\\udcff\n"
    file.close()


def test_a_full_disk_leaves_whole_lines(tmp_path: Path) -> None:
    """A limit on the size of files acts as a full disk: it takes a part of the last write."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with LineFile(tmp_path / "a", "0123456789\n") as file:
            resource.setrlimit(resource.RLIMIT_FSIZE, (50, before[1]))
            with pytest.raises(FileError, match="a: File too large"):
                for _ in range(10):
                    file.write("0123456789\n")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)
    assert (tmp_path / "a").read_text() == 4 * "0123456789\n"


def test_a_file_that_may_not_be_written_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"one")
    path.chmod(0o444)
    if os.geteuid() == 0:  # who may write everything
        monkeypatch.setattr(whole_files.os, "access", lambda of, mode: bool(os.stat(of).st_mode & 0o222))
    with pytest.raises(FileError, match="a: Permission denied"):
        write_whole(path, b"two")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a", b"one")]


def test_a_file_keeps_its_owner(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"one")
    owner = (1234, 1234) if os.geteuid() == 0 else (os.getuid(), os.getgid())
    os.chown(path, *owner)
    write_whole(path, b"two")
    assert (path.read_bytes(), path.stat().st_uid, path.stat().st_gid) == (b"two", *owner)
