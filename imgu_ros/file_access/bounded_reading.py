# SPDX-License-Identifier: Apache-2.0
"""Files read without waiting for ever, and in bounded memory: what a name leads to may be a pipe or a device."""

from __future__ import annotations

import os
import select
import stat
from collections.abc import Iterator
from pathlib import Path

from imgu_ros.errors import FileError

_PIECE = 1 << 20
#: Who writes into a pipe (`<(command)`) may take so long for the next piece.
_PATIENCE_S = 5.0
_LONGEST_LINE = 1 << 20


def file_bytes(path: Path, need: str, most: int) -> bytes:
    """Return the content of a file, or of a pipe that somebody writes into.

    Parameters
    ----------
    need : what is wanted, for the error: "a parameter file"
    most : bytes that it may have

    Raises
    ------
    FileError
        If it cannot be read, is a folder, a socket or a device, is larger, or a pipe gives nothing for five seconds.
    """
    content = bytearray()
    for piece in _pieces(path, need):
        content += piece
        if len(content) > most:
            raise FileError(f"{path}: more than {most} bytes; need {need}")
    return bytes(content)


def file_lines(path: Path, need: str) -> Iterator[str]:
    """Yield the lines of a text in UTF-8, with their ends.

    Raises
    ------
    FileError
        As `file_bytes`; if it is no text, or a line is longer than a megabyte.
    """
    rest = b""
    try:
        for piece in _pieces(path, need):
            *lines, rest = (rest + piece).split(b"\n")
            for line in lines:
                yield line.decode() + "\n"
            if len(rest) > _LONGEST_LINE:
                raise FileError(f"{path}: a line of more than {_LONGEST_LINE} bytes; need {need}")
        if rest:
            yield rest.decode()
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: {error}; need {need}") from None


def _pieces(path: Path, need: str) -> Iterator[bytes]:
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe without a writer would wait
        try:
            mode = os.fstat(descriptor).st_mode
            if not (stat.S_ISREG(mode) or stat.S_ISFIFO(mode)):
                raise FileError(f"{path}: {'a folder' if stat.S_ISDIR(mode) else 'no regular file'}; need {need}")
            waiting = select.poll()
            waiting.register(descriptor, select.POLLIN)
            while True:
                if not waiting.poll(1000 * _PATIENCE_S):
                    raise FileError(f"{path}: a pipe that gives nothing for {_PATIENCE_S:g} s; need {need}")
                piece = os.read(descriptor, _PIECE)
                if not piece:
                    return
                yield piece
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise FileError(f"{path}: {getattr(error, 'strerror', None) or error}; need {need}") from None
