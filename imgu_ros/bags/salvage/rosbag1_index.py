# SPDX-License-Identifier: Apache-2.0
"""Index a ROS 1 bag, intact, unindexed, truncated or damaged, by walking its records from the first to the last.

Behind a broken record the walk searches for the next chunk or index record, from the last position that is sure.
Concatenated bags are indexed one after the other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.salvage.chunks import ChunkFormat, ChunkIndex, DeclaredContents, Gap, walked_files
from imgu_ros.bags.salvage.extents import Extent
from imgu_ros.bags.salvage.rosbag1_format import (
    COMPRESSIONS,
    MAGIC,
    MAX_HEADER,
    RecordHeader,
    Rosbag1Opcode,
    define,
    record_header,
    rosbag1_contents,
)
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

_HEAD_BYTES = 2**8
#: A record of the index with more connections is none.
_MOST_CHUNK_INFO_BYTES = 2**20
_INDEX_BYTES = 12 * 2**16
_MOST_REMARKS = 20
#: Messages outside of chunks are read in extents of about this size.
_EXTENT_BYTES = 2**22
# A header whose first field has a name; each match is one byte, so that overlapping candidates are all found.
_HEADER = rb"[\x18-\x80](?=\0\0\0[\x04-\x40]\0\0\0[a-z].{0,120}?op=[%s])"
_CANDIDATE = re.compile(_HEADER % rb"\x05\x06\x07" + rb"|#(?=ROSBAG V2\.0\n)", re.DOTALL)
_CHUNK_CANDIDATE = re.compile(_HEADER % rb"\x05", re.DOTALL)


def index_rosbag1(file: ByteFile, limits: LimitsParameters) -> list[ChunkIndex]:
    """Walk the records of a ROS 1 bag; of several, when the file is made of several.

    Raises
    ------
    BagError
        If it does not begin as one, is encrypted, or cannot be read.
    """
    magic = file.read(0, min(file.size, len(MAGIC)))
    if magic != MAGIC:
        raise BagError(f"{file.path}: begins with {magic!r}; need {MAGIC!r}")

    def walked(at: int) -> tuple[ChunkIndex, int]:
        walk = _Rosbag1Walk(file, at, limits)
        return walk.found, walk.over(at)

    return walked_files(walked, len(MAGIC))


def rosbag1_chunks(file: ByteFile, start: int, end: int) -> Iterator[Extent]:
    """Yield the chunks between two places of a file, in file order."""
    for at in file.find(_CHUNK_CANDIDATE, start, end, _HEAD_BYTES):
        if at < start:
            continue
        try:
            header = _header_at(file, at)
            if header.opcode != Rosbag1Opcode.CHUNK or header.text("compression") not in COMPRESSIONS:
                continue
            extent = _extent(at, header)
        except BagError:
            continue
        if extent.end <= end:
            yield extent
            start = extent.end


ROSBAG1 = ChunkFormat(index_rosbag1, rosbag1_contents, rosbag1_chunks)


class _EncryptedError(BagError):
    """Nothing of the bag can be read."""


class _Rosbag1Walk:
    def __init__(self, file: ByteFile, start: int, limits: LimitsParameters) -> None:
        self.file, self.limits, self.start = file, limits, start
        self.found = ChunkIndex()
        self.last: Extent | None = None  # not yet in the table
        self.sure = start  # a search for the next record starts behind it: what is before has the right length
        self.announced = -1
        self.listed_chunks = 0
        self.counts: dict[int, int] = {}
        self.next_file = -1

    def over(self, at: int) -> int:
        """Walk from the byte behind the magic; return the same place of the bag that follows, -1 when none does."""
        while at < self.file.size and self.next_file < 0:
            try:
                at = self.next_record(at)
            except _EncryptedError:
                raise
            except BagError:
                at = self.stepped_over(at) or self.recovered(at)
        self.close_extent()
        found = self.found
        # A recorder writes the index, and then the number of chunks into the header, when it stops.
        found.is_complete = self.announced == found.chunks
        if self.announced >= 0:
            listed = self.listed_chunks
            messages = sum(self.counts.values()) if listed else -1
            found.declared = DeclaredContents("index", messages, self.announced, listed, self.counts)
        return self.next_file

    def next_record(self, at: int) -> int:
        """Take the record at `at`; return the next one's place. BagError when there is no record."""
        header = _header_at(self.file, at)
        start, opcode = at + header.data_offset, header.opcode
        end = start + header.data_size
        sure = at
        if opcode == Rosbag1Opcode.CHUNK:
            end = self.take_chunk(at, header)
        elif opcode == Rosbag1Opcode.INDEX:
            self.take_index(header, start)
            sure = end
        elif opcode == Rosbag1Opcode.MESSAGE:
            self.take_message(at, end, header.number("conn"), header.time_ns())
        else:
            self.close_extent()
            if opcode == Rosbag1Opcode.BAG_HEADER:
                if header.fields.get("encryptor"):
                    raise _EncryptedError(f"{self.file.path}: encrypted; need a bag that is not")
                with suppress(BagError):
                    self.announced = header.number("chunk_count") if header.number("index_pos", 8) else -1
            elif opcode == Rosbag1Opcode.CONNECTION:
                if header.data_size > 1_000_000 * self.limits.message_mb:
                    raise BagError(f"connection of {header.data_size} bytes")
                define(self.found.summary, header, self.file.read(start, header.data_size), self.limits)
            elif opcode == Rosbag1Opcode.CHUNK_INFO:
                self.take_chunk_info(header, start)
        self.sure = sure
        return end

    def stepped_over(self, at: int) -> int:
        """Return the place behind a record whose lengths hold, though its fields do not; 0 when they do not."""
        head = self.file.head(at, _HEAD_BYTES)
        end = at + 4 + int.from_bytes(head[:4], "little")
        end += 4 + int.from_bytes(self.file.head(end, 4), "little")
        if len(head) < 8 or end >= self.file.size or not self.is_followed(end):
            return 0
        if self.last is not None and not self.last.is_run:
            self.last.is_counted = False
        if len(self.found.remarks) < _MOST_REMARKS:
            self.found.remarks.append(f"the record at byte {at} is skipped: its fields cannot be read")
        self.sure = at
        return end

    def take_chunk(self, at: int, header: RecordHeader) -> int:
        """Note a chunk; of one that is not compressed, size and length must be the same: what is followed counts."""
        extent = _extent(at, header)
        if extent.compression == "" and extent.size != extent.data_size:
            sizes = [size for size in (extent.data_size, extent.size) if self.is_followed(extent.data_offset + size)]
            if not sizes:
                raise BagError(f"chunk of {extent.data_size} bytes announces {extent.size}")
            extent.size = extent.data_size = sizes[0]
        self.close_extent()
        self.last = extent
        self.found.chunks += 1
        return extent.end

    def take_index(self, header: RecordHeader, start: int) -> None:
        """Take a chunk's index record: times (s, ns) and offsets of one connection's messages."""
        if header.data_size % 12:
            raise BagError(f"index of {header.data_size} bytes; need a multiple of 12")
        chunk = self.last
        if chunk is None or chunk.is_run or not header.data_size:
            return
        connection = header.number("conn")
        for at in range(start, start + header.data_size, _INDEX_BYTES):
            entries = self.file.read(at, min(_INDEX_BYTES, start + header.data_size - at))
            numbers = np.frombuffer(entries, "<u4").reshape(-1, 3).astype(np.int64)
            times = numbers[:, 0] * 10**9 + numbers[:, 1]
            first, last = int(times.min()), int(times.max())
            chunk.start_ns = min(chunk.start_ns, first) if chunk.is_counted else first
            chunk.end_ns = max(chunk.end_ns, last)
            chunk.counts[connection] = chunk.counts.get(connection, 0) + len(times)
            chunk.is_counted = True

    def take_message(self, at: int, end: int, connection: int, time_ns: int) -> None:
        """Note a message outside of chunks, as no recorder writes it."""
        run = self.last
        if run is None or not run.is_run or run.end != at or end - run.offset > _EXTENT_BYTES:
            self.close_extent()
            run = self.last = Extent(at, at, 0, "", 0, 0, time_ns, time_ns, is_counted=True)
        run.size = run.data_size = end - run.offset
        run.start_ns, run.end_ns = min(run.start_ns, time_ns), max(run.end_ns, time_ns)
        run.counts[connection] = run.counts.get(connection, 0) + 1

    def take_chunk_info(self, header: RecordHeader, start: int) -> None:
        if header.data_size != 8 * header.number("count") or header.data_size > _MOST_CHUNK_INFO_BYTES:
            raise BagError(f"chunk info of {header.data_size} bytes for {header.number('count')} connections")
        self.listed_chunks += 1
        numbers = np.frombuffer(self.file.read(start, header.data_size), "<u4").reshape(-1, 2)
        for connection, count in numbers.tolist():
            if count:
                self.counts[connection] = self.counts.get(connection, 0) + count

    def close_extent(self) -> None:
        """Put what is complete into the table; a chunk without data has no message."""
        if self.last is not None and self.last.data_size:
            self.found.extents.append(self.last)
        self.last = None

    def recovered(self, broken: int) -> int:
        """Return where the walk can go on after a broken record: the file's end when nowhere."""
        if self.last is not None and not self.last.is_run:
            self.last.is_counted = False  # its index may be among what is broken
        self.close_extent()
        start = self.sure
        if self.file.head(broken, len(MAGIC)) == MAGIC:
            if broken == self.start:
                return broken + len(MAGIC)
            start = broken - 1  # the bag that follows another begins where the other's last record ends
        for at in self.file.find(_CANDIDATE, start + 1, self.file.size, _HEAD_BYTES):
            if self.is_record(at):
                self.found.gaps.append(Gap(broken if at > broken else start, at))
                self.sure = at
                return at
            if self.next_file >= 0:
                if at > broken:
                    self.found.gaps.append(Gap(broken, at))
                return at
        self.found.gaps.append(Gap(broken, self.file.size))
        return self.file.size

    def is_record(self, at: int) -> bool:
        """Whether a chunk, or another record that others follow, begins at `at`."""
        if self.file.head(at, len(MAGIC)) == MAGIC:
            self.next_file = at + len(MAGIC)
            self.found.remarks.append(f"another bag follows at byte {at}: read on")
            return False
        try:
            header = _header_at(self.file, at)
            if header.opcode == Rosbag1Opcode.CHUNK:
                return header.text("compression") in COMPRESSIONS
            return self.is_followed(at + header.data_offset + header.data_size)
        except BagError:
            return False

    def is_followed(self, at: int) -> bool:
        """Whether another record, or the file's end, is at `at`."""
        try:
            return at == self.file.size or bool(_header_at(self.file, at).opcode)
        except BagError:
            return False


def _extent(at: int, header: RecordHeader) -> Extent:
    compression = header.text("compression")
    method = COMPRESSIONS.get(compression, compression)
    return Extent(at, at + header.data_offset, header.data_size, method, header.number("size"), 0, 0, 0)


def _header_at(file: ByteFile, at: int) -> RecordHeader:
    """Read the header of the record at `at` of the file; BagError when its data reach beyond the end."""
    head = file.head(at, _HEAD_BYTES)
    length = int.from_bytes(head[:4], "little")
    if length > MAX_HEADER:
        raise BagError(f"record header of {length} bytes; need at most {MAX_HEADER}")
    if length + 8 > len(head):
        head = file.head(at, length + 8)
    header = record_header(head, 0)
    if at + header.data_offset + header.data_size > file.size:
        raise BagError(f"record of {header.data_size} bytes at byte {at} reaches beyond the end")
    return header
