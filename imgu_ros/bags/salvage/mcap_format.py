# SPDX-License-Identifier: Apache-2.0
"""The records of an MCAP file, parsed from bytes that may be anything.

Source: the MCAP format specification (mcap.dev/spec): little-endian, every record is an opcode, a length and that many
bytes; readers skip the opcodes that they do not know.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from imgu_ros.bags.salvage.chunks import ChannelRecord, ChunkContents, DeclaredContents, SchemaRecord
from imgu_ros.bags.storage import MAX_TIME_NS
from imgu_ros.bags.text import text_of
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
#: McapOpcode and length, before every record's content.
PREFIX = struct.Struct("<BQ")
#: Enough of a record to hold everything of a chunk but its data, and the first entry of an index.
HEAD_BYTES = PREFIX.size + 64
#: The method is a short word; a longer one is none.
COMPRESSIONS = ("", "zstd", "lz4")
COMPRESSION_LENGTHS = {len(name).to_bytes(4, "little") for name in COMPRESSIONS}

_CHUNK_FIXED = struct.Struct("<QQQI")
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_BYTES = _MESSAGE.size - PREFIX.size
_INDEX = struct.Struct("<HI")
_STATISTICS = struct.Struct("<QHIIIIQQI")
_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")


class McapOpcode(IntEnum):
    """Record types that matter to a reader of messages."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    STATISTICS = 0x0B
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


def definition_record(
    opcode: int, content: bytes | memoryview, limits: LimitsParameters
) -> SchemaRecord | ChannelRecord | None:
    """Return what a schema or channel record defines; None for another record, and for one that does not hold.

    A definition that cannot be read costs the messages of its channels, never those of others; one that is longer than
    `limits.text_mb` loses its text.
    """
    try:
        if opcode == McapOpcode.SCHEMA:
            return _schema_record(content, 1_000_000 * limits.text_mb)
        return _channel_record(content, 1_000_000 * limits.text_mb) if opcode == McapOpcode.CHANNEL else None
    except BagError:
        return None


def _schema_record(content: bytes | memoryview, most: int) -> SchemaRecord:
    (identity,) = _unpacked(_U16, content, 0)
    name, at = _string(content, 2, most)
    encoding, at = _string(content, at, most)
    text, _ = _string(content, at, most)
    return SchemaRecord(identity, name, encoding, text)


def _channel_record(content: bytes | memoryview, most: int) -> ChannelRecord:
    (identity,) = _unpacked(_U16, content, 0)
    (schema_id,) = _unpacked(_U16, content, 2)
    topic, at = _string(content, 4, most)
    encoding, _ = _string(content, at, most)
    return ChannelRecord(identity, schema_id, topic, encoding)


def chunk_header(head: bytes, length: int, *, is_sure: bool = False) -> ChunkHeader:
    """Parse the head of a chunk record.

    Parameters
    ----------
    head : the record's first bytes, prefix included, `HEAD_BYTES` of them when there are as many
    length : as the record's prefix gives it
    is_sure : the length is right, so that sizes that contradict it are not believed

    Raises
    ------
    BagError
        If the sizes contradict each other: the record is not a chunk, or damaged.
    """
    start, end, size, crc = _unpacked(_CHUNK_FIXED, head, PREFIX.size)
    compression, at = _string(head, PREFIX.size + _CHUNK_FIXED.size, len(head))
    (compressed,) = _unpacked(_U64, head, at)
    at += _U64.size
    if is_sure and compression in COMPRESSIONS and at - PREFIX.size <= length:
        compressed = length + PREFIX.size - at
        size = size if compression else compressed
    if at - PREFIX.size + compressed != length or (compression == "" and size != compressed):
        raise BagError(f"chunk of {length} bytes announces {compressed} bytes of data")
    return ChunkHeader(min(start, MAX_TIME_NS), min(end, MAX_TIME_NS), size, crc, compression, compressed, at)


def chunk_length(head: bytes) -> int:
    """Return the length of a chunk record by the sizes in it, whatever its prefix says; 0 when there are none."""
    at = PREFIX.size + _CHUNK_FIXED.size
    if head[at : at + 4] not in COMPRESSION_LENGTHS or len(head) < HEAD_BYTES:
        return 0
    at += 4 + head[at]
    (compressed,) = _U64.unpack_from(head, at)
    return int(at + _U64.size + compressed - PREFIX.size)


def message_head(head: bytes, length: int) -> tuple[int, int] | None:
    """Return the channel id and the log time of a message record from its head (prefix included); None: too short."""
    if length < _MESSAGE_BYTES:
        return None
    _, _, channel_id, _, time_ns, _ = _unpacked(_MESSAGE, head, 0)
    return channel_id, min(time_ns, MAX_TIME_NS)


def index_head(head: bytes, length: int) -> tuple[int, int, int]:
    """Return channel id, number of messages, and the first one's time from the head of a message index record."""
    channel_id, array = _unpacked(_INDEX, head, PREFIX.size)
    if array + _INDEX.size != length or array % 16:
        raise BagError(f"message index of {length} bytes announces {array} bytes of entries")
    (first_ns,) = _unpacked(_U64, head, PREFIX.size + _INDEX.size) if array else (MAX_TIME_NS,)
    return channel_id, array // 16, min(first_ns, MAX_TIME_NS)


def statistics(content: bytes, listed_chunks: int) -> DeclaredContents:
    """Return what a statistics record promises; BagError when it does not hold."""
    messages, _, _, _, _, chunks, start_ns, end_ns, length = _unpacked(_STATISTICS, content, 0)
    entries = content[_STATISTICS.size : _STATISTICS.size + length]
    if len(entries) != length or length % 10:
        raise BagError(f"statistics announce {length} bytes of counts; {len(entries)} are there")
    counts = {channel: count for channel, count in struct.iter_unpack("<HQ", entries) if count}
    return DeclaredContents("statistics", messages, chunks, listed_chunks, counts, start_ns, end_ns)


def mcap_contents(data: memoryview, limits: LimitsParameters, most: int) -> ChunkContents:
    """Parse the records of a chunk's data, until one does not hold, or there are more than `most` messages."""
    found = ChunkContents()
    add_channel, add_time = found.channels.append, found.times.append
    add_begin, add_end = found.begins.append, found.ends.append
    at, size, left = 0, len(data), most
    message_from, message_bytes = _MESSAGE.unpack_from, _MESSAGE.size
    while at < size:
        if size - at >= message_bytes:
            opcode, length, channel_id, _, time_ns, _ = message_from(data, at)
        elif size - at >= PREFIX.size:
            opcode, length = PREFIX.unpack_from(data, at)
        else:
            found.damage = f"record ends at byte {size}; need {at + PREFIX.size}"
            break
        start = at + PREFIX.size
        end = start + length
        if end > size:
            found.damage = f"record at byte {at} announces {length} bytes; {size - start} are there"
            break
        if opcode == McapOpcode.MESSAGE:
            if length >= _MESSAGE_BYTES:
                if not left:
                    found.end_with(most)
                    break
                left -= 1
                add_channel(channel_id)
                add_time(time_ns if time_ns <= MAX_TIME_NS else MAX_TIME_NS)
                add_begin(at + message_bytes)
                add_end(end)
        elif opcode in (McapOpcode.SCHEMA, McapOpcode.CHANNEL):
            known = found.definitions.schemas if opcode == McapOpcode.SCHEMA else found.definitions.channels
            if length >= 2 and _U16.unpack_from(data, start)[0] not in known:
                definition = definition_record(opcode, data[start:end], limits)
                if definition is not None:
                    found.definitions.define(definition)
        elif opcode == 0:
            found.damage = f"record at byte {at} has opcode 0"
            break
        elif opcode in (McapOpcode.CHUNK, McapOpcode.MESSAGE_INDEX, McapOpcode.FOOTER):
            found.note_foreign(at)
        at = end
    found.size = at
    return found


def _unpacked(layout: struct.Struct, data: bytes | memoryview, at: int) -> tuple[int, ...]:
    try:
        return layout.unpack_from(data, at)
    except struct.error:
        raise BagError(f"record ends at byte {len(data)}; need {at + layout.size}") from None


def _string(data: bytes | memoryview, at: int, most: int) -> tuple[str, int]:
    """Return the text at a place, and the place behind it; one longer than `most` bytes as an empty one."""
    (length,) = _unpacked(_U32, data, at)
    end = at + 4 + length
    if end > len(data):
        raise BagError(f"text of {length} bytes at byte {at}; {len(data) - at - 4} are there")
    return text_of(bytes(data[at + 4 : end])) if length <= most else "", end
