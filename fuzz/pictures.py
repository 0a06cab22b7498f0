# SPDX-License-Identifier: Apache-2.0
"""JPEG as segments and PNG as chunks: seeds, and mutations that keep lengths and checksums right but their own.

Sources: ITU T.81; PNG specification (w3.org/TR/png).
"""

from __future__ import annotations

import struct
import zlib
from contextlib import suppress
from functools import cache

import cv2
import numpy as np

from fuzz.mutation import Rng, chance, choice, mangled, number, overwritten, text

Segment = tuple[int, bytes]
_ENTROPY = -1
_SOF = (0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC9, 0xCA)
_ALONE = (0xD8, 0xD9, *range(0xD0, 0xD8), 0x01)


def scene(
    height: int = 40, width: int = 56, channels: int = 3, dtype: str = "u1"
) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return a picture with edges and noise."""
    rng = np.random.default_rng(height * width)
    top = np.iinfo(dtype).max
    pixels = rng.integers(0, top // 4, (height, width, channels)).astype(dtype)
    pixels[height // 4 : height // 2, width // 4 :] += top // 2
    return pixels[:, :, 0] if channels == 1 else pixels


@cache
def jpeg_seeds() -> tuple[bytes, ...]:
    """Return JPEG files: baseline and progressive, grey and colour, with restarts."""
    options = (
        (),
        (cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        (cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
        (cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    )
    files = [
        cv2.imencode(".jpg", scene(channels=channels), list(option))[1].tobytes()
        for channels in (1, 3)
        for option in options
    ]
    return (*files, files[4][:2] + exif() + files[4][2:], files[0][:-2])


def exif(orientation: int = 6) -> bytes:
    """Return the APP1 segment with an orientation."""
    body = b"Exif\0\0" + b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    return b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body


def segments(data: bytes) -> list[Segment]:
    """Return a JPEG's segments: marker and content; the data of a scan, and what is none, have the marker -1."""
    found: list[Segment] = []
    at = 0
    while at < len(data):
        if data[at] != 0xFF or at + 1 >= len(data) or data[at + 1] in (0, 0xFF):
            end = at + 1
            while (end := data.find(b"\xff", end)) >= 0 and data[end + 1 : end + 2] in (b"\0", b"\xff"):
                end += 1
            end = len(data) if end < 0 else end
            found.append((_ENTROPY, data[at:end]))
            at = end
        elif data[at + 1] in _ALONE:
            found.append((data[at + 1], b""))
            at += 2
        else:
            length = int.from_bytes(data[at + 2 : at + 4], "big")
            found.append((data[at + 1], data[at + 4 : at + 2 + length]))
            at += 2 + max(2, length)
    return found


def jpeg(parts: list[Segment]) -> bytes:
    """Return the file of segments."""
    out = b""
    for marker, content in parts:
        if marker == _ENTROPY:
            out += content
        elif marker in _ALONE:
            out += bytes((0xFF, marker))
        else:
            out += bytes((0xFF, marker)) + struct.pack(">H", min(65535, len(content) + 2)) + content
    return out


def mutate_jpeg(rng: Rng, data: bytes) -> bytes:
    """Return a file with one mutation more."""
    parts = segments(data)
    if chance(rng, 0.15) or not parts:
        return mangled(rng, data)
    i, j = int(rng.integers(len(parts))), int(rng.integers(len(parts)))
    marker, content = parts[i]
    roll = int(rng.integers(12))
    if roll == 0:
        parts.insert(j, parts[i])
    elif roll == 1:
        del parts[i]
    elif roll == 2:
        parts[i], parts[j] = parts[j], parts[i]
    elif roll == 3:
        parts[i] = (choice(rng, (*_SOF, 0xC4, 0xDA, 0xDB, 0xDD, 0xDC, 0xE0, 0xE1, 0xEE, 0xFE, *_ALONE)), content)
    elif roll <= 6:
        parts = [_with_frame_header(rng, part) if part[0] in _SOF else part for part in parts]
        if chance(rng, 0.2):  # a second frame header
            parts.insert(j, _with_frame_header(rng, (0xC0, b"\x08\0\x28\0\x38\x01\x01\x11\0")))
    elif roll == 7:  # many scans
        scans = [k for k, (m, _) in enumerate(parts) if m == 0xDA]
        if scans:
            k = choice(rng, scans)
            parts[k:k] = parts[k : k + 2] * choice(rng, (1, 3, 30, 600))
    elif roll == 8:
        parts.insert(i, (choice(rng, (0xE0, 0xE1, 0xE2, 0xED, 0xFE, 0xDD)), text(rng, b"Exif\0\0MM\0*")[:60000]))
    elif roll == 9:
        parts.insert(i, choice(rng, ((0xDD, rng.bytes(2)), (0xDC, rng.bytes(2)), (0xD9, b""), (0xD0 + i % 8, b""))))
    else:
        parts[i] = (marker, mangled(rng, content))
    return jpeg(parts)


def _with_frame_header(rng: Rng, part: Segment) -> Segment:
    marker, content = part
    if len(content) < 6:
        return part
    roll = int(rng.integers(7))
    if roll <= 1:
        at = choice(rng, (1, 3))
        size = choice(rng, (0, 1, 8, 255, 4000, 20_000, 32_000, 65_535, int(rng.integers(65_536))))
        content = overwritten(content, at, struct.pack(">H", size))
        if chance(rng, 0.5):
            content = overwritten(content, 1, struct.pack(">HH", size, size))
    elif roll == 2:
        content = overwritten(content, 0, bytes([choice(rng, (0, 1, 4, 8, 12, 16))]))
    elif roll == 3:
        content = overwritten(content, 5, bytes([choice(rng, (0, 1, 2, 3, 4, 5, 255))]))
    elif roll == 4:  # sampling factors
        at = 7 + 3 * int(rng.integers(3))
        content = overwritten(content, at, bytes([choice(rng, (0, 0x11, 0x12, 0x21, 0x22, 0x41, 0x44, 0x4F, 0xFF))]))
    elif roll == 5:
        marker = choice(rng, _SOF)
    else:
        content = mangled(rng, content)
    return marker, content


#: PNG: colour type -> channels.
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
SIGNATURE = b"\x89PNG\r\n\x1a\n"
Chunk = tuple[bytes, bytes]


def png_file(chunks: list[Chunk]) -> bytes:
    """Return a file of chunks, their checksums right."""
    packed = [struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks]
    return SIGNATURE + b"".join(packed)


def simple_png(depth: int, color: int, interlace: int = 0, width: int = 40, height: int = 30) -> list[Chunk]:
    """Return the chunks of a picture of any kind that PNG has."""
    bits = depth * _CHANNELS[color]
    rng = np.random.default_rng(depth * 10 + color)
    sizes = [(width, height)]
    if interlace:  # Adam7
        steps = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
        sizes = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in steps]
    rows = b"".join(
        bytes([y % 5]) + rng.bytes(-(-w * bits // 8)) for w, h in sizes if w > 0 for y in range(h)
    )  # fmt: skip
    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, interlace)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    if color == 3:
        chunks[1:1] = [(b"PLTE", rng.bytes(3 * 2**depth)), (b"tRNS", bytes(range(2**depth))[:16])]
    return chunks


@cache
def png_seeds() -> tuple[bytes, ...]:
    """Return PNG files of every colour type and depth."""
    kinds = [(1, 0), (2, 0), (8, 0), (16, 0), (8, 2), (16, 2), (1, 3), (4, 3), (8, 3), (8, 4), (16, 4), (8, 6), (16, 6)]
    files = [png_file(simple_png(*kind)) for kind in kinds]
    files += [png_file(simple_png(8, 2, 1)), png_file(simple_png(16, 0, 1))]
    animated = simple_png(8, 2)
    animated[1:1] = [
        (b"acTL", struct.pack(">II", 2, 0)),
        (b"fcTL", struct.pack(">IIIIIHHBB", 0, 40, 30, 0, 0, 1, 10, 0, 0)),
    ]
    animated[-1:-1] = [
        (b"fcTL", struct.pack(">IIIIIHHBB", 1, 40, 30, 0, 0, 1, 10, 0, 0)),
        (b"fdAT", struct.pack(">I", 2) + animated[-2][1]),
    ]
    tagged = simple_png(8, 0)
    tagged[1:1] = [
        (b"gAMA", struct.pack(">I", 45455)), (b"eXIf", exif()[10:]), (b"tEXt", b"Comment\0text"),
        (b"iCCP", b"p\0\0" + zlib.compress(bytes(200))), (b"zTXt", b"k\0\0" + zlib.compress(b"x" * 100)),
        (b"tRNS", b"\0\5"), (b"pHYs", bytes(9)),
    ]  # fmt: skip
    return (*files, png_file(animated), png_file(tagged))


def png_chunks(data: bytes) -> list[Chunk]:
    """Return the chunks of a file, as far as they hold."""
    found: list[Chunk] = []
    at = len(SIGNATURE)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if at + 12 + length > len(data):
            break
        found.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return found


def mutate_png(rng: Rng, data: bytes) -> bytes:
    """Return a file with one mutation more."""
    chunks = png_chunks(data)
    if chance(rng, 0.15) or not chunks or not data.startswith(SIGNATURE):
        return mangled(rng, data)
    i, j = int(rng.integers(len(chunks))), int(rng.integers(len(chunks)))
    kind, content = chunks[i]
    roll = int(rng.integers(12))
    if roll == 0:
        chunks.insert(j, chunks[i])
    elif roll == 1:
        del chunks[i]
    elif roll == 2:
        chunks[i], chunks[j] = chunks[j], chunks[i]
    elif roll == 3:
        names = (
            b"IHDR",
            b"IDAT",
            b"IEND",
            b"PLTE",
            b"tRNS",
            b"acTL",
            b"fcTL",
            b"fdAT",
            b"iCCP",
            b"eXIf",
            b"XXXX",
            b"\xff\0a ",
        )
        chunks[i] = (choice(rng, names), content)
    elif roll <= 6:
        chunks[0] = (chunks[0][0], _with_header(rng, chunks[0][1]))
    elif roll <= 8:  # the pixels, packed again
        chunks = [(k, _repacked(rng, c)) if k in (b"IDAT", b"iCCP") else (k, c) for k, c in chunks]
    elif roll == 9:  # pixels without an end, or texts
        bomb = zlib.compress(bytes(choice(rng, (10**5, 10**7))), 1)
        name, head = choice(rng, ((b"IDAT", b""), (b"zTXt", b"k\0\0"), (b"iCCP", b"p\0\0"), (b"iTXt", b"k\0\1\0\0\0")))
        chunks.insert(1, (name, head + bomb))
    else:
        chunks[i] = (kind, mangled(rng, content))
    return png_file(chunks)


def _with_header(rng: Rng, content: bytes) -> bytes:
    roll = int(rng.integers(4))
    if roll == 0:
        sizes = (0, 1, 39, 41, 10_000, 20_000, 65_536, 2**31 - 1, 2**31, number(rng, 40, 32))
        content = overwritten(content, choice(rng, (0, 4)), struct.pack(">I", choice(rng, sizes)))
        if chance(rng, 0.4):
            content = overwritten(content, 0, content[4:8])
    elif roll == 1:
        content = overwritten(content, 8, bytes([choice(rng, (0, 1, 2, 4, 8, 16, 32))]))
    elif roll == 2:
        content = overwritten(content, 9, bytes([choice(rng, (0, 1, 2, 3, 4, 6, 7))]))
    else:
        content = overwritten(content, choice(rng, (10, 11, 12)), bytes([choice(rng, (0, 1, 2, 255))]))
    return content


def _repacked(rng: Rng, content: bytes) -> bytes:
    with suppress(zlib.error):
        plain = zlib.decompressobj().decompress(content, 10**7)
        return zlib.compress(mangled(rng, plain), choice(rng, (0, 1, 9)))
    return content
