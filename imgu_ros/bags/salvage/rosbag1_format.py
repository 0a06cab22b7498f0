# SPDX-License-Identifier: Apache-2.0
"""The records of a ROS 1 bag file, parsed from bytes that may be anything.

Source: the bag format 2.0 (wiki.ros.org/Bags/Format/2.0): every record is a header of named fields and data, each after
its length.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum

from imgu_ros.bags.salvage.chunks import ChannelRecord, ChunkContents, Definitions, SchemaRecord
from imgu_ros.bags.storage import Serialization
from imgu_ros.bags.text import text_of
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

MAGIC = b"#ROSBAG V2.0\n"

_U32 = struct.Struct("<I")
# No header of a record of known type comes near; a connection's long definition is data.
MAX_HEADER = 2**20
COMPRESSIONS = {"none": "", "bz2": "bz2", "lz4": "lz4"}


class Rosbag1Opcode(IntEnum):
    """Record types."""

    MESSAGE = 2
    BAG_HEADER = 3
    INDEX = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7


_NOT_IN_CHUNKS = (Rosbag1Opcode.BAG_HEADER, Rosbag1Opcode.CHUNK, Rosbag1Opcode.INDEX, Rosbag1Opcode.CHUNK_INFO)


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


def rosbag1_contents(data: memoryview, limits: LimitsParameters, most: int) -> ChunkContents:
    """Parse the records of a chunk's data, until one does not hold, or there are more than `most` messages."""
    found = ChunkContents()
    at = 0
    while at < len(data):
        try:
            header = record_header(data, at, is_sure=True)
        except BagError as error:
            found.damage = str(error)
            break
        start = at + header.data_offset
        end = start + header.data_size
        if end > len(data):
            found.damage = f"record at byte {at} announces {header.data_size} bytes; {len(data) - start} are there"
            break
        with suppress(BagError):  # a record without what its type needs costs itself alone
            opcode = header.opcode
            if opcode == Rosbag1Opcode.MESSAGE:
                if len(found.times) >= most:
                    found.end_with(most)
                    break
                found.add(header.number("conn"), header.time_ns(), start, end)
            elif opcode == Rosbag1Opcode.CONNECTION:
                define(found.definitions, header, data[start:end], limits)
            elif opcode in (
                Rosbag1Opcode.BAG_HEADER,
                Rosbag1Opcode.CHUNK,
                Rosbag1Opcode.INDEX,
                Rosbag1Opcode.CHUNK_INFO,
            ):
                found.note_foreign(at)
        at = end
    found.size = at
    return found


def record_header(data: bytes | memoryview, at: int, *, is_sure: bool = False) -> RecordHeader:
    """Parse the header of the record at `at`; BagError when it does not hold.

    Where it is sure that there is a record, its lengths are enough: fields that cannot be parsed are left out.
    """
    length = _u32(data, at)
    if length > MAX_HEADER:
        raise BagError(f"record header of {length} bytes; need at most {MAX_HEADER}")
    end = at + 4 + length
    fields: dict[str, bytes] = {}
    try:
        _take_fields(fields, bytes(data[at + 4 : end]), length)
    except BagError:
        if not is_sure:
            raise
    return RecordHeader(fields, end + 4 - at, _u32(data, end))


def define(definitions: Definitions, header: RecordHeader, data: bytes | memoryview, limits: LimitsParameters) -> None:
    """Take what a connection record defines; of one that cannot be read, what can be.

    Its data are a header as of a connection between nodes: callerid, md5sum, latching and others, which are not used.
    """
    fields: dict[str, bytes] = {}
    identity = header.number("conn")
    if identity in definitions.channels:
        return
    with suppress(BagError):
        _take_fields(fields, bytes(data), len(data))
    text = fields.get("message_definition", b"")
    if len(text) > 1_000_000 * limits.text_mb:
        text = b""
    definitions.define(SchemaRecord(identity, text_of(fields.get("type", b"")), "ros1msg", text_of(text)))
    topic = header.fields.get("topic") or fields.get("topic", b"")
    definitions.define(ChannelRecord(identity, identity, text_of(topic), Serialization.ROS1))


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


def _u32(data: bytes | memoryview, at: int) -> int:
    if at + 4 > len(data):
        raise BagError(f"record ends at byte {len(data)}; need {at + 4}")
    (value,) = _U32.unpack_from(data, at)
    return int(value)
