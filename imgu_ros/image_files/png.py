# SPDX-License-Identifier: Apache-2.0
"""The structure of a PNG file (PNG specification, section 5): its size, whether it is whole, and what it unpacks to."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.image_files.cost import PART_PX, FileKind, PictureFile, check_passes

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
#: Chunks that make the picture. Decoders get no others: profiles, texts, Exif and animations can be made to harm.
_NEEDED = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
#: Bits of a value that each colour type may have, and its values a pixel.
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_VALUES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_PALETTE = 3
#: Columns and rows of the passes of an interlaced picture: first and step (section 8.2).
_ADAM7 = ((0, 8, 0, 8), (4, 8, 0, 8), (0, 4, 4, 8), (2, 4, 0, 4), (0, 2, 2, 4), (1, 2, 0, 2), (0, 1, 1, 2))
#: Deflate makes at most so many bytes of one.
_EXPANSION = 1032
#: Data up to here unpack in a second or two whatever they hold; larger ones are unpacked for trial.
_TRUSTED_BYTES = 2**21
_STEP = 2**16
#: Writers leave some bytes behind the picture.
_SURPLUS_BYTES = 2**20


@dataclass(frozen=True, slots=True, eq=False)
class PngFile:
    """What the structure tells, and the bytes that make the picture."""

    file: PictureFile
    data: NDArray[np.uint8]


def check_png(content: memoryview, limits: LimitsParameters) -> PngFile:
    """Walk the chunks to IEND, checksums included.

    Raises
    ------
    EncodingError
        If the file is cut, damaged, has too many chunks, or its data can be no picture of the size that it claims.
    """
    chunks: list[memoryview] = []
    idat: list[memoryview] = []
    header = b""
    position, count, is_lean = len(PNG_MAGIC), 0, True
    while True:
        if len(content) < position + 12:
            raise _cut(content)
        length, name = struct.unpack_from(">I4s", content, position)
        end = position + 8 + length
        if len(content) < end + 4:
            raise _cut(content)
        if zlib.crc32(content[position + 4 : end]) != int.from_bytes(content[end : end + 4], "big"):
            raise EncodingError(f"wrong checksum in PNG chunk {name!r} at byte {position}; need an undamaged file")
        if bool(header) == (name == b"IHDR"):
            raise EncodingError(f"PNG {'has a second' if header else f'begins with chunk {name!r}; need'} IHDR")
        count += 1
        check_passes(count * PART_PX, f"PNG of {count} chunks", limits)
        if name == b"IHDR":
            header = bytes(content[position + 8 : end])
        if name == b"IDAT":
            idat.append(content[position + 8 : end])
        if name in _NEEDED:
            chunks.append(content[position : end + 4])
        elif not name[0] & 0x20:
            raise EncodingError(f"PNG chunk {name!r} at byte {position}; need {b' '.join(_NEEDED).decode()} alone")
        is_lean &= name in _NEEDED
        position = end + 4
        if name == b"IEND":
            break
    file = _picture(header, len(content), any(bytes(chunk[4:8]) == b"tRNS" for chunk in chunks), count)
    _check_data(idat, _unpacked_bytes(header), f"PNG of {file.width} x {file.height} px")
    whole = content if is_lean else b"".join((PNG_MAGIC, *chunks))
    return PngFile(file, np.frombuffer(whole, np.uint8))


def _picture(header: bytes, size: int, is_transparent: bool, chunks: int) -> PictureFile:
    if len(header) != 13:
        raise EncodingError(f"PNG header of {len(header)} bytes; need 13")
    width, height, depth, color, *methods = struct.unpack(">IIBBBBB", header)
    if depth not in _DEPTHS.get(color, ()) or methods not in ([0, 0, 0], [0, 0, 1]):
        raise EncodingError(f"PNG of colour type {color}, {depth} bits, methods {methods}; need those of the format")
    if not width or not height:
        raise EncodingError(f"{width} x {height} px; need at least 1 x 1")
    opaque = 1 if color == 0 else 3
    channels = 4 if color in (4, 6) or (color and is_transparent) else opaque
    # Composing takes alpha beside the picture, grey too.
    passes_px = (7 if methods[2] else 1) * width * height + chunks * PART_PX
    values = (1 + (opaque == 1 and is_transparent)) if channels == 1 else channels
    return PictureFile(FileKind.PNG, width, height, values, depth // 9 + 1, size, passes_px=passes_px)


def _unpacked_bytes(header: bytes) -> int:
    """Return how many bytes the rows have, with the filter's byte before each."""
    width, height, depth, color, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    total = 0
    for left, across, top, down in _ADAM7 if interlaced else ((0, 1, 0, 1),):
        columns, rows = (
            max(-(-(size - first) // step), 0) for size, first, step in ((width, left, across), (height, top, down))
        )
        total += rows * (1 + -(-columns * depth * _VALUES[color] // 8)) if columns else 0
    return total


def _check_data(idat: list[memoryview], need: int, what: str) -> None:
    """Raise unless compressed data can be of the picture's size; where they are many, unpack them to see."""
    packed = sum(map(len, idat))
    if _EXPANSION * (packed + 1) < need:
        raise EncodingError(f"{what} in {packed} bytes; need at least {need // _EXPANSION}")
    if packed <= _TRUSTED_BYTES:
        return
    unpacking, got = zlib.decompressobj(), 0
    try:
        for chunk in idat:
            for at in range(0, len(chunk), _STEP):
                piece: bytes | memoryview = chunk[at : at + _STEP]
                while piece and not unpacking.eof:
                    got += len(unpacking.decompress(piece, 2**20))
                    piece = unpacking.unconsumed_tail
                    if got > need + _SURPLUS_BYTES:
                        raise EncodingError(f"{what} whose data unpack to more than {got} bytes; need {need}")
    except zlib.error as error:
        raise EncodingError(f"{what}: data that do not unpack ({error}); need an undamaged file") from None
    if got < need:
        raise EncodingError(f"{what} whose data unpack to {got} bytes; need {need}")


def _cut(content: memoryview) -> EncodingError:
    return EncodingError(f"PNG cut after {len(content)} bytes; need the whole file")
