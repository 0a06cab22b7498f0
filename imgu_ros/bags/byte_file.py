# SPDX-License-Identifier: Apache-2.0
"""A file read by position, never beyond its end."""

from __future__ import annotations

import os
from pathlib import Path

from imgu_ros.errors import BagError


class ByteFile:
    """An open file of known size; reading needs no current position, so that several readers can share it.

    Raises
    ------
    BagError
        If it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe must not block
            self.size = os.fstat(self._descriptor).st_size
        except OSError as error:
            raise BagError(f"{path}: {error.strerror}; need a readable file") from None

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
                    raise BagError(f"{self.path}: ends at byte {offset + len(data)}; it had {self.size} bytes")
                data += more
            return data
        except OSError as error:
            raise BagError(f"{self.path}: byte {offset}: {error.strerror}") from None

    def close(self) -> None:
        """Close the file; closing twice does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
