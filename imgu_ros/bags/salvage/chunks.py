# SPDX-License-Identifier: Apache-2.0
"""Types shared by the formats made of chunks (MCAP, ROS 1): definitions, contents of a chunk, index of a file."""

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

#: A larger message that is a large part of its chunk, as an image mostly is, is not copied out of it.
_VIEWED_BYTES = 2**16
_MOST_TEXT = 2**26
#: Memory of a definition beside its texts.
_RECORD_BYTES = 200
#: Concatenated files: each takes some kilobytes and less than a millisecond, and may have only 40 bytes.
_MOST_FILES = 5000
#: So few numbers are compared faster one by one than as an array.
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
    """Memory for all definitions, `_MOST_TEXT` bytes; a repeated text takes nothing."""

    left: int = _MOST_TEXT
    texts: dict[str, str] = field(default_factory=dict)

    def kept(self, record: SchemaRecord | ChannelRecord) -> SchemaRecord | ChannelRecord | None:
        """Return the record, with a known text reused; None when the budget is exceeded."""
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
    """Definitions by id; of two with the same id the first counts. Those beyond the budget are dropped."""

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
        """Use a budget together with others."""
        records: list[SchemaRecord | ChannelRecord] = [*self.schemas.values(), *self.channels.values()]
        kept = [budget.kept(record) for record in records]
        self.budget = budget
        self.schemas = {record.id: record for record in kept if isinstance(record, SchemaRecord)}
        self.channels = {record.id: record for record in kept if isinstance(record, ChannelRecord)}

    def take(self, other: Definitions) -> None:
        """Add the definitions of another one that are missing here."""
        for schema in other.schemas.values():
            self.define(schema)
        for channel in other.channels.values():
            self.define(channel)


@dataclass(slots=True, eq=False)
class ChunkContents:
    """Contents of a chunk's decompressed data: positions of messages, not the messages, which may be millions.

    Attributes
    ----------
    channels, times, begins, ends : of each message, in the order of the data: channel id, ns, place of its bytes
    definitions : those among the records
    damage : why parsing stopped; empty when it did not
    size : number of bytes parsed
    foreign_at : position of the first record that does not belong in a chunk; -1: none
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
        """Note that parsing stopped because there are more messages than `most`."""
        self.damage = f"more than {most} messages of so few bytes; need longer ones, or fewer (limits.expansion)"

    def note_foreign(self, at: int) -> None:
        """Note a record that does not belong in a chunk: its length may be wrong, so that others are inside it."""
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
    """The numbers that a file declares behind its data; -1: not declared.

    Attributes
    ----------
    source : name of the record that declares them
    messages, chunks, listed_chunks : numbers in all; listed_chunks: those that the file lists one by one
    counts : messages by channel id; empty: not declared
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
    """Index of a file, or of one of several concatenated files, made by walking its records.

    Attributes
    ----------
    extents : in the order of the file
    definitions : those outside of chunks that are sure
    summary : those behind the data, which the data may contradict
    declared : what the file declares of its contents
    gaps : bytes that could not be parsed
    remarks : further warnings
    is_complete : the regular end of the file was found
    chunks : number of chunks, those without messages included
    is_doubtful : the declarations contradict each other, so that all data must be read
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
    """Finds chunks inside a damaged chunk, or inside bytes that were wrongly taken for one."""

    def __call__(self, file: ByteFile, start: int, end: int) -> Iterator[Extent]:
        """Yield the whole chunks between two places."""


@dataclass(frozen=True, slots=True, eq=False)
class ChunkFormat:
    """The functions of a format.

    Attributes
    ----------
    index : indexes a file
    contents : parses the decompressed data of a chunk, which may be damaged, up to a number of messages
    search : finds chunks
    """

    index: Callable[[ByteFile, LimitsParameters], list[ChunkIndex]]
    contents: Callable[[memoryview, LimitsParameters, int], ChunkContents]
    search: Search


def walked_files(walk: Callable[[int], tuple[ChunkIndex, int]], start: int) -> list[ChunkIndex]:
    """Index concatenated files; beyond `_MOST_FILES`, which only a forged file has, they are left out with a remark.

    Parameters
    ----------
    walk : indexes the file that begins at an offset; returns the index and the offset of the next file, -1: none
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
