# SPDX-License-Identifier: Apache-2.0
"""What an image file says about its pixels beside them: orientation, and what its transparency means.

Decoders disagree about these: OpenCV turns TIFF files whatever it is asked for, PNG files in some versions, and loses
the transparent grey value of a PNG. Here the tags are read from the bytes; `files.images` applies them.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from imgu_ros.image_files.tiff import BYTE_ORDERS
from imgu_ros.types import Image

#: The orientation of a picture whose first row is its top, and whose first column is its left side.
UPRIGHT = 1
_ORIENTATION, _EXTRA_SAMPLES = 0x0112, 0x0152
_EXIF = b"Exif\0\0"
_PNG, _JPEG, _WEBP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"WEBP"
_START_OF_SCAN = 0xDA
#: struct's letters for TIFF's unsigned integer types: BYTE, SHORT, LONG, LONG8.
_INTEGERS = {1: "B", 3: "H", 4: "I", 16: "Q"}
_GREY, _GREY_ALPHA = 0, 4
#: What a file has more of is not looked at.
_MOST_TAGS, _MOST_CHUNKS = 4096, 200_000


class ExtraSample(StrEnum):
    """What a fourth channel is, if the decoder gives one."""

    STRAIGHT = "straight"  #: alpha beside colours of their own
    PREMULTIPLIED = "premultiplied"  #: alpha beside colours that were multiplied by it
    UNTOLD = "untold"  #: a TIFF that does not say; taken as straight
    OTHER = "other"  #: no alpha


@dataclass(frozen=True, slots=True)
class PictureTags:
    """What a file says about its pixels.

    Attributes
    ----------
    orientation : 1 to 8, as Exif and TIFF number them; 1: as stored, also when the file says nothing
    extra : what a fourth channel is
    clear_grey : the grey value that means transparent, and the largest that the file can hold; None: none does
    grey_with_alpha : a PNG holds grey and alpha; decoders give red, green and blue
    """

    orientation: int = UPRIGHT
    extra: ExtraSample = ExtraSample.STRAIGHT
    clear_grey: tuple[int, int] | None = None
    grey_with_alpha: bool = False


def picture_tags(content: bytes) -> PictureTags:
    """Return the tags of a PNG, JPEG, TIFF or WebP file; the defaults of any other. Damaged tags count as missing."""
    if content.startswith(_PNG):
        return _png_tags(content)
    if content.startswith(_JPEG):
        return PictureTags(_exif_orientation(next(_jpeg_exif(content), b"")))
    if content[:4] == b"RIFF" and content[8:12] == _WEBP:
        return PictureTags(_exif_orientation(dict(_chunks(content, 12, "<4sI")).get(b"EXIF", b"")))
    fields = {field.tag: field for field in _fields(content)}
    if not fields:
        return PictureTags()
    extra = fields.get(_EXTRA_SAMPLES)
    kinds = {None: ExtraSample.UNTOLD, 1: ExtraSample.PREMULTIPLIED, 2: ExtraSample.STRAIGHT}
    return PictureTags(
        _valid(fields[_ORIENTATION].value if _ORIENTATION in fields else UPRIGHT),
        kinds.get(None if extra is None else extra.value, ExtraSample.OTHER),
    )


def turned_upright(pixels: Image, orientation: int) -> Image:
    """Return a stored picture as it is to be looked at (Exif 2.3, table 4.6.4).

    Parameters
    ----------
    pixels : (H, W) or (H, W, C)
    orientation : 1 to 8: where the first row and the first column of the file are to be shown
    """
    if orientation in (3, 4, 6, 7):
        pixels = pixels[::-1]
    if orientation in (2, 3, 7, 8):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels.swapaxes(0, 1) if orientation >= 5 else pixels)


@dataclass(frozen=True, slots=True)
class _Field:
    """An unsigned integer in a directory of TIFF: its tag and its first value."""

    tag: int
    value: int


def _fields(content: bytes) -> Iterator[_Field]:
    """Yield the unsigned integers of a TIFF's first directory whose values lie in the directory itself."""
    order, big = BYTE_ORDERS.get(content[:4], ("", False))
    if not order:
        return
    try:
        offset = struct.unpack_from(order + ("8xQ" if big else "4xI"), content)[0]
        count = struct.unpack_from(order + ("Q" if big else "H"), content, offset)[0]
        start, size, value_at = (offset + 8, 20, 12) if big else (offset + 2, 12, 8)
        for position in range(start, min(start + size * min(count, _MOST_TAGS), len(content)), size):
            tag, kind = struct.unpack_from(order + "HH", content, position)
            values = struct.unpack_from(order + ("Q" if big else "I"), content, position + 4)[0]
            if kind in _INTEGERS and values * struct.calcsize(order + _INTEGERS[kind]) <= size - value_at:
                form = order + _INTEGERS[kind]
                yield _Field(tag, struct.unpack_from(form, content, position + value_at)[0])
    except (struct.error, OverflowError):  # the latter where a BigTIFF gives a place beyond all files
        return  # cut: what was read so far counts


def _png_tags(content: bytes) -> PictureTags:
    chunks = dict(_chunks(content, len(_PNG), ">I4s"))
    header = chunks.get(b"IHDR", b"")
    if len(header) < 10:
        return PictureTags()
    depth, color = header[8], header[9]
    clear = chunks.get(b"tRNS", b"")
    return PictureTags(
        _exif_orientation(chunks.get(b"eXIf", b"")),
        clear_grey=(int.from_bytes(clear, "big"), 2**depth - 1) if color == _GREY and len(clear) == 2 else None,
        grey_with_alpha=color == _GREY_ALPHA,
    )


def _chunks(content: bytes, position: int, form: str) -> Iterator[tuple[bytes, bytes]]:
    """Yield name and content of the chunks of a PNG (checksums follow) or a RIFF file (padded to even sizes)."""
    riff = form.startswith("<")
    for _ in range(_MOST_CHUNKS):
        if position + 8 > len(content):
            return
        first, second = struct.unpack_from(form, content, position)
        name, length = (first, second) if riff else (second, first)
        yield name, content[position + 8 : position + 8 + length]
        position += 8 + length + (length % 2 if riff else 4)


def _jpeg_exif(content: bytes) -> Iterator[bytes]:
    """Yield what the APP1 segments of a JPEG hold of Exif."""
    position = 2
    while position + 4 <= len(content) and content[position] == 0xFF:
        marker = content[position + 1]
        if marker == 0xFF:  # a fill byte
            position += 1
            continue
        if marker == _START_OF_SCAN:
            return
        length = int.from_bytes(content[position + 2 : position + 4], "big")
        segment = content[position + 4 : position + 2 + length]
        if marker == 0xE1 and segment.startswith(_EXIF):
            yield segment
        position += 2 + max(length, 2)


def _exif_orientation(exif: bytes) -> int:
    """Return the orientation in Exif data, which are a TIFF without pixels."""
    for field in _fields(exif.removeprefix(_EXIF)):
        if field.tag == _ORIENTATION:
            return _valid(field.value)
    return UPRIGHT


def _valid(orientation: int) -> int:
    return orientation if 1 <= orientation <= 8 else UPRIGHT
