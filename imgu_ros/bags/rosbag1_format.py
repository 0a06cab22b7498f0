# SPDX-License-Identifier: Apache-2.0
"""The records of a ROS 1 bag file, and the walk over them; unindexed and cut files are walked like whole ones.

Source: the bag format 2.0 (wiki.ros.org/Bags/Format/2.0): every record is a header of named fields and data, each after
its length.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.chunks import ChannelRecord, ChunkIndex, Gap, MessageRecord, Record, SchemaRecord, Stretch
from imgu_ros.bags.storage import MAX_BYTES, Serialization
from imgu_ros.bags.text import text_of
from imgu_ros.errors import BagError

MAGIC = b"#ROSBAG V2.0\n"

_U32 = struct.Struct("<I")
# No header of a record of known type comes near; a connection's long definition is data.
_MAX_HEADER = 2**20
_HEAD_BYTES = 2**10
_SEARCH_BYTES = 2**20
_COMPRESSIONS = {"none": "", "bz2": "bz2", "lz4": "lz4"}


class Opcode(IntEnum):
    """Record types."""

    MESSAGE = 2
    BAG_HEADER = 3
    INDEX = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7


@dataclass(frozen=True, slots=True, eq=False)
class RecordHeader:
    """A record without its data: `fields` by name, `data_offset` from the record's first byte, `data_size`."""

    fields: dict[str, bytes]
    data_offset: int
    data_size: int

    @property
    def opcode(self) -> int:
        """The record's type."""
        return self.number("op", 1)

    def number(self, name: str, size: int = 4) -> int:
        """Return a field's unsigned number of `size` bytes; BagError when there is none."""
        value = self.fields.get(name, b"")
        if len(value) != size:
            raise BagError(f"record field {name!r} has {len(value)} bytes; need {size}")
        return int.from_bytes(value, "little")

    def text(self, name: str) -> str:
        """Return a field's text; BagError when there is none."""
        if name not in self.fields:
            raise BagError(f"record has no field {name!r}")
        return text_of(self.fields[name])

    def time_ns(self) -> int:
        """Return the time of a message in ns; BagError when there is none."""
        value = self.number("time", 8)
        return (value & 0xFFFFFFFF) * 10**9 + (value >> 32)


def index_rosbag1(file: ByteFile) -> ChunkIndex:
    """Walk the records of a ROS 1 bag.

    Raises
    ------
    BagError
        If it does not begin as one, is encrypted, or cannot be read.
    """
    magic = file.read(0, min(file.size, len(MAGIC)))
    if magic != MAGIC:
        raise BagError(f"{file.path}: begins with {magic!r}; need {MAGIC!r}")
    found = ChunkIndex()
    announced = -1
    at = len(MAGIC)
    while at < file.size:
        try:
            header = _header_at(file, at)
            if header.opcode == Opcode.BAG_HEADER:
                if header.fields.get("encryptor"):
                    raise BagError(f"{file.path}: encrypted; need a bag that is not")
                announced = header.number("chunk_count") if header.number("index_pos", 8) else -1
            else:
                _take(found, file, at, header)
            at += header.data_offset + header.data_size
        except BagError:
            if at == len(MAGIC):  # not even the bag's header
                raise
            at = _recovered(found, file, at)
    # A recorder writes the index, and then the number of chunks into the header, when it stops.
    found.is_complete = announced == len(found.stretches)
    return found


def rosbag1_records(data: bytes) -> Iterator[Record]:
    """Yield the records of a chunk's data.

    Raises
    ------
    BagError
        Where a record does not hold; those before it have been yielded.
    """
    at = 0
    while at < len(data):
        header = record_header(data, at)
        start = at + header.data_offset
        end = start + header.data_size
        if end > len(data):
            raise BagError(f"record at byte {at} announces {header.data_size} bytes; {len(data) - start} are there")
        if header.opcode == Opcode.MESSAGE:
            yield MessageRecord(header.number("conn"), header.time_ns(), data[start:end])
        elif header.opcode == Opcode.CONNECTION:
            yield from _definitions(header, data[start:end])
        at = end


def record_header(data: bytes, at: int) -> RecordHeader:
    """Parse the header of the record at `at`; BagError when it does not hold."""
    length = _u32(data, at)
    if length > _MAX_HEADER:
        raise BagError(f"record header of {length} bytes; need at most {_MAX_HEADER}")
    end = at + 4 + length
    fields = _fields(data[at + 4 : end], length)
    return RecordHeader(fields, end + 4 - at, _u32(data, end))


def _header_at(file: ByteFile, at: int) -> RecordHeader:
    """Read the header of the record at `at` of the file; BagError when its data reach beyond the end."""
    head = file.read(at, min(_HEAD_BYTES, file.size - at))
    length = _u32(head, 0)
    if length + 8 > len(head):
        head = file.read(at, min(min(length, _MAX_HEADER) + 8, file.size - at))
    header = record_header(head, 0)
    if at + header.data_offset + header.data_size > file.size:
        raise BagError(f"record of {header.data_size} bytes at byte {at} reaches beyond the end")
    return header


def _take(found: ChunkIndex, file: ByteFile, at: int, header: RecordHeader) -> None:
    start = at + header.data_offset
    if header.opcode == Opcode.CHUNK:
        compression = header.text("compression")
        method = _COMPRESSIONS.get(compression, compression)
        found.stretches.append(Stretch(at, start, header.data_size, method, header.number("size"), 0, 0, 0))
    elif header.opcode == Opcode.INDEX and found.stretches:
        _count(found.stretches[-1], header.number("conn"), file.read(start, header.data_size))
    elif header.opcode == Opcode.CONNECTION:
        if header.data_size > MAX_BYTES:
            raise BagError(f"connection of {header.data_size} bytes")
        for record in _definitions(header, file.read(start, header.data_size)):
            found.define(record)


def _count(chunk: Stretch, connection: int, entries: bytes) -> None:
    """Take a chunk's index record: times (s, ns) and offsets of one connection's messages."""
    if len(entries) % 12:
        raise BagError(f"index of {len(entries)} bytes; need a multiple of 12")
    times = [s * 10**9 + ns for s, ns, _ in struct.iter_unpack("<III", entries)]
    if times:
        chunk.start_ns = min([chunk.start_ns, *times]) if chunk.is_counted else min(times)
        chunk.end_ns = max([chunk.end_ns, *times])
        chunk.counts[connection] = chunk.counts.get(connection, 0) + len(times)
        chunk.is_counted = True


def _definitions(header: RecordHeader, data: bytes) -> Iterator[SchemaRecord | ChannelRecord]:
    """Yield what a connection record defines; of one that cannot be read, what can be.

    Its data are a header as of a connection between nodes: callerid, md5sum, latching and others that nobody reads.
    """
    fields: dict[str, bytes] = {}
    try:
        identity = header.number("conn")
    except BagError:
        return
    with suppress(BagError):
        _take_fields(fields, data, len(data))
    yield SchemaRecord(
        identity, text_of(fields.get("type", b"")), "ros1msg", text_of(fields.get("message_definition", b""))
    )
    topic = header.fields.get("topic") or fields.get("topic", b"")
    yield ChannelRecord(identity, identity, text_of(topic), Serialization.ROS1)


def _recovered(found: ChunkIndex, file: ByteFile, broken: int) -> int:
    """Return the place of the next chunk after a broken record: the file's end when there is none."""
    if found.stretches:
        found.stretches[-1].is_counted = False  # its index may be among what is broken
    at = broken + 1
    while at < file.size:
        block = file.read(at, min(_SEARCH_BYTES, file.size - at))
        hit = block.find(b"op=\x05")
        while hit >= 0:
            for start in range(max(broken + 1, at + hit - 100), at + hit - 7):
                if _is_chunk(file, start):
                    found.gaps.append(Gap(broken, start))
                    return start
            hit = block.find(b"op=\x05", hit + 1)
        at += max(1, len(block) - 3)
    found.gaps.append(Gap(broken, file.size))
    return file.size


def _is_chunk(file: ByteFile, at: int) -> bool:
    try:
        header = _header_at(file, at)
        return header.opcode == Opcode.CHUNK and header.text("compression") in _COMPRESSIONS
    except BagError:
        return False


def _fields(data: bytes, length: int) -> dict[str, bytes]:
    fields: dict[str, bytes] = {}
    _take_fields(fields, data, length)
    return fields


def _take_fields(fields: dict[str, bytes], data: bytes, length: int) -> None:
    """Add the fields of a header; BagError where they break off."""
    if len(data) != length:
        raise BagError(f"record header of {length} bytes; {len(data)} are there")
    at = 0
    while at < length:
        size = _u32(data, at)
        name, separator, value = data[at + 4 : at + 4 + size].partition(b"=")
        if at + 4 + size > length or not separator:
            raise BagError(f"record field at byte {at} of {size} bytes cannot be parsed")
        fields[text_of(name)] = value
        at += 4 + size


def _u32(data: bytes, at: int) -> int:
    if at + 4 > len(data):
        raise BagError(f"record ends at byte {len(data)}; need {at + 4}")
    (value,) = _U32.unpack_from(data, at)
    return int(value)
