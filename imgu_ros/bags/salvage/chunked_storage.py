# SPDX-License-Identifier: Apache-2.0
"""Read the messages of a file made of chunks (MCAP, ROS 1), intact or damaged."""

from __future__ import annotations

import zlib
from collections.abc import Collection, Iterator
from functools import partial

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.compression import Expansion, check_message_size, decompressed
from imgu_ros.bags.salvage.chunks import ChannelRecord, ChunkContents, ChunkFormat, ChunkIndex
from imgu_ros.bags.salvage.extents import Extent
from imgu_ros.bags.storage import (
    Channel,
    MessageBlock,
    RawMessage,
    WarningLog,
    seconds,
    serialization_named,
)
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError

#: Chunks found inside damaged ones may have this many times the bytes of the file in all, plus a constant.
_SEARCH_FACTOR, _SEARCH_BYTES = 4, 2**26


class ChunkedStorage:
    """A file of chunks: compressed or not, intact, truncated or damaged.

    The file's indexes are trusted where they agree with its statistics. Without statistics the index of a chunk is
    trusted until the chunk is read. Where indexes and statistics contradict each other, all chunks are counted.

    Parameters
    ----------
    file : the open file; closed with the storage
    name : of the file, for warnings
    warnings : collects reports of damage, now and while reading
    index : result of the walk over the file
    form : how chunks are parsed and found
    limits : `message_mb` bounds a chunk
    expansion : bounds the decompressed size of all chunks, of concatenated files together
    """

    def __init__(
        self,
        file: ByteFile,
        name: str,
        warnings: WarningLog,
        index: ChunkIndex,
        form: ChunkFormat,
        limits: LimitsParameters = DEFAULT_LIMITS,
        expansion: Expansion | None = None,
    ) -> None:
        self._file, self._name, self._warnings = file, name, warnings
        self._index, self._form, self._limits = index, form, limits
        self._table, self._definitions = index.extents, index.definitions
        self._cut_at = next((gap.start for gap in index.gaps[-1:] if gap.end == file.size), -1)
        self._search_left = _SEARCH_FACTOR * file.size + _SEARCH_BYTES
        self._searched: set[int] = set()
        for remark in index.remarks:
            warnings.add(f"{name}: {remark}")
        self._expansion = expansion or Expansion(limits)
        self._too_much = self._beyond_expansion()
        self._most: dict[int, int] = {}
        is_as_declared = self._is_as_declared()
        is_damaged = index.is_doubtful or any(gap.end < file.size for gap in index.gaps)
        everything = is_damaged or (index.declared is not None and not is_as_declared)
        self._count(everything)
        self._is_sure = everything or is_as_declared
        self._definitions.take(index.summary)
        self._by_id = {identity: self._channel(record) for identity, record in self._definitions.channels.items()}
        self._totals = self._table.totals()
        self.start_ns, self.end_ns = self._table.span()
        self._compare()
        self._warn_of_gaps()

    @property
    def counts(self) -> dict[Channel, int]:
        """Messages of each channel."""
        totals = dict.fromkeys(self._by_id.values(), 0)
        for identity, count in self._totals.items():
            if identity in self._by_id:
                totals[self._by_id[identity]] += count
        return totals

    def parts(self, topics: Collection[str] | None) -> Iterator[MessageBlock]:
        """Yield the chunks with messages of `topics` (None: all), in the order of their beginning."""
        wanted = self._wanted(topics).keys()
        self._warn_of_lost(self._totals.keys() - self._by_id.keys())
        for index in self._table.by_time():
            extent = self._table[index]
            if not (self._is_sure and wanted.isdisjoint(extent.counts)):
                yield MessageBlock(extent.start_ns, partial(self._messages_of, extent, topics), index, extent.size)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _beyond_expansion(self) -> set[int]:
        """Return the offsets of the chunks whose decompressed size exceeds the limit."""
        refused: set[int] = set()
        for index in self._table.expanded(self._limits.expansion, 1_000_000 * self._limits.message_mb):
            extent = self._table[index]
            try:
                self._expansion.take(extent.data_size, extent.size)
            except BagError:
                refused.add(extent.offset)
        return refused

    def _is_as_declared(self) -> bool:
        """Whether the file's statistics are there, and agree with the indexes of its chunks."""
        declared, index = self._index.declared, self._index
        if declared is None or declared.chunks < 0:  # a list of chunks alone gives no number of messages
            return False
        counts = self._table.totals()
        return (
            declared.messages in (-1, sum(counts.values()))
            and (not declared.counts or declared.counts == counts)
            and declared.chunks in (-1, index.chunks)
            and declared.listed_chunks in (-1, 0, index.chunks)
            and (declared.start_ns, declared.end_ns) in ((-1, -1), self._table.span())
        )

    def _count(self, everything: bool) -> None:
        """Read the chunks that have no index, or all; chunks found inside damaged ones are read too."""
        known, index = self._definitions.channels.keys(), len(self._table)
        for candidate in self._table.chunks() if everything else self._table.uncounted(known):
            extent = self._table[candidate]
            if everything or not (extent.is_counted and extent.counts and extent.counts.keys() <= known):
                self._examine(candidate, extent)
        while index < len(self._table):
            self._examine(index, self._table[index])
            index += 1

    def _examine(self, index: int, extent: Extent) -> None:
        contents, _ = self._contents(extent)
        declared = sum(extent.counts.values()) if extent.is_counted else -1
        extent.counts, extent.is_counted = contents.counts(), True
        self._warn_of_count(extent, declared, contents)
        if contents.times:
            times = np.frombuffer(contents.times, np.int64)
            extent.start_ns, extent.end_ns = int(times.min()), int(times.max())
        self._table.replace(index, extent)
        if contents.damage or contents.foreign_at >= 0:
            self._search(extent, contents)

    def _search(self, extent: Extent, contents: ChunkContents) -> None:
        """Search for chunks inside one that is damaged, or is not a chunk."""
        if not self._searched:
            self._searched = {known.offset for known in self._table}
        is_read = extent.compression == "" and len(contents.times)
        read = contents.size if contents.foreign_at < 0 else contents.foreign_at
        start = extent.data_offset + read if is_read else extent.offset + 1
        try:
            for found in self._form.search(self._file, start, min(extent.end, self._file.size)):
                self._search_left -= found.data_size + found.size
                if self._search_left < 0:
                    self._warnings.add(f"{self._name}: so much of it is damaged that not all of it is searched")
                    return
                if found.offset not in self._searched:
                    self._searched.add(found.offset)
                    self._table.append(found)
        except BagError as error:
            self._warn_of_chunk(extent, str(error))

    def _channel(self, record: ChannelRecord) -> Channel:
        schema = self._definitions.schemas.get(record.schema_id)
        encoding = serialization_named(record.encoding)
        if schema is None:
            return Channel(record.topic, "", encoding, "", "")
        type_name = normalize_msgtype(schema.name) if "/" in schema.name else schema.name
        return Channel(record.topic, type_name, encoding, schema.format.lower(), schema.text)

    def _wanted(self, topics: Collection[str] | None) -> dict[int, Channel]:
        return {i: channel for i, channel in self._by_id.items() if topics is None or channel.topic in topics}

    def _messages_of(self, extent: Extent, topics: Collection[str] | None) -> Iterator[RawMessage]:
        contents, data = self._contents(extent)
        self._check(extent, contents)
        wanted = self._wanted(topics)
        channels, times = contents.channels, contents.times
        for index in contents.in_order():
            channel = wanted.get(channels[index])
            if channel is not None:
                yield RawMessage(channel, times[index], contents.bytes_of(index, data))

    def _check(self, extent: Extent, contents: ChunkContents) -> None:
        """Compare a chunk with its index; take the channels that were not in an index."""
        counts = contents.counts()
        if counts != extent.counts:
            self._warn_of_count(extent, sum(extent.counts.values()), contents)
            self._definitions.take(contents.definitions)
            for identity in counts.keys() - self._by_id.keys():
                if identity in self._definitions.channels:
                    self._by_id[identity] = self._channel(self._definitions.channels[identity])
        self._warn_of_lost(counts.keys() - self._by_id.keys())

    def _contents(self, extent: Extent) -> tuple[ChunkContents, memoryview]:
        """Return the contents of a chunk and its data; of a damaged one the readable part, with a warning."""
        try:
            data = self._data(extent)
        except BagError as error:
            self._warn_of_chunk(extent, str(error))
            return ChunkContents(damage=str(error)), memoryview(b"")
        # A chunk that is read again may give as many as the first time.
        most = self._most.get(extent.offset, self._expansion.most_messages(extent.data_size))
        contents = self._form.contents(data, self._limits, most)
        if extent.offset not in self._most:
            count = len(contents.times)
            if self._expansion.take_messages(extent.data_size, count):
                self._most[extent.offset] = count
        is_right = not extent.crc or zlib.crc32(data) == extent.crc
        if contents.damage:
            self._warn_of_chunk(extent, contents.damage)
        elif contents.foreign_at >= 0:
            self._warn_of_chunk(extent, f"record at byte {contents.foreign_at} is none of a chunk's")
        elif not is_right:
            self._warn_of_chunk(extent, "its checksum differs: what is in it may be wrong")
        (self._definitions if is_right else self._index.summary).take(contents.definitions)
        return contents, data

    def _data(self, extent: Extent) -> memoryview:
        check_message_size(extent.data_size, self._limits)
        if extent.offset in self._too_much:
            raise BagError(
                f"{extent.data_size} bytes become {extent.size}; need at most {self._limits.expansion} times as many "
                "(limits.expansion)"
            )
        packed = self._file.read(extent.data_offset, extent.data_size)
        spare = self._expansion.spare(extent.data_size)
        unannounced = spare  # whatever a decompressor did before it found them to be too many
        try:
            data = decompressed(packed, extent.compression, extent.size, self._limits, spare)
            unannounced = max(0, len(data) - extent.size)
        finally:
            self._expansion.take(extent.data_size, unannounced)
        if len(data) != extent.size:
            self._warn_of_chunk(extent, f"it announces {extent.size} bytes; it has {len(data)}")
        return data

    def _compare(self) -> None:
        """Warn of differences between what the file declares and what it holds."""
        declared = self._index.declared
        if declared is None:
            return
        messages, chunks = sum(self._totals.values()), self._index.chunks
        if declared.messages not in (-1, messages):
            self._warnings.add(
                f"{self._name}: {declared.messages} messages by its {declared.source}; {messages} are there"
            )
        elif declared.counts and declared.counts != self._totals:
            self._warnings.add(
                f"{self._name}: its {declared.source} announces other numbers of messages for some topics"
            )
        if declared.chunks not in (-1, chunks):
            self._warnings.add(f"{self._name}: {declared.chunks} chunks by its {declared.source}; {chunks} are there")
        elif declared.listed_chunks not in (-1, 0, chunks):
            self._warnings.add(
                f"{self._name}: {declared.listed_chunks} chunks in its list of chunks; {chunks} are there"
            )

    def _warn_of_count(self, extent: Extent, declared: int, contents: ChunkContents) -> None:
        if declared < 0 or contents.damage:
            return
        there = len(contents.times)
        if declared != there:
            self._warnings.add(
                f"{self._name}: chunk at byte {extent.offset}: its index promises {declared} messages; it has {there}",
                kind=f"{self._name}: wrong indexes",
            )

    def _warn_of_lost(self, lost: Collection[int]) -> None:
        if lost:
            self._warnings.add(
                f"{self._name}: the definitions of {len(lost)} channels are lost, their messages skipped"
            )

    def _warn_of_chunk(self, extent: Extent, reason: str) -> None:
        if extent.offset == self._cut_at:
            return  # truncated by the end of the file, which has a warning of its own
        self._warnings.add(
            f"{self._name}: chunk at byte {extent.offset} ({seconds(extent.start_ns)} to {seconds(extent.end_ns)}) "
            f"is damaged, what cannot be read of it is skipped: {reason}",
            kind=f"{self._name}: damaged chunks",
        )

    def _warn_of_gaps(self) -> None:
        """Warn of gaps: in full for the first one and for the end; others are counted."""
        size = self._file.size
        for number, gap in enumerate(self._index.gaps):
            if gap.end == size:
                text = f"cut short or damaged: its last {size - gap.start} bytes are incomplete; read until "
                self._warnings.add(f"{self._name}: {text}{self._until(gap.start)}")
            elif number:
                self._warnings.add(f"bytes {gap.start}", f"{self._name}: gaps")
            else:
                text = f"bytes {gap.start} to {gap.end} are damaged and skipped; read before them until "
                self._warnings.add(f"{self._name}: {text}{self._until(gap.start)}", f"{self._name}: gaps")
        if not self._index.is_complete and not self._index.gaps:
            self._warnings.add(f"{self._name}: the end of the file is missing; read until {self._until(size)}")

    def _until(self, offset: int) -> str:
        """Return the time of the last message that begins until `offset`."""
        ends = [extent.end_ns for extent in self._table if extent.offset <= offset]
        return seconds(max(ends)) if ends else "nowhere (no message before)"
