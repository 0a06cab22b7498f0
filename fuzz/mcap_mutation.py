# SPDX-License-Identifier: Apache-2.0
"""Mutations of MCAP files that keep every length and checksum right but their own."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace

from fuzz.mcap import CHANNEL, CHUNK, DATA_END, FOOTER, MAGIC, MESSAGE, SCHEMA, Node, joined, parsed, seeds, string
from fuzz.mutation import Rng, chance, choice, mangled, number, text
from fuzz.zstd import repeated

#: Contents of records: numbers of 2, 4 and 8 bytes, texts and maps after a length of 4, bytes after one of 8, the rest.
LAYOUTS = {
    1: "tt", FOOTER: "QQI", SCHEMA: "Httt", CHANNEL: "HHttt", MESSAGE: "HIQQ*", 7: "Ht", 8: "QQQQtQtQQ", 9: "QQtt8I",
    10: "QQQQQtt", 11: "QHIIIIQQt", 12: "tt", 13: "QQt", 14: "BQQ", DATA_END: "I",
}  # fmt: skip
_SIZES = {"B": 1, "H": 2, "I": 4, "Q": 8}


def mutate(rng: Rng, data: bytes) -> bytes:
    """Return a file with one mutation more."""
    nodes = parsed(data)
    roll = rng.random()
    if roll < 0.15 or not nodes:
        return mangled(rng, data)
    if roll < 0.2:
        other = choice(rng, seeds())
        return choice(rng, (data + other, data + other[len(MAGIC) :], other + data, data[:-8] + other, data * 2))
    chunks = [node for node in nodes if node.inside is not None]
    if chunks and chance(rng, 0.55):
        chunk = choice(rng, chunks)
        if chance(rng, 0.35):
            _mutate_chunk(rng, chunk, nodes)
        else:
            _mutate_records(rng, chunk.inside or [])
    else:
        _mutate_records(rng, nodes)
    return joined(nodes)


def _mutate_records(rng: Rng, nodes: list[Node]) -> None:
    """Mutate one of the records, or their order."""
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
        rng.shuffle(nodes)
    elif roll == 4 and node.opcode >= 0:
        node.opcode = choice(rng, (0, *range(1, 17), 0x7F, 0x80, 0xFF))
    elif roll == 5 and node.opcode >= 0:
        node.length = number(rng, len(node.data()) - 9, 64)
    elif roll == 6:
        nodes.insert(i, Node(-1, rng.bytes(choice(rng, (1, 9, 100, 3000))) if chance(rng, 0.5) else bytes(100)))
    elif roll == 7:
        nodes.insert(i, _extra(rng))
    elif roll == 8:  # a record that claims to hold those after it
        size = len(joined(nodes[i + 1 :])) if chance(rng, 0.5) else len(joined(nodes[i + 1 : i + 2])) // 2
        nodes.insert(i, Node(choice(rng, (MESSAGE, CHUNK, 9, 7)), _fields(rng), length=size))
    elif roll == 9:
        del nodes[min(i, j) : max(i, j)]
    else:
        _mutate_content(rng, node)


def _mutate_chunk(rng: Rng, chunk: Node, nodes: list[Node]) -> None:
    """Mutate what the head of a chunk says."""
    roll = int(rng.integers(9))
    size = len(joined(chunk.inside or []))
    if roll == 0:
        chunk.times = (number(rng, chunk.times[0], 64), number(rng, chunk.times[1], 64))
    elif roll == 1:
        chunk.size = number(rng, size, 64)
    elif roll == 2:
        chunk.crc = choice(rng, (0, 1, int(rng.integers(2**32))))
    elif roll == 3:
        chunk.compression = choice(rng, (b"", b"zstd", b"lz4"))
    elif roll == 4:
        chunk.compression = text(rng, chunk.compression)
    elif roll == 5:  # overlaps what follows: its length reaches into it
        following = joined(nodes[nodes.index(chunk) + 1 :])
        reach = int(rng.integers(len(following) + 1))
        packed = len(chunk.data()) - 9 - 40 - len(chunk.compression)
        chunk.packed_size = packed + reach
        chunk.length = packed + reach + 40 + len(chunk.compression)
        chunk.size = chunk.packed_size if chunk.compression == b"" else chunk.size
    elif roll == 6:
        chunk.packed_size = number(rng, size, 64)
    elif roll == 7:  # a chunk in a chunk
        (chunk.inside or []).append(replace(chunk, inside=list(chunk.inside or [])))
    else:  # many bytes from few
        message = struct.pack("<HIQQ", 1, 0, 10**9, 10**9) + bytes(choice(rng, (10**5, 10**6, 2 * 10**7)))
        records = joined([*(chunk.inside or []), Node(MESSAGE, message)])
        chunk.size, chunk.crc, chunk.compression = len(records), zlib.crc32(records), b"zstd"
        if chance(rng, 0.3):
            size = choice(rng, (2**20, 2**28, 2**30, 3 * 2**30))
            bomb = repeated(size)
            size = size if chance(rng, 0.7) else 2**20
            head = struct.pack("<QQQI", *chunk.times, size, 0) + string(b"zstd") + struct.pack("<Q", len(bomb))
            chunk.content, chunk.inside = head + bomb, None
        else:
            chunk.inside = parsed(records, top=False)


def _mutate_content(rng: Rng, node: Node) -> None:
    """Mutate one field of a record; of one without a known layout, anything."""
    layout = LAYOUTS.get(node.opcode, "*")
    at = 0
    spans: list[tuple[str, int, int]] = []
    for kind in layout:
        size = _SIZES.get(kind, 0)
        if kind in "t8":
            width = 4 if kind == "t" else 8
            size = width + int.from_bytes(node.content[at : at + width], "little")
        elif kind == "*":
            size = len(node.content) - at
        if at + size > len(node.content):
            break
        spans.append((kind, at, at + size))
        at += size
    if not spans or chance(rng, 0.1):
        node.content = mangled(rng, node.content)
        return
    kind, start, end = choice(rng, spans)
    old = node.content[start:end]
    if kind in _SIZES:
        changed = number(rng, int.from_bytes(old, "little"), 8 * len(old))
        new = changed.to_bytes(len(old), "little")
    elif kind == "t":
        new = string(text(rng, old[4:])) if chance(rng, 0.8) else struct.pack("<I", number(rng, len(old), 32)) + old[4:]
        if node.opcode == SCHEMA and chance(rng, 0.5):
            new = string(_definition(rng, old[4:]))
    else:
        new = mangled(rng, old)
    node.content = node.content[:start] + new + node.content[end:]


def _definition(rng: Rng, old: bytes) -> bytes:
    """Return a message definition that asks for much, contradicts itself, or is none."""
    return choice(
        rng,
        (
            b"uint8[100000000] data", b"float64[100000000] a\n" * 10, b"string data\nstring data",
            b"std_msgs/String data", b"my_msgs/Shape a", b"".join(b"uint8 a%d\n" % i for i in range(12_000)),
            b"uint8[] a\nuint8[<=3] b", b"int8 C=1", b"string a \"\x1b[31m\"",
            b"X[1000000] x\n" + b"=" * 80 + b"\nMSG: a/X\nuint8[1000000] a",
            b"=" * 80 + b"\nIDL: a/b\nmodule a { struct b { sequence<octet, 100000000> c; }; };",
            old + b"\nuint8 more", old.replace(b"8", b"16"), mangled(rng, old), mangled(rng, old),
        ),
    )  # fmt: skip


def _extra(rng: Rng) -> Node:
    """Return a record that seeds have not."""
    return choice(
        rng,
        (
            Node(9, struct.pack("<QQ", 1, 1) + string(b"name") + string(b"text/plain") + struct.pack("<Q",
            4) + b"dataXXXX"), Node(12, string(b"name") + string(b"")),
            Node(FOOTER, struct.pack("<QQI", 0, 0, 0)),
            Node(DATA_END, struct.pack("<I", 0)),
            Node(7, struct.pack("<H", int(rng.integers(8))) + string(bytes(16) * choice(rng, (0, 1, 1000)))),
            Node(11, struct.pack("<QHIIIIQQ", number(rng, 18, 64), 1, 1, 0, 0, 1, 0, 0) + string(b"")),
            Node(choice(rng, (0x10, 0x42, 0x80, 0xC1)), b"private"),
            Node(-1, MAGIC),
        ),
    )  # fmt: skip


def _fields(rng: Rng) -> bytes:
    return struct.pack("<QQQI", 0, 1, 40, 0) + string(choice(rng, (b"", b"zstd", b"lz4"))) + struct.pack("<Q", 40)
