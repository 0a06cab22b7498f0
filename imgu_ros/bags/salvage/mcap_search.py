# SPDX-License-Identifier: Apache-2.0
"""Find records in a damaged MCAP file: candidates by pattern, and checks of their consistency."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.salvage.extents import Extent
from imgu_ros.bags.salvage.mcap_format import (
    COMPRESSIONS,
    HEAD_BYTES,
    MAGIC,
    PREFIX,
    ChunkHeader,
    McapOpcode,
    chunk_header,
    message_head,
)
from imgu_ros.errors import BagError

LAST_KNOWN_OPCODE = 0x0F

# Chunks, messages and definitions whose length is below 2^40, the ends of data and file; each match is one byte, so
# that none hides another.
_CHUNK = rb"\x06(?=.{5}\0\0\0.{28}(?:\0\0\0\0|\x04\0\0\0zstd|\x03\0\0\0lz4))"
_CANDIDATE = re.compile(
    rb"[\x02-\x06\x0f\x89](?:(?<=\x06)" + _CHUNK[4:] + rb"|(?<=[\x03\x04\x05])(?=.{5}\0\0\0)"
    rb"|(?<=\x02)(?=\x14\0{7})|(?<=\x0f)(?=\x04\0{7})|(?<=\x89)(?=MCAP0\r\n\x01))",
    re.DOTALL,
)
_CHUNK_CANDIDATE = re.compile(_CHUNK, re.DOTALL)
_HOUR_NS = 3600 * 10**9
#: Records that must follow a message of another time than the last, for pixels can look like a record.
_CHAINED = 3


def mcap_chunks(file: ByteFile, start: int, end: int) -> Iterator[Extent]:
    """Yield the chunks between two places of a file that are consistent in themselves, in file order."""
    for at in chunk_candidates(file, start, end):
        if at < start:
            continue
        head = file.head(at, HEAD_BYTES)
        try:
            _, length = prefix(head)
            extent = chunk_at(at, chunk_header(head, length))
        except BagError:
            continue
        if extent.end <= end:
            yield extent
            start = extent.end


def chunk_at(at: int, chunk: ChunkHeader) -> Extent:
    """Return the chunk whose record begins at `at`."""
    return Extent(
        at, at + chunk.data_offset, chunk.compressed_size, chunk.compression, chunk.size, chunk.crc,
        chunk.start_ns, chunk.end_ns,
    )  # fmt: skip


def prefix(head: bytes) -> tuple[int, int]:
    """Return a record's opcode and length; BagError when it has none."""
    if len(head) < PREFIX.size:
        raise BagError(f"{len(head)} bytes; need {PREFIX.size} for a record")
    opcode, length = PREFIX.unpack_from(head)
    if opcode == 0:
        raise BagError("opcode 0")
    return opcode, length


def candidates(file: ByteFile, start: int, end: int) -> Iterator[int]:
    """Yield the offsets of candidates for records and for beginnings of files, in ascending order."""
    return file.find(_CANDIDATE, start, end, HEAD_BYTES)


def chunk_candidates(file: ByteFile, start: int, end: int) -> Iterator[int]:
    """Yield the offsets of candidates for chunks, in ascending order."""
    return file.find(_CHUNK_CANDIDATE, start, end, HEAD_BYTES)


def is_record(file: ByteFile, at: int, before: Extent | None, known: Collection[int]) -> bool:
    """Whether a record begins at `at` that is consistent in itself, or followed by others.

    Parameters
    ----------
    before : the last chunk, or messages, before it
    known : channels
    """
    head = file.head(at, HEAD_BYTES)
    try:
        opcode, length = prefix(head)
        end = at + PREFIX.size + length
        if end > file.size:
            return False
        if opcode == McapOpcode.CHUNK:
            return chunk_header(head, length).compression in COMPRESSIONS and is_followed(file, end)
        if opcode in (McapOpcode.SCHEMA, McapOpcode.CHANNEL):
            return _texts_end(file, opcode, at) <= end and is_followed(file, end)
        if opcode != McapOpcode.MESSAGE:
            return is_followed(file, end)
        message = message_head(head, length)
    except BagError:
        return False
    if message is None:
        return False
    channel_id, time_ns = message
    if before is not None and before.is_run and channel_id in before.counts and abs(time_ns - before.end_ns) < _HOUR_NS:
        return is_followed(file, end)
    return is_followed(file, end, _CHAINED if channel_id in known else 2 * _CHAINED)


def chunk_end(file: ByteFile, at: int) -> int:
    """Return where the chunk at `at` ends that is consistent in itself; 0 when there is none."""
    head = file.head(at, HEAD_BYTES)
    try:
        opcode, length = prefix(head)
        is_chunk = opcode == McapOpcode.CHUNK and chunk_header(head, length).compression in COMPRESSIONS
    except BagError:
        return 0
    end = at + PREFIX.size + length
    return end if is_chunk and end <= file.size else 0


def is_followed(file: ByteFile, end: int, times: int = 1) -> bool:
    """Whether as many records, or the file's end, come where one ends."""
    for _ in range(times):
        if end == file.size:
            return True
        head = file.head(end, PREFIX.size)
        if head.startswith(MAGIC[: len(head)]):
            return True
        try:
            opcode, length = prefix(head)
        except BagError:
            return False
        end += PREFIX.size + length
        if opcode > LAST_KNOWN_OPCODE or end > file.size:
            return False
    return True


def _texts_end(file: ByteFile, opcode: int, at: int) -> int:
    """Return where the texts of a definition end, by their own lengths."""
    at += PREFIX.size + (2 if opcode == McapOpcode.SCHEMA else 4)
    for _ in range(3):
        at += 4 + int.from_bytes(file.head(at, 4), "little")
        if at > file.size:
            raise BagError("texts beyond the end")
    return at
