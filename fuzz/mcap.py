# SPDX-License-Identifier: Apache-2.0
"""MCAP files as trees of records, and the seeds.

Source: the MCAP format specification (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cache

import lz4.frame  # type: ignore[import-untyped]

from fuzz.messages import Recorded, recorded
from fuzz.zstd import compressed, decompressed

MAGIC = b"\x89MCAP0\r\n"
#: Longer chunks stay as they are.
_MOST_PARSED = 2**25
CHUNK, SCHEMA, CHANNEL, MESSAGE, FOOTER, DATA_END = 6, 3, 4, 5, 2, 15


@dataclass(slots=True)
class Node:
    """A record, or what is none (opcode -1: bytes as they are, such as the magic).

    Attributes
    ----------
    opcode, content : as in the file; the content of a chunk is made of the following
    length : what the record claims; None: the truth
    inside : records of a chunk; None: no chunk
    times, compression, size, crc, packed_size : of a chunk; None: the truth
    """

    opcode: int
    content: bytes = b""
    length: int | None = None
    inside: list[Node] | None = None
    times: tuple[int, int] = (0, 0)
    compression: bytes = b""
    size: int | None = None
    crc: int | None = None
    packed_size: int | None = None

    def data(self) -> bytes:
        """Return the bytes."""
        if self.opcode < 0:
            return self.content
        content = self.content if self.inside is None else self._chunk()
        length = len(content) if self.length is None else self.length
        return struct.pack("<BQ", self.opcode, length) + content

    def _chunk(self) -> bytes:
        records = joined(self.inside or [])
        packed: bytes = {b"zstd": compressed, b"lz4": lz4.frame.compress}.get(self.compression, bytes)(records)
        crc = zlib.crc32(records) if self.crc is None else self.crc
        size = len(records) if self.size is None else self.size
        packed_size = len(packed) if self.packed_size is None else self.packed_size
        head = struct.pack("<QQQI", *self.times, size, crc) + string(self.compression)
        return head + struct.pack("<Q", packed_size) + packed


def string(value: bytes) -> bytes:
    """Return bytes after their length."""
    return struct.pack("<I", len(value)) + value


def joined(nodes: Iterable[Node]) -> bytes:
    """Return the bytes of records."""
    return b"".join(node.data() for node in nodes)


def parsed(data: bytes, top: bool = True) -> list[Node]:
    """Return the records of a file or of a chunk, as far as they hold; what follows is the last."""
    nodes: list[Node] = []
    at = 0
    while at < len(data):
        if top and data.startswith(MAGIC, at):
            nodes.append(Node(-1, MAGIC))
            at += len(MAGIC)
            continue
        end = at
        if at + 9 <= len(data):
            opcode, length = struct.unpack_from("<BQ", data, at)
            end = at + 9 + length
        if not at < end <= len(data):
            nodes.append(Node(-1, data[at:]))
            break
        content = data[at + 9 : end]
        nodes.append(_chunk_node(content) if opcode == CHUNK else Node(opcode, content))
        at = end
    return nodes


def _chunk_node(content: bytes) -> Node:
    plain = Node(CHUNK, content)
    if len(content) < 40:
        return plain
    start, end, size, crc, name_size = struct.unpack_from("<QQQII", content)
    compression = content[32 : 32 + name_size]
    packed = content[40 + name_size :]
    try:
        records = unpacked(packed, compression, size, _MOST_PARSED)
    except Exception:
        return plain
    true_crc = zlib.crc32(records)
    return replace(
        plain, inside=parsed(records, top=False), times=(start, end), compression=compression,
        crc=None if crc == true_crc else crc,
    )  # fmt: skip


def unpacked(packed: bytes, compression: bytes, size: int, most: int = 2**28) -> bytes:
    """Return the records of a chunk; ValueError when they are not as announced."""
    if size > most:
        raise ValueError("too large")
    if compression == b"zstd":
        records = decompressed(packed, most)
    elif compression == b"lz4":
        records = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
    elif compression == b"":
        records = packed
    else:
        raise ValueError("unknown compression")
    if len(records) != size:
        raise ValueError("another size")
    return records


@dataclass
class Layout:
    """How a seed is written."""

    compression: bytes = b""
    chunked: bool = True
    indexed: bool = True
    summary: bool = True
    per_chunk: int = 6
    packs_messages: bool = False
    messages: tuple[Recorded, ...] = field(default_factory=lambda: recorded(3))


def mcap_file(layout: Layout) -> bytes:
    """Return a whole file."""
    topics = {message.topic: message for message in layout.messages}
    ids = {topic: i + 1 for i, topic in enumerate(topics)}
    definitions: list[Node] = []
    for topic, i in ids.items():
        shown = topics[topic]
        definitions += [
            Node(SCHEMA, struct.pack("<H", i) + b"".join(string(t.encode()) for t in (shown.type_name, "ros2msg",
            shown.definition))), Node(CHANNEL, struct.pack("<HH", i,
            i) + string(topic.encode()) + string(b"cdr") + string(b"")),
        ]  # fmt: skip
    nodes = [Node(-1, MAGIC), Node(1, string(b"ros2") + string(b"seed"))]
    summary: list[Node] = list(definitions)
    for first in range(0, len(layout.messages), layout.per_chunk):
        part = layout.messages[first : first + layout.per_chunk]
        records = list(definitions) if first == 0 else []
        offsets: dict[int, list[tuple[int, int]]] = {}
        for i, message in enumerate(part, first):
            offsets.setdefault(ids[message.topic], []).append((message.time_ns, len(joined(records))))
            head = struct.pack("<HIQQ", ids[message.topic], i, message.time_ns, message.time_ns)
            data = compressed(message.data) if layout.packs_messages else message.data
            records.append(Node(MESSAGE, head + data))
        if not layout.chunked:
            nodes += records
            continue
        times = (min(m.time_ns for m in part), max(m.time_ns for m in part))
        chunk = Node(CHUNK, inside=records, times=times, compression=layout.compression)
        at, size = len(joined(nodes)), len(chunk.data())
        nodes.append(chunk)
        if layout.indexed:
            places = b""
            start = at + size
            for i, entries in offsets.items():
                places += struct.pack("<HQ", i, len(joined(nodes)))
                array = b"".join(struct.pack("<QQ", *entry) for entry in entries)
                nodes.append(Node(7, struct.pack("<H", i) + string(array)))
            fixed = struct.pack("<QQQQ", *times, at, size) + string(places)
            sizes = struct.pack("<QQ", size - 9 - 40 - len(layout.compression), len(joined(records)))
            index_size = struct.pack("<Q", len(joined(nodes)) - start)
            summary.append(Node(8, fixed + index_size + string(layout.compression) + sizes))
    nodes.append(Node(DATA_END, struct.pack("<I", 0)))
    start = len(joined(nodes)) if layout.summary else 0
    if layout.summary:
        count = len(layout.messages)
        times = (min(m.time_ns for m in layout.messages), max(m.time_ns for m in layout.messages))
        chunks = sum(node.opcode == CHUNK for node in nodes)
        statistics = struct.pack("<QHIIIIQQ", count, len(ids), len(ids), 0, 0, chunks, *times)
        nodes += [*summary, Node(11, statistics + string(b"".join(struct.pack("<HQ", i, 3) for i in ids.values())))]
    return joined([*nodes, Node(FOOTER, struct.pack("<QQI", start, 0, 0)), Node(-1, MAGIC)])


@cache
def seeds() -> tuple[bytes, ...]:
    """Return whole files of every layout."""
    layouts = [Layout(compression) for compression in (b"", b"lz4", b"zstd")]
    layouts += [Layout(chunked=False), Layout(chunked=False, summary=False), Layout(indexed=False)]
    layouts += [Layout(b"zstd", summary=False, per_chunk=2), Layout(packs_messages=True), Layout(b"lz4", per_chunk=100)]
    return tuple(map(mcap_file, layouts))
