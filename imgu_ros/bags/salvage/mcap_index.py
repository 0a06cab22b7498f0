# SPDX-License-Identifier: Apache-2.0
"""Index an MCAP file, intact or damaged, by walking its records from the first to the last.

The file's own summary is not needed: the walk reads some bytes of every record and skips the data. Behind a broken
record it searches for the next record that is consistent in itself. The search starts at the last position that is
sure, because a wrong length may have led beyond whole chunks. Concatenated files are indexed one after the other.
"""

from __future__ import annotations

import struct
import zlib

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.salvage.chunks import ChunkFormat, ChunkIndex, DeclaredContents, Gap, walked_files
from imgu_ros.bags.salvage.extents import Extent
from imgu_ros.bags.salvage.mcap_format import (
    COMPRESSION_LENGTHS,
    COMPRESSIONS,
    HEAD_BYTES,
    MAGIC,
    PREFIX,
    ChunkHeader,
    McapOpcode,
    chunk_header,
    chunk_length,
    definition_record,
    index_head,
    mcap_contents,
    message_head,
    statistics,
)
from imgu_ros.bags.salvage.mcap_search import (
    LAST_KNOWN_OPCODE,
    candidates,
    chunk_at,
    chunk_candidates,
    chunk_end,
    is_followed,
    is_record,
    mcap_chunks,
    prefix,
)
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

#: Messages outside of chunks are read in extents of about this size.
_EXTENT_BYTES = 2**22
_BLOCK_BYTES = 2**20
#: Enough for the counts of every channel that there can be.
_STATISTICS_BYTES = 2**20
_FOOTER = struct.Struct("<QQI")
_DATA_END_BYTES = 4
# The length of a chunk's compression, which distinguishes nearly all other records from chunks.
_COMPRESSION = slice(PREFIX.size + 28, PREFIX.size + 32)
_FIRST_PRIVATE_OPCODE = 0x80
_MOST_REMARKS = 20


def index_mcap(file: ByteFile, limits: LimitsParameters) -> list[ChunkIndex]:
    """Walk the records of an MCAP file; of several, when it is made of several.

    Raises
    ------
    BagError
        If it does not begin as an MCAP file, or cannot be read.
    """
    magic = file.read(0, min(file.size, len(MAGIC)))
    if magic != MAGIC:
        raise BagError(f"{file.path}: begins with {magic.hex()}; need {MAGIC.hex()} (MCAP)")

    def walked(at: int) -> tuple[ChunkIndex, int]:
        walk = _McapWalk(file, at, limits)
        return walk.found, walk.over(at)

    return walked_files(walked, len(MAGIC))


MCAP = ChunkFormat(index_mcap, mcap_contents, mcap_chunks)


class _McapWalk:
    def __init__(self, file: ByteFile, at: int, limits: LimitsParameters) -> None:
        self.file, self.limits = file, limits
        self.found = ChunkIndex()
        self.last: Extent | None = None  # not yet in the table
        self.before: Extent | None = None  # the last one in the table
        self.sure = at  # a search for the next record starts behind it: what is before has the right length
        self.is_cut_chunk = False
        self.is_data = True
        self.listed_chunks = 0
        self.summary_start = 0
        self.next_file = -1

    def over(self, at: int) -> int:
        """Walk from the byte behind the magic; return the same place of the file that follows, -1 when none does."""
        while at < self.file.size and not self.found.is_complete and self.next_file < 0:
            try:
                at = self.next_record(at)
            except BagError as error:
                at = self.stepped_over(at, error) or self.recovered(at)
        self.close_extent()
        if self.found.declared is None and self.listed_chunks and self.found.is_complete:
            self.found.declared = DeclaredContents("list of chunks", listed_chunks=self.listed_chunks)
        return self.next_file

    def next_record(self, at: int) -> int:
        """Take the record at `at`; return the next one's place. BagError when there is no record."""
        head = self.file.head(at, HEAD_BYTES)
        if head.startswith(MAGIC):
            return self.take_magic(at)
        opcode, length = prefix(head)
        end = at + PREFIX.size + length
        if end > self.file.size:
            if opcode == McapOpcode.CHUNK:
                self.take_cut_chunk(at, chunk_header(head, length))
                self.sure, self.is_cut_chunk = at, True
            raise BagError(f"record of {length} bytes at byte {at} reaches beyond the end")
        sure = at
        if opcode == McapOpcode.MESSAGE and not (self.starts_run(at) and self.is_disguised_chunk(at, head, length)):
            self.take_message(at, end, head)
        elif opcode == McapOpcode.MESSAGE_INDEX:
            self.take_message_index(*index_head(head, length))
            sure = end
        elif opcode == McapOpcode.CHUNK or self.is_disguised_chunk(at, head, length):
            sure = self.take_chunk(at, chunk_header(head, length))
        else:
            self.close_extent()
            if opcode in (McapOpcode.SCHEMA, McapOpcode.CHANNEL):
                self.take_definition(at, opcode, length)
            elif opcode == McapOpcode.STATISTICS:
                self.take_statistics(at + PREFIX.size, length)
            elif opcode == McapOpcode.CHUNK_INDEX:
                self.listed_chunks += 1
            elif opcode == McapOpcode.DATA_END and length == _DATA_END_BYTES:
                self.is_data, self.summary_start = False, end
                sure = end
            elif opcode == McapOpcode.FOOTER and length == _FOOTER.size:
                sure = end = self.take_footer(at, end)
            elif opcode == McapOpcode.FOOTER:
                self.remark(f"the record at byte {at} has the type of a footer, and another length: read on behind it")
            elif LAST_KNOWN_OPCODE < opcode < _FIRST_PRIVATE_OPCODE and not is_followed(self.file, end):
                raise BagError(f"unknown opcode {opcode}")
        # What a record may have jumped over is looked through when the next one is none.
        self.sure = sure
        return end

    def take_magic(self, at: int) -> int:
        """Take a file's beginning: of another file, when it has a header and this one has had something."""
        self.sure = at + len(MAGIC)
        has_header = self.file.head(self.sure, 1) == bytes([McapOpcode.HEADER])
        if has_header and (self.found.chunks or self.found.definitions.channels or self.last or self.before):
            self.next_file = self.sure
        self.remark(f"a file begins at byte {at}: read on")
        return self.sure

    def stepped_over(self, at: int, error: BagError) -> int:
        """Return the place behind a record whose length holds, though its content does not; 0 when it does not."""
        head = self.file.head(at, HEAD_BYTES)
        if len(head) < PREFIX.size or not head[0]:
            return 0
        length: int = PREFIX.unpack_from(head)[1]
        own = chunk_length(head) if head[0] == McapOpcode.CHUNK else 0
        if own and is_followed(self.file, at + PREFIX.size + own):
            length = own  # its other sizes are right
        end = at + PREFIX.size + length
        if end > self.file.size or not is_followed(self.file, end):
            return 0
        self.sure = at
        try:
            if head[0] == McapOpcode.CHUNK or self.is_disguised_chunk(at, head, length):
                self.take_chunk(at, chunk_header(head, length, is_sure=True))
                self.remark(f"the chunk at byte {at} has wrong sizes: read as far as the next record")
                return end
        except BagError:
            pass
        if self.last is not None and not self.last.is_run:
            self.last.is_counted = False
        self.remark(f"the record at byte {at} is skipped: {error}")
        return end

    def take_chunk(self, at: int, header: ChunkHeader) -> int:
        chunk = chunk_at(at, header)
        self.close_extent()
        self.last = chunk
        self.found.chunks += 1
        return chunk.end

    def take_cut_chunk(self, at: int, chunk: ChunkHeader) -> None:
        """Keep what is there of an uncompressed chunk that the file's end cuts."""
        start = at + chunk.data_offset
        if chunk.compression == "" and start < self.file.size:
            self.close_extent()
            size = self.file.size - start
            self.last = Extent(at, start, size, "", size, 0, chunk.start_ns, chunk.end_ns)

    def starts_run(self, at: int) -> bool:
        return self.last is None or not self.last.is_run or self.last.end != at

    def take_message(self, at: int, end: int, head: bytes) -> None:
        message = message_head(head, end - at - PREFIX.size)
        if message is None:
            return
        channel_id, time_ns = message
        run = self.last
        if run is None or self.starts_run(at) or end - run.offset > _EXTENT_BYTES:
            self.close_extent()
            run = self.last = Extent(at, at, 0, "", 0, 0, time_ns, time_ns, is_counted=True)
        run.size = run.data_size = end - run.offset
        run.start_ns, run.end_ns = min(run.start_ns, time_ns), max(run.end_ns, time_ns)
        run.counts[channel_id] = run.counts.get(channel_id, 0) + 1

    def take_message_index(self, channel_id: int, count: int, first_ns: int) -> None:
        chunk = self.last
        if chunk is None or chunk.is_run:
            return
        chunk.counts[channel_id] = chunk.counts.get(channel_id, 0) + count
        chunk.is_counted = True
        chunk.start_ns = min(chunk.start_ns, first_ns)

    def take_definition(self, at: int, opcode: int, length: int) -> None:
        if length > 1_000_000 * self.limits.message_mb:
            raise BagError(f"definition of {length} bytes at byte {at}")
        content = self.file.read(at + PREFIX.size, length)
        definition = definition_record(opcode, content, self.limits)
        if definition is None:
            if not is_followed(self.file, at + PREFIX.size + length):  # not even its length is right
                raise BagError(f"definition at byte {at} cannot be read")
        else:
            (self.found.definitions if self.is_data else self.found.summary).define(definition)

    def take_statistics(self, start: int, length: int) -> None:
        try:
            content = self.file.read(start, min(length, _STATISTICS_BYTES))
            self.found.declared = statistics(content, self.listed_chunks)
        except BagError as error:
            self.remark(f"its statistics cannot be read: {error}")
            self.found.is_doubtful = True

    def take_footer(self, at: int, end: int) -> int:
        """Return where the walk goes on: most files end here."""
        behind = self.file.head(end, 2 * len(MAGIC))
        if len(behind) <= len(MAGIC):
            self.found.is_complete = True
        elif behind == 2 * MAGIC:
            self.next_file = end + len(behind)
            self.found.is_complete = True
            self.remark(f"another file follows behind the footer at byte {at}: read on")
        else:
            self.remark(f"goes on behind the footer at byte {at}: read on")
            self.found.is_doubtful = True
        self.take_summary(at)
        self.is_data = True
        return end + len(MAGIC) if behind.startswith(MAGIC) else end

    def take_summary(self, footer: int) -> None:
        """Trust the definitions of the summary when its checksum is there, and right."""
        has_summary, _, crc = _FOOTER.unpack(self.file.head(footer + PREFIX.size, _FOOTER.size))
        start, end = self.summary_start, footer + PREFIX.size + _FOOTER.size - 4
        if not (has_summary and crc and start):
            return
        got = 0
        for at in range(start, end, _BLOCK_BYTES):
            got = zlib.crc32(self.file.read(at, min(_BLOCK_BYTES, end - at)), got)
        if got == crc:
            self.found.definitions.take(self.found.summary)
        else:
            self.remark("the checksum of its summary differs: what it says is compared with the data")
            self.found.is_doubtful = True

    def close_extent(self) -> None:
        """Put what is complete into the table; a chunk without data has no message."""
        if self.last is not None and self.last.data_size:
            self.found.extents.append(self.last)
            self.before = self.last
        self.last = None

    def remark(self, text: str) -> None:
        if len(self.found.remarks) < _MOST_REMARKS and text not in self.found.remarks:
            self.found.remarks.append(text)

    def is_disguised_chunk(self, at: int, head: bytes, length: int) -> bool:
        """Whether a record of another type is consistent as a chunk, which does not happen by chance."""
        try:
            if head[_COMPRESSION] not in COMPRESSION_LENGTHS or length < HEAD_BYTES:
                return False
            if chunk_header(head, length).compression not in COMPRESSIONS:
                return False
        except BagError:
            return False
        self.remark(f"the record at byte {at} is read as a chunk, though its type differs")
        return True

    def recovered(self, broken: int) -> int:
        """Return where the walk can go on after a broken record: the file's end when nowhere."""
        start, find = self.sure, chunk_candidates if self.is_cut_chunk else candidates
        self.is_cut_chunk = False
        head = self.file.head(broken, HEAD_BYTES)
        if len(head) >= PREFIX.size and head[0] != McapOpcode.CHUNK:
            length: int = PREFIX.unpack_from(head)[1]
            end = broken + PREFIX.size + length
            if end <= self.file.size and self.is_disguised_chunk(broken, head, length):
                self.sure = self.take_chunk(broken, chunk_header(head, length))
                return end
        if self.last is not None and not self.last.is_run:
            self.last.is_counted = False  # its message indexes may be among what is broken
        self.close_extent()
        at, lone_end = self.file.size, self.file.size
        for place in find(self.file, start + 1, self.file.size):
            if place >= lone_end:
                break  # nothing better in the chunk that nothing follows: it counts
            if self.file.head(place, len(MAGIC)) == MAGIC:
                self.next_file = place + len(MAGIC)
                self.remark(f"another file follows at byte {place}: read on")
            if self.next_file >= 0 or is_record(self.file, place, self.before, self.found.definitions.channels.keys()):
                at = place
                break
            if at == self.file.size:
                end = chunk_end(self.file, place)
                at, lone_end = (place, end) if end else (at, lone_end)
        if at < self.file.size:
            self.found.gaps.append(Gap(broken if at > broken else start, at))
            self.sure = at
            return at
        self.found.gaps.append(Gap(broken, self.file.size))
        return self.file.size
