# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag file made of chunks (MCAP, ROS 1), whole or damaged."""

from __future__ import annotations

import zlib
from collections.abc import Collection, Iterator
from functools import partial

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.chunks import ChannelRecord, ChunkFormat, ChunkIndex, Contents
from imgu_ros.bags.compression import Expansion, check_message_size, decompressed
from imgu_ros.bags.storage import (
    Channel,
    Part,
    RawMessage,
    Warnings,
    seconds,
    serialization_named,
)
from imgu_ros.bags.stretches import Stretch
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError

#: Chunks that were sought in damaged ones may be this many times the file, and as many bytes more.
_SEARCH_FACTOR, _SEARCH_BYTES = 4, 2**26


class ChunkedStorage:
    """A file of chunks: compressed or not, whole, cut or damaged.

    What the file says of itself is believed where its indexes and its statistics agree. Without statistics the indexes
    of the chunks are believed until a chunk is read; where they contradict one another, everything is read and counted.

    Parameters
    ----------
    file : the open file; closed with the storage
    name : what warnings call it
    warnings : takes what is damaged, now and while reading
    index : what a walk over the file found
    form : how chunks are parsed and found
    limits : `message_mb` bounds a chunk
    expansion : bounds what all chunks become, of several files in one together
    """

    def __init__(
        self,
        file: ByteFile,
        name: str,
        warnings: Warnings,
        index: ChunkIndex,
        form: ChunkFormat,
        limits: LimitsParameters = DEFAULT_LIMITS,
        expansion: Expansion | None = None,
    ) -> None:
        self._file, self._name, self._warnings = file, name, warnings
        self._index, self._form, self._limits = index, form, limits
        self._table, self._definitions = index.stretches, index.definitions
        self._cut_at = next((gap.start for gap in index.gaps[-1:] if gap.end == file.size), -1)
        self._search_left = _SEARCH_FACTOR * file.size + _SEARCH_BYTES
        self._sought: set[int] = set()
        for remark in index.remarks:
            warnings.add(f"{name}: {remark}")
        self._expansion = expansion or Expansion(limits)
        self._too_much = self._beyond_expansion()
        self._most: dict[int, int] = {}
        is_promised = self._is_as_promised()
        is_damaged = index.is_doubtful or any(gap.end < file.size for gap in index.gaps)
        everything = is_damaged or (index.promise is not None and not is_promised)
        self._count(everything)
        self._is_sure = everything or is_promised
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

    def parts(self, topics: Collection[str] | None) -> Iterator[Part]:
        """Yield the chunks with messages of `topics` (None: all), in the order of their beginning."""
        wanted = self._wanted(topics).keys()
        self._warn_of_lost(self._totals.keys() - self._by_id.keys())
        for index in self._table.by_time():
            stretch = self._table[index]
            if not (self._is_sure and wanted.isdisjoint(stretch.counts)):
                yield Part(stretch.start_ns, partial(self._messages_of, stretch, topics), index, stretch.size)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _beyond_expansion(self) -> set[int]:
        """Return the chunks, by offset, that become more bytes than the limit allows."""
        refused: set[int] = set()
        for index in self._table.expanded(self._limits.expansion, 1_000_000 * self._limits.message_mb):
            stretch = self._table[index]
            try:
                self._expansion.take(stretch.data_size, stretch.size)
            except BagError:
                refused.add(stretch.offset)
        return refused

    def _is_as_promised(self) -> bool:
        """Whether the file's statistics are there, and agree with the indexes of its chunks."""
        promise, index = self._index.promise, self._index
        if promise is None or promise.chunks < 0:  # a list of chunks alone tells of no message
            return False
        counts = self._table.totals()
        return (
            promise.messages in (-1, sum(counts.values()))
            and (not promise.counts or promise.counts == counts)
            and promise.chunks in (-1, index.chunks)
            and promise.listed_chunks in (-1, 0, index.chunks)
            and (promise.start_ns, promise.end_ns) in ((-1, -1), self._table.span())
        )

    def _count(self, everything: bool) -> None:
        """Read the chunks that nothing tells of, or all; chunks that are found in damaged ones are read too."""
        known, index = self._definitions.channels.keys(), len(self._table)
        for candidate in self._table.chunks() if everything else self._table.uncounted(known):
            stretch = self._table[candidate]
            if everything or not (stretch.is_counted and stretch.counts and stretch.counts.keys() <= known):
                self._examine(candidate, stretch)
        while index < len(self._table):
            self._examine(index, self._table[index])
            index += 1

    def _examine(self, index: int, stretch: Stretch) -> None:
        contents, _ = self._contents(stretch)
        promised = sum(stretch.counts.values()) if stretch.is_counted else -1
        stretch.counts, stretch.is_counted = contents.counts(), True
        self._warn_of_count(stretch, promised, contents)
        if contents.times:
            times = np.frombuffer(contents.times, np.int64)
            stretch.start_ns, stretch.end_ns = int(times.min()), int(times.max())
        self._table.replace(index, stretch)
        if contents.damage or contents.foreign_at >= 0:
            self._search(stretch, contents)

    def _search(self, stretch: Stretch, contents: Contents) -> None:
        """Look for whole chunks in one that is damaged, or was never one."""
        if not self._sought:
            self._sought = {known.offset for known in self._table}
        is_read = stretch.compression == "" and len(contents.times)
        read = contents.size if contents.foreign_at < 0 else contents.foreign_at
        start = stretch.data_offset + read if is_read else stretch.offset + 1
        try:
            for found in self._form.search(self._file, start, min(stretch.end, self._file.size)):
                self._search_left -= found.data_size + found.size
                if self._search_left < 0:
                    self._warnings.add(f"{self._name}: so much of it is damaged that not all of it is looked through")
                    return
                if found.offset not in self._sought:
                    self._sought.add(found.offset)
                    self._table.append(found)
        except BagError as error:
            self._warn_of_chunk(stretch, str(error))

    def _channel(self, record: ChannelRecord) -> Channel:
        schema = self._definitions.schemas.get(record.schema_id)
        encoding = serialization_named(record.encoding)
        if schema is None:
            return Channel(record.topic, "", encoding, "", "")
        type_name = normalize_msgtype(schema.name) if "/" in schema.name else schema.name
        return Channel(record.topic, type_name, encoding, schema.format.lower(), schema.text)

    def _wanted(self, topics: Collection[str] | None) -> dict[int, Channel]:
        return {i: channel for i, channel in self._by_id.items() if topics is None or channel.topic in topics}

    def _messages_of(self, stretch: Stretch, topics: Collection[str] | None) -> Iterator[RawMessage]:
        contents, data = self._contents(stretch)
        self._check(stretch, contents)
        wanted = self._wanted(topics)
        channels, times = contents.channels, contents.times
        for index in contents.in_order():
            channel = wanted.get(channels[index])
            if channel is not None:
                yield RawMessage(channel, times[index], contents.bytes_of(index, data))

    def _check(self, stretch: Stretch, contents: Contents) -> None:
        """Compare a chunk with what its index promised; take the channels that no index knew."""
        counts = contents.counts()
        if counts != stretch.counts:
            self._warn_of_count(stretch, sum(stretch.counts.values()), contents)
            self._definitions.take(contents.definitions)
            for identity in counts.keys() - self._by_id.keys():
                if identity in self._definitions.channels:
                    self._by_id[identity] = self._channel(self._definitions.channels[identity])
        self._warn_of_lost(counts.keys() - self._by_id.keys())

    def _contents(self, stretch: Stretch) -> tuple[Contents, memoryview]:
        """Return what is in a chunk, and its data; of a damaged one what can be had, with a warning."""
        try:
            data = self._data(stretch)
        except BagError as error:
            self._warn_of_chunk(stretch, str(error))
            return Contents(damage=str(error)), memoryview(b"")
        # Of a chunk that is read again, as many as the first time.
        most = self._most.get(stretch.offset, self._expansion.most_messages(stretch.data_size))
        contents = self._form.contents(data, self._limits, most)
        if stretch.offset not in self._most:
            count = len(contents.times)
            if self._expansion.take_messages(stretch.data_size, count):
                self._most[stretch.offset] = count
        is_right = not stretch.crc or zlib.crc32(data) == stretch.crc
        if contents.damage:
            self._warn_of_chunk(stretch, contents.damage)
        elif contents.foreign_at >= 0:
            self._warn_of_chunk(stretch, f"record at byte {contents.foreign_at} is none of a chunk's")
        elif not is_right:
            self._warn_of_chunk(stretch, "its checksum differs: what is in it may be wrong")
        (self._definitions if is_right else self._index.summary).take(contents.definitions)
        return contents, data

    def _data(self, stretch: Stretch) -> memoryview:
        check_message_size(stretch.data_size, self._limits)
        if stretch.offset in self._too_much:
            raise BagError(
                f"{stretch.data_size} bytes become {stretch.size}; need at most {self._limits.expansion} times as many "
                "(limits.expansion)"
            )
        packed = self._file.read(stretch.data_offset, stretch.data_size)
        spare = self._expansion.spare(stretch.data_size)
        unannounced = spare  # whatever a decompressor did before it found them to be too many
        try:
            data = decompressed(packed, stretch.compression, stretch.size, self._limits, spare)
            unannounced = max(0, len(data) - stretch.size)
        finally:
            self._expansion.take(stretch.data_size, unannounced)
        if len(data) != stretch.size:
            self._warn_of_chunk(stretch, f"it announces {stretch.size} bytes; it has {len(data)}")
        return data

    def _compare(self) -> None:
        """Say where the file promises something else than it has."""
        promise = self._index.promise
        if promise is None:
            return
        messages, chunks = sum(self._totals.values()), self._index.chunks
        if promise.messages not in (-1, messages):
            self._warnings.add(
                f"{self._name}: {promise.messages} messages by its {promise.source}; {messages} are there"
            )
        elif promise.counts and promise.counts != self._totals:
            self._warnings.add(
                f"{self._name}: its {promise.source} announces other numbers of messages for some topics"
            )
        if promise.chunks not in (-1, chunks):
            self._warnings.add(f"{self._name}: {promise.chunks} chunks by its {promise.source}; {chunks} are there")
        elif promise.listed_chunks not in (-1, 0, chunks):
            self._warnings.add(
                f"{self._name}: {promise.listed_chunks} chunks in its list of chunks; {chunks} are there"
            )

    def _warn_of_count(self, stretch: Stretch, promised: int, contents: Contents) -> None:
        if promised < 0 or contents.damage:
            return
        there = len(contents.times)
        if promised != there:
            self._warnings.add(
                f"{self._name}: chunk at byte {stretch.offset}: its index promises {promised} messages; it has {there}",
                kind=f"{self._name}: wrong indexes",
            )

    def _warn_of_lost(self, lost: Collection[int]) -> None:
        if lost:
            self._warnings.add(
                f"{self._name}: the definitions of {len(lost)} channels are lost, their messages skipped"
            )

    def _warn_of_chunk(self, stretch: Stretch, reason: str) -> None:
        if stretch.offset == self._cut_at:
            return  # cut by the end of the file, which is said as such
        self._warnings.add(
            f"{self._name}: chunk at byte {stretch.offset} ({seconds(stretch.start_ns)} to {seconds(stretch.end_ns)}) "
            f"is damaged, what cannot be read of it is skipped: {reason}",
            kind=f"{self._name}: damaged chunks",
        )

    def _warn_of_gaps(self) -> None:
        """Say what is missing in full for the first gap and for the end; many gaps are counted."""
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
        ends = [stretch.end_ns for stretch in self._table if stretch.offset <= offset]
        return seconds(max(ends)) if ends else "nowhere (no message before)"
