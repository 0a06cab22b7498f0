# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest

from imgu_ros.errors import FileError
from imgu_ros.file_access.atomic_files import LineFile
from imgu_ros.file_access.text_files import write_text


def test_bytes_are_as_written(tmp_path: Path) -> None:
    write_text(tmp_path / "whole.txt", "Grüße\n")
    with LineFile(tmp_path / "parts.csv") as file:
        file.write("a\n")
        file.write("b\r\n")
    assert (tmp_path / "whole.txt").read_bytes() == b"Gr\xc3\xbc\xc3\x9fe\n"
    assert (tmp_path / "parts.csv").read_bytes() == b"a\nb\r\n"


@pytest.mark.parametrize("place", [".", "missing/file.txt"])
def test_a_place_that_cannot_be_written_is_said(tmp_path: Path, place: str) -> None:
    for write in (LineFile, lambda path: write_text(path, "")):
        with pytest.raises(FileError, match="need a file that can be written"):
            write(tmp_path / place)
