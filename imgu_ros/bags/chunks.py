# SPDX-License-Identifier: Apache-2.0
"""What bag files made of chunks (MCAP, ROS 1) share: records, and the index that a walk over them gives."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class SchemaRecord:
    """A message definition: its id, the type's name, "ros2msg" or another format, and the text."""

    id: int
    name: str
    format: str
    text: str


@dataclass(frozen=True, slots=True)
class ChannelRecord:
    """A stream of messages: its id, its schema's id, topic, and "cdr" or another encoding."""

    id: int
    schema_id: int
    topic: str
    encoding: str


@dataclass(frozen=True, slots=True, eq=False)
class MessageRecord:
    """A message: its channel's id, the time of recording in ns, serialised bytes."""

    channel_id: int
    time_ns: int
    data: bytes | memoryview


Record = SchemaRecord | ChannelRecord | MessageRecord


@dataclass(slots=True, eq=False)
class Stretch:
    """A chunk, or some messages outside of chunks.

    Attributes
    ----------
    offset : of its first record's first byte in the file
    data_offset, data_size : of its records in the file, compressed as they are
    compression : "", "zstd", "lz4", "bz2"
    size : of its records, decompressed
    crc : CRC-32 of the decompressed records; 0: not known
    start_ns, end_ns : times of its first and last message
    counts : messages by channel id
    is_counted : `counts` is complete; otherwise the data must be read to know
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


@dataclass(frozen=True, slots=True)
class Gap:
    """Bytes `start` to `end` of the file that hold no record."""

    start: int
    end: int


@dataclass(slots=True, eq=False)
class ChunkIndex:
    """What the walk over a file's records found.

    Attributes
    ----------
    stretches : in the order of the file
    schemas, channels : by id, those outside of chunks
    gaps : bytes that could not be understood
    is_complete : the file's proper end was found
    """

    stretches: list[Stretch] = field(default_factory=list)
    schemas: dict[int, SchemaRecord] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    gaps: list[Gap] = field(default_factory=list)
    is_complete: bool = False

    def define(self, record: SchemaRecord | ChannelRecord) -> None:
        """Take a definition; of two with the same id, the first counts."""
        if isinstance(record, SchemaRecord):
            self.schemas.setdefault(record.id, record)
        else:
            self.channels.setdefault(record.id, record)
