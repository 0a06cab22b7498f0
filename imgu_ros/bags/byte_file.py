# SPDX-License-Identifier: Apache-2.0
"""A file read by position, never beyond its end."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from pathlib import Path

from imgu_ros.errors import BagError

#: Small records that follow one another are read in blocks of this size.
_BLOCK_BYTES = 2**12
#: Blocks of a search, the first and the largest: most searches end soon.
_FIRST_SEARCH_BYTES, _SEARCH_BYTES = 2**10, 2**20


class ByteFile:
    """An open file of known size; reading needs no current position, so that several readers can share it.

    Attributes
    ----------
    size : bytes when it was opened; of a file that was cut since and read beyond its new end, what it has now

    Raises
    ------
    BagError
        If it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._block, self._block_start, self._last_head = b"", 0, 0
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe must not block
            self.size = os.fstat(self._descriptor).st_size
        except OSError as error:
            need = (
                "a bag: a folder, or a file .mcap, .db3 or .bag" if error.errno == errno.ENOENT else "a readable file"
            )
            raise BagError(f"{path}: {error.strerror}; need {need}") from None
        except ValueError as error:  # a path with a zero byte
            raise BagError(f"{str(path)!r}: {error}; need a readable file") from None

    def read(self, offset: int, size: int) -> bytes:
        """Return `size` bytes from `offset` on.

        Raises
        ------
        BagError
            If the file does not have them, or cannot be read.
        """
        if offset + size > self.size:
            raise BagError(f"{self.path}: {size} bytes at byte {offset}; the file has {self.size}")
        try:
            data = os.pread(self._descriptor, size, offset)
            while len(data) < size:  # the kernel gives at most 2 GiB at once, or the file has shrunk
                more = os.pread(self._descriptor, size - len(data), offset + len(data))
                if not more:
                    had, self.size = self.size, offset + len(data)
                    raise BagError(f"{self.path}: ends at byte {self.size}; it had {had} bytes")
                data += more
            return data
        except OSError as error:
            raise BagError(f"{self.path}: byte {offset}: {error.strerror}") from None

    def head(self, offset: int, size: int) -> bytes:
        """Return `size` bytes from `offset` on, fewer at the file's end; for one thread, which goes forward."""
        size = min(size, self.size - offset)
        if size <= 0:
            return b""
        at = offset - self._block_start
        if at >= 0 and at + size <= len(self._block):
            self._last_head = offset
            return self._block[at : at + size]
        is_near = 0 <= offset - self._last_head < _BLOCK_BYTES // 8
        self._last_head = offset
        if not is_near:  # a block for each large chunk would cost more than it saves
            return self.read(offset, size)
        self._block, self._block_start = self.read(offset, min(_BLOCK_BYTES, self.size - offset)), offset
        return self._block[:size]

    def find(self, pattern: re.Pattern[bytes], start: int, end: int, reach: int) -> Iterator[int]:
        """Yield the places between two places at which `pattern` matches, in ascending order.

        Parameters
        ----------
        pattern : matches at most `reach` bytes, its lookahead included
        """
        at, size = start, _FIRST_SEARCH_BYTES
        while at < end:
            block = self.read(at, min(size + reach, end - at))
            for match in pattern.finditer(block):
                if match.start() >= size:
                    break
                yield at + match.start()
            at += size
            size = min(2 * size, _SEARCH_BYTES)

    def close(self) -> None:
        """Close the file; closing twice does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
