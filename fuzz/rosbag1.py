# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags as lists of records: seeds and mutations.

Source: the bag format 2.0 (wiki.ros.org/Bags/Format/2.0).
"""

from __future__ import annotations

import bz2
import struct
from dataclasses import dataclass, field, replace
from functools import cache

import lz4.frame  # type: ignore[import-untyped]

from fuzz.messages import recorded
from fuzz.mutation import Rng, chance, choice, mangled, number, text

MAGIC = b"#ROSBAG V2.0\n"
Fields = list[tuple[bytes, bytes]]


@dataclass(slots=True)
class Node:
    """A record: its fields and data; `raw` bytes that are none; what it claims of its sizes (None: the truth)."""

    fields: Fields = field(default_factory=list)
    content: bytes = b""
    raw: bytes | None = None
    inside: list[Node] | None = None
    header_size: int | None = None
    data_size: int | None = None

    def data(self) -> bytes:
        """Return the bytes."""
        if self.raw is not None:
            return self.raw
        fields, content = self.fields, self.content
        if self.inside is not None:
            records = joined(self.inside)
            method = dict(fields).get(b"compression", b"none")
            content = {b"bz2": bz2.compress, b"lz4": lz4.frame.compress}.get(method, bytes)(records)
            fields = [(k, struct.pack("<I", len(records)) if (k, v) == (b"size", b"") else v) for k, v in fields]
        header = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k + b"=" + v for k, v in fields)
        header_size = len(header) if self.header_size is None else self.header_size
        data_size = len(content) if self.data_size is None else self.data_size
        return struct.pack("<I", header_size) + header + struct.pack("<I", data_size) + content


def joined(nodes: list[Node]) -> bytes:
    """Return the bytes of records."""
    return b"".join(node.data() for node in nodes)


def u32(value: int) -> bytes:
    """Return four bytes."""
    return struct.pack("<I", value % 2**32)


def record(data: bytes, at: int) -> tuple[Node, int] | None:
    """Return the record at `at` and where it ends; None when it does not hold."""
    fields: Fields = []
    if at + 4 > len(data):
        return None
    end = at + 4 + int(struct.unpack_from("<I", data, at)[0])
    if end + 4 > len(data):
        return None
    at += 4
    while at < end:
        if at + 4 > end:
            return None
        size = int(struct.unpack_from("<I", data, at)[0])
        name, separator, value = data[at + 4 : at + 4 + size].partition(b"=")
        at += 4 + size
        if at > end or not separator:
            return None
        fields.append((name, value))
    stop = end + 4 + int(struct.unpack_from("<I", data, end)[0])
    return (Node(fields, data[end + 4 : stop]), stop) if stop <= len(data) else None


def parsed(data: bytes, top: bool = True) -> list[Node]:
    """Return the records of a file or of a chunk, as far as they hold; what follows is the last."""
    nodes: list[Node] = []
    at = 0
    if top and data.startswith(MAGIC):
        nodes, at = [Node(raw=MAGIC)], len(MAGIC)
    while at < len(data):
        found = record(data, at)
        if found is None:
            nodes.append(Node(raw=data[at:]))
            break
        node, at = found
        if top and dict(node.fields).get(b"op") == b"\5":
            node = _chunk(node)
        nodes.append(node)
    return nodes


def _chunk(node: Node) -> Node:
    values = dict(node.fields)
    try:
        records = unpacked(node.content, values.get(b"compression", b""), 2**25)
    except Exception:
        return node
    size = values.get(b"size", b"")
    fields = [(k, b"" if k == b"size" and size == u32(len(records)) else v) for k, v in node.fields]
    return Node(fields, inside=parsed(records, top=False))


def unpacked(packed: bytes, method: bytes, most: int = 2**28) -> bytes:
    """Return the records of a chunk; an exception when its compression does not hold."""
    if method == b"none":
        return packed
    if method == b"bz2":
        return bz2.BZ2Decompressor().decompress(packed, max_length=most)
    if method == b"lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most))
    raise ValueError("unknown compression")


def bag(compression: bytes = b"none", per_chunk: int = 5, indexed: bool = True) -> bytes:
    """Return a whole bag."""
    messages = recorded(3, ros=1)
    ids = {topic: i for i, topic in enumerate(dict.fromkeys(m.topic for m in messages))}
    connections = {}
    for message in messages:
        name = message.type_name.replace("/msg/", "/")
        inside = [(b"topic", message.topic.encode()), (b"type", name.encode()), (b"md5sum", message.digest.encode())]
        inside.append((b"message_definition", message.definition.encode()))
        packed = Node(inside).data()[4:-4]
        head = [(b"conn", u32(ids[message.topic])), (b"op", b"\7"), (b"topic", message.topic.encode())]
        connections[message.topic] = Node(head, packed)
    chunks: list[Node] = []
    infos: list[Node] = []
    at = len(MAGIC) + 4096 + 8
    for first in range(0, len(messages), per_chunk):
        part = messages[first : first + per_chunk]
        records = [replace(node) for node in connections.values()] if first == 0 else []
        entries: dict[int, bytes] = {}
        for message in part:
            time = u32(message.time_ns // 10**9) + u32(message.time_ns % 10**9)
            identity = ids[message.topic]
            entries[identity] = entries.get(identity, b"") + time + u32(len(joined(records)))
            records.append(Node([(b"conn", u32(identity)), (b"op", b"\2"), (b"time", time)], message.data))
        chunks.append(Node([(b"compression", compression), (b"op", b"\5"), (b"size", b"")], inside=records))
        times = [u32(m.time_ns // 10**9) + u32(m.time_ns % 10**9) for m in (part[0], part[-1])]
        counts = b"".join(u32(i) + u32(len(e) // 12) for i, e in entries.items())
        head = [(b"chunk_pos", struct.pack("<Q", at)), (b"count", u32(len(entries))), (b"end_time", times[1])]
        infos.append(Node([*head, (b"op", b"\6"), (b"start_time", times[0]), (b"ver", u32(1))], counts))
        at += len(chunks[-1].data())
        if indexed:
            for identity, entry in entries.items():
                fields = [(b"conn", u32(identity)), (b"count", u32(len(entry) // 12)), (b"op", b"\4"), (b"ver", u32(1))]
                chunks.append(Node(fields, entry))
                at += len(chunks[-1].data())
    header = Node(
        [
            (b"chunk_count", u32(len(infos))), (b"conn_count", u32(len(ids))),
            (b"index_pos", struct.pack("<Q", at if indexed else 0)), (b"op", b"\3"),
        ]
    )  # fmt: skip
    header.content = b" " * (4096 - len(header.data()) + 8)
    end = [*connections.values(), *infos] if indexed else []
    return joined([Node(raw=MAGIC), header, *chunks, *end])


@cache
def seeds() -> tuple[bytes, ...]:
    """Return whole bags."""
    return (bag(), bag(b"lz4"), bag(b"bz2"), bag(b"lz4", per_chunk=100), bag(indexed=False), bag(per_chunk=2))


def mutate(rng: Rng, data: bytes) -> bytes:
    """Return a bag with one mutation more."""
    nodes = parsed(data)
    roll = rng.random()
    if roll < 0.15 or not nodes:
        return mangled(rng, data)
    if roll < 0.2:
        other = choice(rng, seeds())
        return choice(rng, (data + other, data + other[len(MAGIC) :], data[:-100] + other))
    chunks = [node for node in nodes if node.inside is not None]
    chunk = choice(rng, chunks) if chunks else None
    if chunk is not None and chance(rng, 0.5):
        _mutate_records(rng, chunk.inside or [])
    else:
        _mutate_records(rng, nodes)
    return joined(nodes)


def _mutate_records(rng: Rng, nodes: list[Node]) -> None:
    if not nodes:
        return
    i, j = int(rng.integers(len(nodes))), int(rng.integers(len(nodes)))
    node = nodes[i]
    roll = int(rng.integers(14))
    if roll == 0:
        nodes.insert(j, replace(node))
    elif roll == 1:
        del nodes[i]
    elif roll == 2:
        nodes[i], nodes[j] = nodes[j], nodes[i]
    elif roll == 3:
        del nodes[min(i, j) : max(i, j)]
    elif roll == 4:
        nodes.insert(i, Node(raw=choice(rng, (rng.bytes(40), bytes(100), b"\0\0\0\0" * 2, b"op=\5" * 200, MAGIC))))
    elif roll == 5:
        node.header_size = number(rng, 60, 32)
    elif roll == 6:
        node.data_size = number(rng, len(node.content), 32)
    elif roll == 7:  # claims to hold those after it
        node.data_size = len(node.content) + len(joined(nodes[i + 1 : j + 1]))
    elif roll == 8:
        node.content = mangled(rng, node.content)
    elif roll == 9 and node.inside is not None:
        node.inside.append(Node([(b"conn", u32(0)), (b"op", b"\2"), (b"time", bytes(8))], bytes(2 * 10**7)))
        _set(node, b"compression", choice(rng, (b"bz2", b"lz4")))
    elif node.fields:
        _mutate_field(rng, node)


def _set(node: Node, name: bytes, value: bytes) -> None:
    node.fields = [(k, value if k == name else v) for k, v in node.fields]


def _mutate_field(rng: Rng, node: Node) -> None:
    i = int(rng.integers(len(node.fields)))
    name, value = node.fields[i]
    fields = list(node.fields)
    roll = rng.random()
    if roll < 0.1:
        del fields[i]
    elif roll < 0.2:
        fields.append(fields[i])
    elif roll < 0.3:
        fields[i] = (text(rng, name), value)
    elif roll < 0.4:
        fields[i] = (name, mangled(rng, value))
    elif name == b"op":
        fields[i] = (name, bytes([choice(rng, (0, 2, 3, 4, 5, 6, 7, 8, 255))]))
    elif name in (b"compression", b"topic"):
        names = (b"none", b"lz4", b"bz2") if name == b"compression" and chance(rng, 0.7) else (text(rng, value),)
        fields[i] = (name, choice(rng, names))
    elif len(value) in (4, 8):
        fields[i] = (name, number(rng, int.from_bytes(value, "little"), 8 * len(value)).to_bytes(len(value), "little"))
    else:
        fields[i] = (name, text(rng, value))
    node.fields = fields
