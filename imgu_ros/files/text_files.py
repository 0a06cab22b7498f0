# SPDX-License-Identifier: Apache-2.0
"""Text files to write, UTF-8; what the operating system refuses becomes a FileError."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol, TextIO

from imgu_ros.errors import FileError


def write_text(path: Path, text: str) -> None:
    """Write a whole file; characters that are none in UTF-8 (half a pair) are written as escapes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    try:
        path.write_text(text, encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        raise _refused(path, error) from None


def open_for_writing(path: Path) -> TextIO:
    """Open a new or emptied file to be written bit by bit; lines end as they are written.

    Characters that are none in UTF-8 (half a pair, of a name that came as other bytes) are written as escapes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    try:
        return path.open("w", newline="", encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        raise _refused(path, error) from None


def csv_writer(file: TextIO) -> CsvWriter:
    """Return a writer of rows of text, each quoted where it has to be; lines end in a line feed."""
    # Of the characters that end a line, Python 3.12 quotes those of the line's own end alone.
    return csv.writer(_LineFeeds(file), lineterminator="\r\n")


class CsvWriter(Protocol):
    """What writes rows."""

    def writerow(self, row: Iterable[object], /) -> object:
        """Write one row."""


class _LineFeeds:
    """Takes rows that end in carriage return and line feed."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def write(self, row: str) -> int:
        return self._file.write(row.removesuffix("\r\n") + "\n")


def _refused(path: Path, error: OSError) -> FileError:
    return FileError(f"{path}: {error.strerror}; need a file that can be written")
