# SPDX-License-Identifier: Apache-2.0
"""Other picture files: PNM, TIFF, BMP, GIF, and what else OpenCV reads; seeds and mutations of their heads."""

from __future__ import annotations

import re
import struct
from contextlib import suppress
from functools import cache
from typing import Literal

import cv2
import numpy as np

from fuzz.mutation import Rng, chance, choice, mangled, number, overwritten
from fuzz.pictures import scene

#: TIFF: tag -> (type, value) beside width, height and strip.
_SHORT, _LONG, _RATIONAL = 3, 4, 5
_SIZES = {1: 1, 2: 1, _SHORT: 2, _LONG: 4, _RATIONAL: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 16: 8}


def tiff(pixels: bytes, width: int, height: int, tags: dict[int, int], order: str = "<") -> bytes:
    """Return a TIFF of one strip."""
    shorts = {256: width, 257: height, 258: 8, 259: 1, 262: 1, 273: 8, 277: 1, 278: height, 279: len(pixels), **tags}
    start = 8 + len(pixels) + len(pixels) % 2
    entries = b"".join(
        struct.pack(f"{order}HHII", tag, _LONG, 1, value) if tag in (256, 257, 273, 278, 279) or order == "<"
        else struct.pack(f"{order}HHIHH", tag, _SHORT, 1, value, 0)
        for tag, value in sorted(shorts.items())
    )  # fmt: skip
    magic = b"II*\0" if order == "<" else b"MM\0*"
    body = pixels + b"\0" * (len(pixels) % 2)
    return magic + struct.pack(f"{order}I", start) + body + struct.pack(f"{order}H", len(shorts)) + entries + bytes(4)


def gif(width: int, height: int, frame: tuple[int, int] | None = None) -> bytes:
    """Return a GIF of one colour whose picture, or its `frame` of another size, has hardly any data."""
    w, h = frame or (width, height)
    head = b"GIF89a" + struct.pack("<HHBBB", width, height, 0x80, 0, 0) + b"\0\0\0\xff\xff\xff"
    return head + b"," + struct.pack("<HHHHB", 0, 0, w, h, 0) + b"\x02\x02\x4c\x01\x00;"


def bmp(width: int, height: int, bits: int, compression: int, data: bytes) -> bytes:
    """Return a bitmap with a palette of 16 colours."""
    palette = bytes(range(64)) if bits <= 8 else b""
    head = struct.pack("<IiiHHIIiiII", 40, width, height, 1, bits, compression, len(data), 0, 0, len(palette) // 4, 0)
    start = 14 + len(head) + len(palette)
    return b"BM" + struct.pack("<IHHI", start + len(data), 0, 0, start) + head + palette + data


@cache
def seeds() -> tuple[bytes, ...]:
    """Return whole files."""
    color, grey = scene(), scene(channels=1)
    files = [b"P5\n# a comment\n56 40\n255\n" + grey.tobytes(), b"P6 56 40 255\n" + color.tobytes()]
    files += [
        b"P2\n4 3\n15\n1 2 3 4\n5 6 7 8\n9 10 11 12\n",
        b"P1\n4 3\n1 0 1 0\n1111 0000\n",
        b"P4\n12 3\n" + bytes(6),
    ]
    files += [
        b"P5 28 40 4095\n" + grey.tobytes(),
        b"P7\nWIDTH 56\nHEIGHT 40\nDEPTH 1\nMAXVAL 255\nENDHDR\n" + grey.tobytes(),
    ]
    files += [tiff(grey.tobytes(), 56, 40, {}), tiff(grey.tobytes(), 56, 40, {274: 6}, ">")]
    files += [tiff(color.tobytes(), 56, 40, {258: 8, 262: 2, 277: 3}), tiff(bytes(280), 56, 40, {258: 1})]
    rows = b"".join(bytes([7, *range(7)]) for _ in range(40))
    files += [gif(4, 4), gif(200, 100), bmp(8, 8, 8, 1, b"\x08\x01\0\0" * 8 + b"\0\1"), bmp(8, 40, 4, 2, rows)]
    files += [bmp(16, 8, 24, 0, bytes(384)), bmp(16, -8, 32, 0, bytes(512)), bmp(16, 8, 1, 0, bytes(32))]
    deep = scene(dtype="u2")
    floats = color.astype(np.float32)
    encoded = ((".tiff", color), (".tiff", deep), (".tiff", floats), (".webp", color), (".jp2", grey), (".hdr", floats))
    for suffix, pixels in (*encoded, (".pfm", floats), (".ras", color), (".avif", color), (".gif", color)):
        with suppress(cv2.error):
            done, data = cv2.imencode(suffix, pixels)
            files += [data.tobytes()] if done else []
    return tuple(files)


def mutate(rng: Rng, data: bytes) -> bytes:
    """Return a file with one mutation more."""
    if data[:4] in (b"II*\0", b"MM\0*") and chance(rng, 0.7):
        return _mutate_tiff(rng, data)
    if data[:1] == b"P" and chance(rng, 0.7):
        return _mutate_header_text(rng, data)
    if chance(rng, 0.6):  # a number of the head
        width = choice(rng, (1, 2, 2, 4, 4))
        at = int(rng.integers(min(64, len(data) + 1)))
        order: Literal["big", "little"] = "big" if chance(rng, 0.3) else "little"
        old = int.from_bytes(data[at : at + width], order)
        new = choice(rng, (number(rng, old, 8 * width), 20_000, 32_000, 65_535)) % 2 ** (8 * width)
        return overwritten(data, at, new.to_bytes(width, order))
    return mangled(rng, data)


def _mutate_header_text(rng: Rng, data: bytes) -> bytes:
    numbers = [m for m in re.finditer(rb"\d+", data[:80]) if m.start() > 1]
    if not numbers or chance(rng, 0.2):
        return bytes((data[0], choice(rng, b"1234567Ff"))) + data[2:]
    old = choice(rng, numbers)
    new = choice(
        rng,
        (b"0", b"1", b"-1", b"32000", b"65535", b"65536", b"100000", b"4294967297", b"9" * 400, b"1e3", b"\0", b" "),
    )
    return data[: old.start()] + new + data[old.end() :]


def _mutate_tiff(rng: Rng, data: bytes) -> bytes:
    order = "<" if data[:2] == b"II" else ">"
    try:
        (start,) = struct.unpack_from(f"{order}I", data, 4)
        (count,) = struct.unpack_from(f"{order}H", data, start)
    except struct.error:
        return mangled(rng, data)
    at = start + 2 + 12 * int(rng.integers(max(1, min(count, 100))))
    entry = data[at : at + 12]
    if len(entry) < 12:
        return mangled(rng, data)
    tag, kind, items, value = struct.unpack(f"{order}HHII", entry)
    roll = int(rng.integers(6))
    if roll == 0:
        tag = choice(
            rng,
            (254, 256, 257, 258, 259, 262, 266, 273, 274, 277, 278, 279, 284, 317, 322, 323, 324, 325, 330, 338, 339),
        )
    elif roll == 1:
        kind = choice(rng, (*_SIZES, 0, 13, 255))
    elif roll == 2:
        items = number(rng, items, 32)
    elif roll == 3:
        value = choice(rng, (0, 1, 2, 3, 4, 5, 6, 7, 8, 16, 32, 64, 32773, 32946, 34892, 50_000))
    else:
        value = number(rng, value, 32)
    return overwritten(data, at, struct.pack(f"{order}HHII", tag, kind, items, value))
