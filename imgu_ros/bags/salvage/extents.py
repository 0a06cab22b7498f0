# SPDX-License-Identifier: Apache-2.0
"""Extents of a file that hold messages: chunks, and messages outside of chunks. Separate: a compact table of many."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator, KeysView
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from imgu_ros.bags.storage import MAX_TIME_NS


@dataclass(slots=True, eq=False)
class Extent:
    """A chunk, or a run of messages outside of chunks.

    Attributes
    ----------
    offset : of its first record's first byte in the file
    data_offset, data_size : of its records in the file, compressed as they are
    compression : "", "zstd", "lz4", "bz2"
    size : of its records, decompressed
    crc : CRC-32 of the decompressed records; 0: not known
    start_ns, end_ns : times of its first and last message
    counts : messages by channel id
    is_counted : `counts` was declared by an index or counted; otherwise the data must be read to know
    """

    offset: int
    data_offset: int
    data_size: int
    compression: str
    size: int
    crc: int
    start_ns: int
    end_ns: int
    counts: dict[int, int] = field(default_factory=dict)
    is_counted: bool = False

    @property
    def end(self) -> int:
        """Place behind its last byte."""
        return self.data_offset + self.data_size

    @property
    def is_run(self) -> bool:
        """Whether it is of messages outside of chunks, which the walk has counted."""
        return self.data_offset == self.offset


class ExtentTable:
    """A table of extents, 64 bytes each: a chunk of one small message takes hardly more in the file."""

    _COLUMNS = 8
    _OFFSET, _DATA_OFFSET, _DATA_SIZE, _SIZE, _START, _END, _FLAGS, _COUNTS = range(8)

    def __init__(self) -> None:
        self._numbers = array("Q")
        self._methods: list[str] = []
        self._known_methods: dict[str, int] = {}
        self._known_counts: dict[bytes, int] = {}
        self._counts: list[bytes] = []

    def __len__(self) -> int:
        return len(self._numbers) // self._COLUMNS

    def __getitem__(self, index: int) -> Extent:
        at = self._COLUMNS * index
        offset, data_offset, data_size, size, start, end, packed, counts = self._numbers[at : at + self._COLUMNS]
        return Extent(
            offset, data_offset, data_size, self._methods[packed >> 33], size, packed & 0xFFFFFFFF, start, end,
            self._unpacked(counts), bool(packed >> 32 & 1),
        )  # fmt: skip

    def __iter__(self) -> Iterator[Extent]:
        return (self[index] for index in range(len(self)))

    def append(self, extent: Extent) -> None:
        """Add a extent; later changes of it do not count."""
        self._numbers.extend(self._row(extent))

    def replace(self, index: int, extent: Extent) -> None:
        """Put a extent in the place of another."""
        at = self._COLUMNS * index
        self._numbers[at : at + self._COLUMNS] = array("Q", self._row(extent))

    def totals(self) -> dict[int, int]:
        """Return the messages by channel id, of all extents; those that hold no message count for nothing."""
        totals: dict[int, int] = {}
        for index, times in enumerate(np.bincount(self._column(self._COUNTS).astype(np.int64)).tolist()):
            for channel, count in self._unpacked(index).items() if times else ():
                totals[channel] = totals.get(channel, 0) + times * count
        return totals

    def span(self) -> tuple[int, int]:
        """Return the first and the last time of those that hold messages; zeros when none does."""
        filled = self._filled()
        if not filled.any():
            return 0, 0
        return int(self._column(self._START)[filled].min()), int(self._column(self._END)[filled].max())

    def uncounted(self, known: KeysView[int]) -> list[int]:
        """Return the indices of chunks that nothing tells of, or that have messages of other channels than `known`."""
        kinds = np.array([not key or not known >= self._unpacked(i).keys() for i, key in enumerate(self._counts)], bool)
        is_counted = self._column(self._FLAGS) >> np.uint64(32) & np.uint64(1) == 1
        return np.flatnonzero(self._are_chunks() & ~(is_counted & ~kinds[self._column(self._COUNTS)])).tolist()

    def chunks(self) -> list[int]:
        """Return the indices of chunks."""
        return np.flatnonzero(self._are_chunks()).tolist()

    def expanded(self, factor: int, most: int) -> list[int]:
        """Return the indices of those that become more than `factor` times their bytes, and at most `most`."""
        size = self._column(self._SIZE)
        return np.flatnonzero((size <= most) & (size > self._column(self._DATA_SIZE).astype(float) * factor)).tolist()

    def by_time(self) -> Iterator[int]:
        """Return the indices of those with messages in the order of their start; equal ones in that of the file."""
        indices = np.flatnonzero(self._filled())
        return map(int, indices[np.argsort(self._column(self._START)[indices], kind="stable")])

    def _are_chunks(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        are: np.ndarray[Any, np.dtype[np.bool_]] = self._column(self._OFFSET) != self._column(self._DATA_OFFSET)
        return are

    def _filled(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        empty = self._known_counts.get(b"", -1)
        return self._column(self._COUNTS) != empty if empty >= 0 else np.ones(len(self), bool)

    def _column(self, column: int) -> np.ndarray[Any, np.dtype[np.uint64]]:
        # A copy: an array that numpy looks at cannot grow.
        return np.array(self._numbers[column :: self._COLUMNS], np.uint64)

    def _row(self, extent: Extent) -> tuple[int, ...]:
        counts = {channel: min(count, 2**32 - 1) for channel, count in extent.counts.items() if count}
        key = struct.pack(f"<{2 * len(counts)}I", *chain.from_iterable(counts.items()))
        number = self._known_counts.setdefault(key, len(self._counts))
        if number == len(self._counts):
            self._counts.append(key)
        method = self._known_methods.setdefault(extent.compression, len(self._methods))
        if method == len(self._methods):
            self._methods.append(extent.compression)
        return (
            extent.offset, extent.data_offset, extent.data_size, extent.size,
            min(extent.start_ns, MAX_TIME_NS), min(extent.end_ns, MAX_TIME_NS),
            method << 33 | extent.is_counted << 32 | extent.crc, number,
        )  # fmt: skip

    def _unpacked(self, number: int) -> dict[int, int]:
        values = struct.unpack(f"<{len(self._counts[number]) // 4}I", self._counts[number])
        return dict(zip(values[::2], values[1::2], strict=True))
