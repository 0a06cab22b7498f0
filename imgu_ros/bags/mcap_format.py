# SPDX-License-Identifier: Apache-2.0
"""The records of an MCAP file, parsed from bytes that may be anything.

Source: the MCAP format specification (mcap.dev/spec): little-endian, every record is an opcode, a length and that many
bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

from imgu_ros.bags.chunks import ChannelRecord, MessageRecord, Record, SchemaRecord
from imgu_ros.bags.storage import MAX_TIME_NS
from imgu_ros.bags.text import text_of
from imgu_ros.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length, before every record's content.
PREFIX = struct.Struct("<BQ")
#: Enough of a record to hold everything of a chunk but its data.
HEAD_BYTES = PREFIX.size + 64

#: A larger message that is a good part of its chunk, as a picture mostly is, is not copied out of it.
_VIEWED_BYTES = 2**16

_CHUNK_FIXED = struct.Struct("<QQQI")
_MESSAGE = struct.Struct("<HIQQ")
_INDEX = struct.Struct("<HI")
_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")


class Opcode(IntEnum):
    """Record types that matter to a reader of messages."""

    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    DATA_END = 0x0F


@dataclass(frozen=True, slots=True)
class ChunkHeader:
    """A chunk without its data: times in ns, sizes in bytes; `data_offset` counts from the record's first byte."""

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    compressed_size: int
    data_offset: int


def definition_record(opcode: int, content: bytes) -> SchemaRecord | ChannelRecord | None:
    """Return what a schema or channel record defines; None for another record, and for one that does not hold.

    A definition that cannot be read costs the messages of its channels, never those of others.
    """
    parse = _DEFINITIONS.get(opcode)
    if parse is None:
        return None
    try:
        return parse(content)
    except BagError:
        return None


def _schema_record(content: bytes) -> SchemaRecord:
    (identity,) = _unpacked(_U16, content, 0)
    name, at = _string(content, 2)
    encoding, at = _string(content, at)
    text, _ = _string(content, at)
    return SchemaRecord(identity, name, encoding, text)


def _channel_record(content: bytes) -> ChannelRecord:
    (identity,) = _unpacked(_U16, content, 0)
    (schema_id,) = _unpacked(_U16, content, 2)
    topic, at = _string(content, 4)
    encoding, _ = _string(content, at)
    return ChannelRecord(identity, schema_id, topic, encoding)


_DEFINITIONS: dict[int, Callable[[bytes], SchemaRecord | ChannelRecord]] = {
    Opcode.SCHEMA: _schema_record,
    Opcode.CHANNEL: _channel_record,
}


def chunk_header(head: bytes, length: int) -> ChunkHeader:
    """Parse the head of a chunk record.

    Parameters
    ----------
    head : the record's first bytes, prefix included, `HEAD_BYTES` of them when there are as many
    length : as the record's prefix gives it

    Raises
    ------
    BagError
        If the sizes contradict each other: the record is not a chunk, or damaged.
    """
    start, end, size, crc = _unpacked(_CHUNK_FIXED, head, PREFIX.size)
    compression, at = _string(head, PREFIX.size + _CHUNK_FIXED.size)
    (compressed,) = _unpacked(_U64, head, at)
    at += _U64.size
    if at - PREFIX.size + compressed != length or (compression == "" and size != compressed):
        raise BagError(f"chunk of {length} bytes announces {compressed} bytes of data")
    return ChunkHeader(min(start, MAX_TIME_NS), min(end, MAX_TIME_NS), size, crc, compression, compressed, at)


def message_time(head: bytes, length: int) -> tuple[int, int]:
    """Return the channel id and the log time of a message record from its head (prefix included)."""
    if length < _MESSAGE.size:
        raise BagError(f"message record of {length} bytes; need {_MESSAGE.size} or more")
    channel_id, _, time_ns, _ = _unpacked(_MESSAGE, head, PREFIX.size)
    if time_ns > MAX_TIME_NS:
        raise BagError(f"message time {time_ns} ns; need at most {MAX_TIME_NS}")
    return channel_id, time_ns


def indexed_count(head: bytes, length: int) -> tuple[int, int]:
    """Return the channel id and the number of messages from the head of a message index record."""
    channel_id, array = _unpacked(_INDEX, head, PREFIX.size)
    if array + _INDEX.size != length or array % 16:
        raise BagError(f"message index of {length} bytes announces {array} bytes of entries")
    return channel_id, array // 16


def mcap_records(data: bytes) -> Iterator[Record]:
    """Yield the records of a chunk's data, one by one.

    Raises
    ------
    BagError
        Where a record does not hold; those before it have been yielded.
    """
    at = 0
    while at < len(data):
        opcode, length = _unpacked(PREFIX, data, at)
        start, end = at + PREFIX.size, at + PREFIX.size + length
        if end > len(data):
            raise BagError(f"record at byte {at} announces {length} bytes; {len(data) - start} are there")
        if opcode == Opcode.MESSAGE:
            channel_id, time_ns = message_time(data[at : start + _MESSAGE.size], length)
            content: bytes | memoryview
            if 4 * length > len(data) and length > _VIEWED_BYTES:
                content = memoryview(data)[start + _MESSAGE.size : end]
            else:  # a copy, so that a small message does not keep the whole chunk in memory
                content = data[start + _MESSAGE.size : end]
            yield MessageRecord(channel_id, time_ns, content)
        elif (definition := definition_record(opcode, data[start:end])) is not None:
            yield definition
        at = end


def _unpacked(layout: struct.Struct, data: bytes, at: int) -> tuple[int, ...]:
    try:
        return layout.unpack_from(data, at)
    except struct.error:
        raise BagError(f"record ends at byte {len(data)}; need {at + layout.size}") from None


def _string(data: bytes, at: int) -> tuple[str, int]:
    (length,) = _unpacked(_U32, data, at)
    end = at + 4 + length
    if end > len(data):
        raise BagError(f"text of {length} bytes at byte {at}; {len(data) - at - 4} are there")
    return text_of(data[at + 4 : end]), end
