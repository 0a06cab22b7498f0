# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag file made of chunks (MCAP, ROS 1), whole or damaged."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection, Iterator
from functools import partial

from rosbags.typesys.msg import normalize_msgtype

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.chunks import ChannelRecord, ChunkIndex, Gap, MessageRecord, Record, Stretch
from imgu_ros.bags.compression import check_message_size, decompressed
from imgu_ros.bags.storage import (
    DEFAULT_LIMITS,
    Channel,
    Part,
    RawMessage,
    Warnings,
    merge_by_time,
    seconds,
    serialization_named,
)
from imgu_ros.errors import BagError
from imgu_ros.params import LimitsParameters


class ChunkedStorage:
    """A file of chunks: compressed or not, whole, cut or damaged.

    Parameters
    ----------
    file : the open file; closed with the storage
    name : what warnings call it
    warnings : takes what is damaged, now and while reading
    index : what a walk over the file found
    records : parses the decompressed data of a chunk; raises BagError where they break off
    limits : `message_mb` bounds a chunk
    """

    def __init__(
        self,
        file: ByteFile,
        name: str,
        warnings: Warnings,
        index: ChunkIndex,
        records: Callable[[bytes], Iterator[Record]],
        limits: LimitsParameters = DEFAULT_LIMITS,
    ) -> None:
        self._file, self._name, self._warnings = file, name, warnings
        self._index, self._records, self._limits = index, records, limits
        self._stretches = [stretch for stretch in index.stretches if self._is_known(stretch)]
        self._by_id = {identity: self._channel(record) for identity, record in index.channels.items()}
        for gap in index.gaps:
            self._warn_of_gap(gap)
        if not index.is_complete and not index.gaps:
            self._warnings.add(f"{name}: the end of the file is missing; read until {self._until(file.size)}")

    @property
    def counts(self) -> dict[Channel, int]:
        """Messages of each channel."""
        totals = dict.fromkeys(self._by_id.values(), 0)
        for stretch in self._stretches:
            for identity, count in stretch.counts.items():
                if identity in self._by_id:
                    totals[self._by_id[identity]] += count
        return totals

    @property
    def start_ns(self) -> int:
        """Time of the first message."""
        return min((stretch.start_ns for stretch in self._stretches), default=0)

    @property
    def end_ns(self) -> int:
        """Time of the last message."""
        return max((stretch.end_ns for stretch in self._stretches), default=0)

    def messages(self, topics: Collection[str] | None) -> Iterator[RawMessage]:
        """Yield the messages of `topics` (None: all) in time order."""
        wanted = {i for i, channel in self._by_id.items() if topics is None or channel.topic in topics}
        lost = {i for stretch in self._stretches for i in stretch.counts} - self._by_id.keys()
        if lost:
            self._warnings.add(
                f"{self._name}: the definitions of {len(lost)} channels are lost, their messages skipped"
            )
        return merge_by_time(
            Part(stretch.start_ns, partial(self._messages_of, stretch, wanted))
            for stretch in self._stretches
            if not wanted.isdisjoint(stretch.counts)
        )

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _is_known(self, stretch: Stretch) -> bool:
        """Count the messages of a chunk that its indexes do not tell; return whether it has any."""
        if not (stretch.is_counted and stretch.counts.keys() <= self._index.channels.keys()):
            counts: dict[int, int] = {}
            times: list[int] = []
            try:
                for record in self._records(self._data(stretch)):
                    if isinstance(record, MessageRecord):
                        counts[record.channel_id] = counts.get(record.channel_id, 0) + 1
                        times = [min([*times, record.time_ns]), max([*times, record.time_ns])]
                    else:
                        self._index.define(record)
            except BagError as error:
                self._warn_of_chunk(stretch, error)
            stretch.counts, stretch.is_counted = counts, True
            if times:
                stretch.start_ns, stretch.end_ns = times
        return any(stretch.counts.values())

    def _channel(self, record: ChannelRecord) -> Channel:
        schema = self._index.schemas.get(record.schema_id)
        encoding = serialization_named(record.encoding)
        if schema is None:
            return Channel(record.topic, "", encoding, "", "")
        type_name = normalize_msgtype(schema.name) if "/" in schema.name else schema.name
        return Channel(record.topic, type_name, encoding, schema.format.lower(), schema.text)

    def _messages_of(self, stretch: Stretch, wanted: Collection[int]) -> Iterator[RawMessage]:
        found: list[RawMessage] = []
        try:
            for record in self._records(self._data(stretch)):
                if isinstance(record, MessageRecord) and record.channel_id in wanted:
                    found.append(RawMessage(self._by_id[record.channel_id], record.time_ns, record.data))
        except BagError as error:
            self._warn_of_chunk(stretch, error)
        found.sort(key=lambda message: message.time_ns)
        found.reverse()
        while found:  # the first last, so that what has been read is let go
            yield found.pop()

    def _data(self, stretch: Stretch) -> bytes:
        check_message_size(max(stretch.size, stretch.data_size), self._limits)
        packed = self._file.read(stretch.data_offset, stretch.data_size)
        data = decompressed(packed, stretch.compression, stretch.size, self._limits)
        if stretch.crc and zlib.crc32(data) != stretch.crc:
            raise BagError("its checksum differs")
        return data

    def _warn_of_chunk(self, stretch: Stretch, error: BagError) -> None:
        if any(gap.start == stretch.offset for gap in self._index.gaps):
            return  # cut by the end of the file, which is said as such
        self._warnings.add(
            f"{self._name}: chunk at byte {stretch.offset} ({seconds(stretch.start_ns)} to {seconds(stretch.end_ns)}) "
            f"is damaged, what cannot be read of it is skipped: {error}",
            kind=f"{self._name}: damaged chunks",
        )

    def _warn_of_gap(self, gap: Gap) -> None:
        start, end = gap.start, gap.end
        if end == self._file.size:
            text = f"cut short or damaged: its last {end - start} bytes are incomplete; read until "
        else:
            text = f"bytes {start} to {end} are damaged and skipped; read before them until "
        kind = f"{self._name}: gaps {end == self._file.size}"
        self._warnings.add(f"{self._name}: {text}{self._until(start)}", kind)

    def _until(self, offset: int) -> str:
        """Return the time of the last message that begins until `offset`."""
        ends = [stretch.end_ns for stretch in self._stretches if stretch.offset <= offset]
        return seconds(max(ends)) if ends else "nowhere (no message before)"
