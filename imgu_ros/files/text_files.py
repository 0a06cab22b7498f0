"""Text files to write, UTF-8; what the operating system refuses becomes a FileError."""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

from imgu_ros.errors import FileError


def write_text(path: Path, text: str) -> None:
    """Write a whole file.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise _refused(path, error) from None


def open_for_writing(path: Path) -> TextIO:
    """Open a new or emptied file to be written bit by bit; lines end as they are written.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    try:
        return path.open("w", newline="", encoding="utf-8")
    except OSError as error:
        raise _refused(path, error) from None


def _refused(path: Path, error: OSError) -> FileError:
    return FileError(f"{path}: {error.strerror}; need a file that can be written")
