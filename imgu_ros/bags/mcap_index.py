# SPDX-License-Identifier: Apache-2.0
"""Find what a whole or damaged MCAP file holds, by walking its records from the first to the last.

The file's own summary is not trusted and not needed: the walk reads some bytes of every record, and jumps over the
data. Where the chain of records breaks, the next chunk or message that is consistent in itself is sought.
"""

from __future__ import annotations

import re

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.chunks import ChunkIndex, Gap, Stretch
from imgu_ros.bags.mcap_format import (
    HEAD_BYTES,
    MAGIC,
    PREFIX,
    ChunkHeader,
    Opcode,
    chunk_header,
    definition_record,
    indexed_count,
    message_time,
)
from imgu_ros.bags.storage import MAX_BYTES
from imgu_ros.errors import BagError

#: Messages outside of chunks are read in stretches of about this size.
_STRETCH_BYTES = 2**22
_SEARCH_BYTES = 2**20
# A chunk (6) or message (5) whose length is below 2^40.
_CANDIDATE = re.compile(rb"[\x05\x06].{5}\0\0\0", re.DOTALL)
_HOUR_NS = 3600 * 10**9
_LAST_KNOWN_OPCODE = 0x0F
_FIRST_PRIVATE_OPCODE = 0x80


def index_mcap(file: ByteFile) -> ChunkIndex:
    """Walk the records of an MCAP file.

    Raises
    ------
    BagError
        If it does not begin as an MCAP file, or cannot be read.
    """
    magic = file.read(0, min(file.size, len(MAGIC)))
    if magic != MAGIC:
        raise BagError(f"{file.path}: begins with {magic.hex()}; need {MAGIC.hex()} (MCAP)")
    return _Walk(file).index()


class _Walk:
    def __init__(self, file: ByteFile) -> None:
        self.file = file
        self.found = ChunkIndex()
        self.stretches = self.found.stretches
        self.run_is_open = False

    def index(self) -> ChunkIndex:
        at = len(MAGIC)
        while at < self.file.size and not self.found.is_complete:
            try:
                at = self.next_record(at)
            except BagError:
                at = self.recovered(at)
        return self.found

    def next_record(self, at: int) -> int:
        """Take the record at `at`; return the next one's place. BagError when there is no record."""
        head = self.file.read(at, min(HEAD_BYTES, self.file.size - at))
        opcode, length = self.prefix(head)
        end = at + PREFIX.size + length
        if end > self.file.size:
            if opcode == Opcode.CHUNK:
                self.take_cut_chunk(at, chunk_header(head, length))
            raise BagError(f"record of {length} bytes at byte {at} reaches beyond the end")
        if opcode == Opcode.MESSAGE:
            self.take_message(at, end, head)
            return end
        self.run_is_open = False
        if opcode == Opcode.CHUNK:
            chunk = chunk_header(head, length)
            self.stretches.append(
                Stretch(
                    at, at + chunk.data_offset, chunk.compressed_size, chunk.compression,
                    chunk.size, chunk.crc, chunk.start_ns, chunk.end_ns,
                )
            )  # fmt: skip
        elif opcode == Opcode.MESSAGE_INDEX:
            channel_id, count = indexed_count(head, length)
            if self.stretches:
                counts = self.stretches[-1].counts
                counts[channel_id] = counts.get(channel_id, 0) + count
                self.stretches[-1].is_counted = True
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            if length > MAX_BYTES:
                raise BagError(f"definition of {length} bytes at byte {at}")
            definition = definition_record(opcode, self.file.read(at + PREFIX.size, length))
            if definition is not None:
                self.found.define(definition)
            elif not self.is_followed(end):  # not even its length is right
                raise BagError(f"definition at byte {at} cannot be read")
        elif opcode == Opcode.FOOTER:
            self.found.is_complete = True
        return end

    def take_cut_chunk(self, at: int, chunk: ChunkHeader) -> None:
        """Keep what is there of an uncompressed chunk that the file's end cuts."""
        start = at + chunk.data_offset
        if chunk.compression == "" and start < self.file.size:
            size = self.file.size - start
            self.stretches.append(Stretch(at, start, size, "", size, 0, chunk.start_ns, chunk.end_ns))

    @staticmethod
    def prefix(head: bytes) -> tuple[int, int]:
        if len(head) < PREFIX.size:
            raise BagError(f"{len(head)} bytes; need {PREFIX.size} for a record")
        opcode, length = PREFIX.unpack_from(head)
        if opcode == 0 or _LAST_KNOWN_OPCODE < opcode < _FIRST_PRIVATE_OPCODE:
            raise BagError(f"unknown opcode {opcode}")
        return opcode, length

    def take_message(self, at: int, end: int, head: bytes) -> None:
        channel_id, time_ns = message_time(head, end - at - PREFIX.size)
        if not self.run_is_open or self.stretches[-1].size + end - at > _STRETCH_BYTES:
            self.stretches.append(Stretch(at, at, 0, "", 0, 0, time_ns, time_ns, is_counted=True))
            self.run_is_open = True
        run = self.stretches[-1]
        run.size = run.data_size = end - run.offset
        run.start_ns, run.end_ns = min(run.start_ns, time_ns), max(run.end_ns, time_ns)
        run.counts[channel_id] = run.counts.get(channel_id, 0) + 1

    def recovered(self, broken: int) -> int:
        """Return where the walk can go on after the broken record: the file's end when nowhere."""
        if self.stretches and not self.run_is_open:
            # Its message indexes may be among what is broken.
            self.stretches[-1].is_counted = False
        self.run_is_open = False
        at = broken + 1
        while at < self.file.size:
            block = self.file.read(at, min(_SEARCH_BYTES, self.file.size - at))
            for candidate in _CANDIDATE.finditer(block):
                if self.is_record(at + candidate.start()):
                    self.found.gaps.append(Gap(broken, at + candidate.start()))
                    return at + candidate.start()
            at += max(1, len(block) - PREFIX.size + 1)
        self.found.gaps.append(Gap(broken, self.file.size))
        return self.file.size

    def is_likely_message(self, channel_id: int, time_ns: int) -> bool:
        """Whether the last message outside of chunks was of this channel and hour: pixels can look like a record."""
        return any(
            run.data_offset == run.offset and channel_id in run.counts and abs(time_ns - run.end_ns) < _HOUR_NS
            for run in self.stretches[-1:]
        )

    def is_record(self, at: int) -> bool:
        """Whether a chunk, or a message followed by another record, begins at `at`."""
        head = self.file.read(at, min(HEAD_BYTES, self.file.size - at))
        try:
            opcode, length = self.prefix(head)
            end = at + PREFIX.size + length
            if end > self.file.size:
                return False
            if opcode == Opcode.CHUNK:
                return chunk_header(head, length).compression in ("", "zstd", "lz4")
            if not self.is_likely_message(*message_time(head, length)):
                return False
            return self.is_followed(end)
        except BagError:
            return False

    def is_followed(self, end: int) -> bool:
        """Whether another record begins where one ends."""
        try:
            opcode, length = self.prefix(self.file.read(end, min(PREFIX.size, self.file.size - end)))
        except BagError:
            return False
        return opcode <= _LAST_KNOWN_OPCODE and end + PREFIX.size + length <= self.file.size
