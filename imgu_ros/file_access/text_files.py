# SPDX-License-Identifier: Apache-2.0
"""Text files to write, UTF-8: whole ones, and rows of CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from imgu_ros.file_access.atomic_files import write_whole


def write_text(path: Path, text: str, *, synced: bool = False) -> None:
    """Write a whole file; see `write_whole`. Halves of a character (of a name that came as other bytes) become escapes.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    write_whole(path, text.encode("utf-8", "backslashreplace"), synced=synced)


def csv_writer(file: TextSink) -> CsvWriter:
    """Return a writer of rows of text, each quoted where it has to be; lines end in a line feed."""
    # Of the characters that end a line, Python 3.12 quotes those of the line's own end alone.
    return csv.writer(_LineFeeds(file), lineterminator="\r\n")


def csv_line(row: Iterable[object]) -> str:
    """Return a row as `csv_writer` writes it."""
    text = io.StringIO(newline="")
    csv_writer(text).writerow(row)
    return text.getvalue()


class TextSink(Protocol):
    """What takes text."""

    def write(self, text: str, /) -> object:
        """Take some."""


class CsvWriter(Protocol):
    """What writes rows."""

    def writerow(self, row: Iterable[object], /) -> object:
        """Write one row."""


class _LineFeeds:
    """Takes rows that end in carriage return and line feed."""

    def __init__(self, file: TextSink) -> None:
        self._file = file

    def write(self, row: str) -> None:
        self._file.write(row.removesuffix("\r\n") + "\n")
