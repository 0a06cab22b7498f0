# SPDX-License-Identifier: Apache-2.0
"""Find messages in the pages of a damaged SQLite file, also in pages that its b-tree no longer references.

One pass over the file takes every leaf page of a table, and of its rows those that rosbag2 writes: NULL (the id is the
row's own), two integers, a blob. Source: SQLite's *Database File Format*, sections 1.6 and 2.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.storage import MAX_TIME_NS

_LEAF = 13
_SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")
_BLOCK = 2**22
#: Some 1.2 GB while they are sorted.
_MOST_ROWS = 10_000_000
#: Bytes of an integer by its serial type.
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}


class SqlitePages:
    """The rows of messages in a file's pages; BagError if it cannot be read.

    Attributes
    ----------
    rows : (N, 4) time, id, topic and place, by time, each row once
    is_whole : no row was left out for want of memory
    """

    def __init__(self, path: Path) -> None:
        self._file = ByteFile(path)
        header = self._file.read(0, min(100, self._file.size)).ljust(100, b"\0")
        page = int.from_bytes(header[16:18], "big")
        self._page = 65536 if page == 1 else page if page >= 512 and not page & (page - 1) else 4096
        self._usable = max(self._page - header[20], 480)
        self.is_whole = True
        found = array("q")
        for values in self._leaf_rows():
            found.extend(values)
            if len(found) > 4 * _MOST_ROWS:
                del found[-4:]
                self.is_whole = False
                break
        columns = np.array(found, np.int64).reshape(-1, 4)
        order = np.lexsort((columns[:, 2], columns[:, 1], columns[:, 0]))
        columns = columns[order]
        # A page that was split may be there twice.
        is_new = np.ones(len(columns), bool)
        is_new[1:] = (columns[1:, :3] != columns[:-1, :3]).any(axis=1)
        self.rows = columns[is_new]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def data(self, place: int, most: int) -> bytes | None:
        """Return the data of the row at a place; None when a page is missing, or it has more than `most` bytes."""
        number, at = divmod(place, self._page)
        content = self._read(number)
        payload, at = _varint(content, at)
        _, at = _varint(content, at)
        if payload > min(most + 100, self._file.size):
            return None
        local = self._local(payload)
        parts, left = [content[at : at + local]], payload - local
        following = int.from_bytes(content[at + local : at + local + 4], "big") if left else 0
        while left > 0:
            if not 1 < following <= self._file.size // self._page:
                return None
            content = self._read(following - 1)
            parts.append(content[4 : 4 + min(left, self._usable - 4)])
            left -= self._usable - 4
            following = int.from_bytes(content[:4], "big")
        row = b"".join(parts)
        shape = _shape(row, 0, payload)
        return None if shape is None else row[payload - shape[2] :]

    def place_of(self, row: int, time_ns: int) -> int | None:
        """Return where the row with an id and a time is."""
        start, end = (int(np.searchsorted(self.rows[:, 0], time_ns, side)) for side in _SIDES)
        for _, identity, _, place in self.rows[start:end].tolist():
            if identity == row:
                return int(place)
        return None

    def _read(self, number: int) -> bytes:
        start = number * self._page
        return self._file.read(start, min(self._page, self._file.size - start)).ljust(self._page, b"\0")

    def _leaf_rows(self) -> Iterator[tuple[int, int, int, int]]:
        """Yield time, id, topic and place of the rows of all leaf pages."""
        step = _BLOCK // self._page * self._page
        for start in range(0, self._file.size, step):
            block = self._file.read(start, min(step, self._file.size - start))
            kinds = np.frombuffer(block, np.uint8)[:: self._page].copy()
            if start == 0 and len(block) > 100:
                kinds[0] = block[100]
            for index in np.flatnonzero(kinds == _LEAF).tolist():
                page = block[index * self._page : (index + 1) * self._page].ljust(self._page, b"\0")
                number = start // self._page + index
                yield from self._page_rows(page, number, 100 if number == 0 else 0)

    def _page_rows(self, page: bytes, number: int, head: int) -> Iterator[tuple[int, int, int, int]]:
        count = int.from_bytes(page[head + 3 : head + 5], "big")
        count = min(count, (self._page - head - 8) // 2)
        for cell in struct.unpack_from(f">{count}H", page, head + 8):
            if not head + 8 <= cell < self._usable - 8:
                continue
            payload, at = _varint(page, cell)
            row, at = _varint(page, at)
            shape = _shape(page, at, payload)
            if shape is None or at + self._local(payload) > self._page:
                continue
            topic, time_ns, _ = shape
            if row < 2**63 and 0 <= time_ns <= MAX_TIME_NS:
                yield time_ns, row, topic, number * self._page + cell

    def _local(self, payload: int) -> int:
        """Return how many bytes of a row are in its leaf page."""
        most, least = self._usable - 35, (self._usable - 12) * 32 // 255 - 23
        if payload <= most:
            return payload
        local = least + (payload - least) % (self._usable - 4)
        return local if local <= most else least


def _shape(data: bytes, at: int, payload: int) -> tuple[int, int, int] | None:
    """Return topic, time and number of bytes of a row as rosbag2 writes it; None for any other."""
    if at + 5 > len(data) or data[at + 1] != 0:
        return None
    types = data[at + 2], data[at + 3]
    blob, end = _varint(data, at + 4)
    if types[0] not in _INTEGERS or types[1] not in _INTEGERS or blob < 12 or blob % 2 or end - at != data[at]:
        return None
    sizes = [_INTEGERS[kind] for kind in types]
    if end - at + sum(sizes) + (blob - 12) // 2 != payload or end + sum(sizes) > len(data):
        return None
    values = []
    for kind, size in zip(types, sizes, strict=True):
        values.append(kind - 8 if not size else int.from_bytes(data[end : end + size], "big", signed=True))
        end += size
    return values[0], values[1], (blob - 12) // 2


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return a number of 1 to 9 bytes, and where it ends."""
    value = 0
    for index in range(at, min(at + 8, len(data))):
        value = value << 7 | data[index] & 127
        if data[index] < 128:
            return value, index + 1
    end = at + 8
    return (value << 8 | data[end], end + 1) if end < len(data) else (0, len(data))
