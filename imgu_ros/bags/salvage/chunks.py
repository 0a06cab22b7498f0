# SPDX-License-Identifier: Apache-2.0
"""What bag files made of chunks (MCAP, ROS 1) share: records, and what a walk over a file found."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from operator import le
from typing import Protocol

import numpy as np

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.salvage.extents import Extent, ExtentTable
from imgu_ros.bags.storage import MAX_TIME_NS
from imgu_ros.config.parameters import LimitsParameters

#: A larger message that is a good part of its chunk, as a picture mostly is, is not copied out of it.
_VIEWED_BYTES = 2**16
_MOST_TEXT = 2**26
#: That a definition takes beside its texts.
_RECORD_BYTES = 200
#: Of files in one: each takes some kilobytes and a part of a millisecond, and may have 40 bytes.
_MOST_FILES = 5000
#: Numbers that are compared faster one by one than as an array.
_FEW = 50


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


@dataclass(slots=True, eq=False)
class DefinitionBudget:
    """What definitions may take together, `_MOST_TEXT` bytes; a text that comes again takes nothing."""

    left: int = _MOST_TEXT
    texts: dict[str, str] = field(default_factory=dict)

    def kept(self, record: SchemaRecord | ChannelRecord) -> SchemaRecord | ChannelRecord | None:
        """Return the record, its text as it is known; None when there is no budget for it."""
        if isinstance(record, ChannelRecord):
            text, size = "", len(record.topic)
        else:
            text, size = record.text, len(record.name)
        size += _RECORD_BYTES + (0 if text in self.texts else len(text))
        if size > self.left:
            return None
        self.left -= size
        return record if isinstance(record, ChannelRecord) else replace(record, text=self.texts.setdefault(text, text))


@dataclass(slots=True, eq=False)
class Definitions:
    """Definitions by their ids; of two with the same id, the first counts. Beyond their budget they are not taken."""

    schemas: dict[int, SchemaRecord] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    budget: DefinitionBudget = field(default_factory=DefinitionBudget)

    def define(self, record: SchemaRecord | ChannelRecord) -> None:
        """Take a definition."""
        if record.id in (self.schemas if isinstance(record, SchemaRecord) else self.channels):
            return
        kept = self.budget.kept(record)
        if isinstance(kept, SchemaRecord):
            self.schemas[kept.id] = kept
        elif kept is not None:
            self.channels[kept.id] = kept

    def share(self, budget: DefinitionBudget) -> None:
        """Take from a budget that others take from too."""
        records: list[SchemaRecord | ChannelRecord] = [*self.schemas.values(), *self.channels.values()]
        kept = [budget.kept(record) for record in records]
        self.budget = budget
        self.schemas = {record.id: record for record in kept if isinstance(record, SchemaRecord)}
        self.channels = {record.id: record for record in kept if isinstance(record, ChannelRecord)}

    def take(self, other: Definitions) -> None:
        """Take what another one defines and this one does not."""
        for schema in other.schemas.values():
            self.define(schema)
        for channel in other.channels.values():
            self.define(channel)


@dataclass(slots=True, eq=False)
class ChunkContents:
    """What the decompressed data of a chunk hold: places of messages, not the messages, which may be millions.

    Attributes
    ----------
    channels, times, begins, ends : of each message, in the order of the data: channel id, ns, place of its bytes
    definitions : those among the records
    damage : why reading broke off; empty when it did not
    size : bytes that were read until then
    foreign_at : place of the first record that does not belong into a chunk; -1: there is none
    """

    channels: array[int] = field(default_factory=lambda: array("I"))
    times: array[int] = field(default_factory=lambda: array("q"))
    begins: array[int] = field(default_factory=lambda: array("Q"))
    ends: array[int] = field(default_factory=lambda: array("Q"))
    definitions: Definitions = field(default_factory=Definitions)
    damage: str = ""
    size: int = 0
    foreign_at: int = -1

    def end_with(self, most: int) -> None:
        """Note that reading broke off because there are more messages than `most`."""
        self.damage = f"more than {most} messages of so few bytes; need longer ones, or fewer (limits.expansion)"

    def note_foreign(self, at: int) -> None:
        """Note a record that does not belong into a chunk: its sizes may be wrong, so that others are in it."""
        if self.foreign_at < 0:
            self.foreign_at = at

    def add(self, channel: int, time_ns: int, begin: int, end: int) -> None:
        """Note a message; a time that ROS cannot hold becomes the last one that it can."""
        self.channels.append(channel)
        self.times.append(min(time_ns, MAX_TIME_NS))
        self.begins.append(begin)
        self.ends.append(end)

    def counts(self) -> dict[int, int]:
        """Return the messages by channel id."""
        return dict(Counter(self.channels))

    def in_order(self) -> Iterable[int]:
        """Return the messages' indices in the order of their times; equal times in the order of the data."""
        if len(self.times) < _FEW and all(map(le, self.times, self.times[1:])):
            return range(len(self.times))
        times = np.frombuffer(self.times, np.int64)
        if (times[1:] >= times[:-1]).all():
            return range(len(times))
        return map(int, np.argsort(times, kind="stable"))

    def bytes_of(self, index: int, data: memoryview) -> bytes | memoryview:
        """Return a message's bytes; a copy, so that a small message does not keep the whole chunk in memory."""
        content = data[self.begins[index] : self.ends[index]]
        return content if len(content) > _VIEWED_BYTES and 4 * len(content) > len(data) else bytes(content)


@dataclass(frozen=True, slots=True)
class Gap:
    """Bytes `start` to `end` of the file that hold no record."""

    start: int
    end: int


@dataclass(frozen=True, slots=True, eq=False)
class DeclaredContents:
    """What the file itself says of its contents, behind its data; -1: not said.

    Attributes
    ----------
    source : where it says so
    messages, chunks, listed_chunks : how many in all; listed one by one
    counts : messages by channel id; empty: not said
    start_ns, end_ns : times of the first and the last message
    """

    source: str
    messages: int = -1
    chunks: int = -1
    listed_chunks: int = -1
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int = -1
    end_ns: int = -1


@dataclass(slots=True, eq=False)
class ChunkIndex:
    """What the walk over the records of a file, or of one of several that follow one another in it, found.

    Attributes
    ----------
    extents : in the order of the file
    definitions : those outside of chunks that the data need no confirming of
    summary : those behind the data, which the data may contradict
    declared : what the file says of itself
    gaps : bytes that could not be understood
    remarks : what else is to be said, a line each
    is_complete : the file's proper end was found
    chunks : how many there are, those without messages too
    is_doubtful : what it says of itself contradicts itself, so that its data must be read to know
    """

    extents: ExtentTable = field(default_factory=ExtentTable)
    definitions: Definitions = field(default_factory=Definitions)
    summary: Definitions = field(default_factory=Definitions)
    declared: DeclaredContents | None = None
    gaps: list[Gap] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    is_complete: bool = False
    chunks: int = 0
    is_doubtful: bool = False


class Search(Protocol):
    """Finds the chunks in a part of a file, where a chunk was taken for one that is none, or is damaged."""

    def __call__(self, file: ByteFile, start: int, end: int) -> Iterator[Extent]:
        """Yield the whole chunks between two places."""


@dataclass(frozen=True, slots=True, eq=False)
class ChunkFormat:
    """What is particular of a format.

    Attributes
    ----------
    index : walks over a file
    contents : parses the decompressed data of a chunk, whatever they are, up to a number of messages
    search : finds chunks
    """

    index: Callable[[ByteFile, LimitsParameters], list[ChunkIndex]]
    contents: Callable[[memoryview, LimitsParameters, int], ChunkContents]
    search: Search


def walked_files(walk: Callable[[int], tuple[ChunkIndex, int]], start: int) -> list[ChunkIndex]:
    """Walk over the files that follow one another in one; so many that only a forged file has them are left, and said.

    Parameters
    ----------
    walk : walks over the file that begins at a place; gives what it found, and where the next one begins, -1: nowhere
    start : of the first
    """
    found: list[ChunkIndex] = []
    at, budget = start, DefinitionBudget()
    while at >= 0:
        if len(found) == _MOST_FILES:
            found[-1].remarks.append(f"{_MOST_FILES} files follow one another: what is behind byte {at} is not read")
            break
        index, at = walk(at)
        for definitions in (index.definitions, index.summary):
            definitions.share(budget)
        found.append(index)
    return found
