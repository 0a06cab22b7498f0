# SPDX-License-Identifier: Apache-2.0
"""Reading files: whatever a name leads to, it ends, in bounded memory, and an error says what was found."""

from __future__ import annotations

import os
import socket
import threading
from pathlib import Path

import pytest

from imgu_ros.config.files import parameter_file_bytes
from imgu_ros.errors import FileError
from imgu_ros.file_access import bounded_reading as reading
from imgu_ros.file_access.bounded_reading import file_bytes, file_lines
from imgu_ros.files.camera_info_file import read_description
from imgu_ros.simulate.truth import read_truth

READERS = (parameter_file_bytes, read_description, read_truth)


@pytest.fixture
def places(tmp_path: Path) -> dict[str, Path]:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(os.fspath(tmp_path / "socket"))
    names = ("loop", "folder", "pipe", "socket", "missing", "loop/x", "x" * 300, "x/" * 3000, "nul\0", "half\ud800")
    devices = ("/dev/null", "/dev/full", "/dev/zero", "/proc/self/mem")
    return {name: tmp_path / name for name in names} | {name: Path(name) for name in devices}


@pytest.mark.parametrize("reader", READERS)
def test_a_name_that_leads_to_no_file_is_one_line(
    places: dict[str, Path], reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "_PATIENCE_S", 0.1)
    for name, path in places.items():
        with pytest.raises(FileError) as raised:
            reader(path)
        assert "; need a" in str(raised.value), name
        assert "\n" not in str(raised.value) and len(str(raised.value)) <= 2000


def test_a_pipe_that_somebody_writes_into_is_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    descriptor = os.open(tmp_path / "pipe", os.O_RDWR)  # both ends: neither waits
    os.write(descriptor, b"seed: 1\n")
    closing = threading.Timer(0.2, os.close, [descriptor])
    closing.start()
    assert file_bytes(tmp_path / "pipe", "a file", 100) == b"seed: 1\n"
    closing.join()


def test_bounds(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 100)
    assert file_bytes(path, "a file", 100) == b"x" * 100
    with pytest.raises(FileError, match="more than 99 bytes; need a file"):
        file_bytes(path, "a file", 99)
    path.write_bytes(b"x" * (3 << 20))
    with pytest.raises(FileError, match="a line of more than 1048576 bytes"):
        list(file_lines(path, "a text"))


def test_lines_are_those_of_the_text_wherever_the_pieces_end(tmp_path: Path) -> None:
    text = "".join(f"{'é漢😀' * (i % 977)}{i}\r\n" for i in range(1500)) + "last\n\nend"
    assert len(text.encode()) > 3 << 20
    (tmp_path / "text").write_bytes(text.encode())
    with (tmp_path / "text").open(newline="", encoding="utf-8") as file:
        expected = list(file)
    assert list(file_lines(tmp_path / "text", "a text")) == expected


def test_a_truth_of_too_many_rows_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from imgu_ros.simulate import truth

    monkeypatch.setattr(truth, "_MOST_ROWS", 2)
    head, row = ",".join(truth.COLUMNS), ",".join(["1", "poster", *"100010001", *[""] * 7])
    (tmp_path / "t.csv").write_text(f"{head}\n{row}\n{row}\n")
    assert len(read_truth(tmp_path / "t.csv")) == 2
    (tmp_path / "t.csv").write_text(f"{head}\n{row}\n{row}\n{row}\n")
    with pytest.raises(FileError, match="more than 2 rows"):
        read_truth(tmp_path / "t.csv")
