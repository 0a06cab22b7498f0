# SPDX-License-Identifier: Apache-2.0
"""Whether the bytes of a JPEG or PNG file are whole, before a decoder sees them.

OpenCV decodes a cut JPEG to a half-grey picture, and takes the memory that a hostile size asks for; it says nothing.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from imgu_ros.errors import EncodingError

#: More pixels than any sensor has: 16384 x 16384.
MAX_PIXELS = 2**28
#: Pictures larger than these have more in them than a few bytes tell: a JPEG of one colour has 85 px for each byte.
_FREE_PIXELS = 2**25
_MOST_PIXELS_PER_BYTE = 200


class FileKind(StrEnum):
    """Picture files that a CompressedImage may hold."""

    JPEG = "jpeg"
    PNG = "png"


@dataclass(frozen=True, slots=True)
class PictureFile:
    """What the structure of a file tells.

    Attributes
    ----------
    kind : JPEG or PNG
    width, height : of the picture, px
    has_end : the end marker is there; a JPEG without one may be cut, or lack only that
    """

    kind: FileKind
    width: int
    height: int
    has_end: bool = True


def check_picture_file(data: NDArray[np.uint8]) -> PictureFile:
    """Check the structure of a JPEG or PNG file, from its first marker to its last.

    Raises
    ------
    EncodingError
        If it is neither, has no pixels or more than `MAX_PIXELS`, is cut (a JPEG: before its last scan begins), (PNG)
        fails a checksum, or is so much smaller than the picture it claims to hold that it was made to fill the memory.
    """
    content = data.tobytes()
    for kind, magic in _MAGIC.items():
        if content.startswith(magic):
            file = _CHECKS[kind](content)
            width, height = file.width, file.height
            if width == 0 or height == 0 or width * height > MAX_PIXELS:
                raise EncodingError(f"{width} x {height} px; need 1 to {MAX_PIXELS} pixels")
            if width * height > max(_FREE_PIXELS, _MOST_PIXELS_PER_BYTE * len(content)):
                need = f"at most {_MOST_PIXELS_PER_BYTE} px for each byte above {_FREE_PIXELS} px"
                raise EncodingError(f"{width} x {height} px in {len(content)} bytes; need {need}")
            return file
    start = content[:8].hex(" ") or "nothing"
    raise EncodingError(f"{len(content)} bytes that begin with {start}; need JPEG (ff d8 ff) or PNG (89 50 4e 47)")


#: A marker inside the compressed scan: not a stuffed byte (ff 00), a fill byte, or a restart (ff d0 to ff d7).
_NEXT_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
_START_OF_SCAN, _END = 0xDA, 0xD9
#: Start of frame, any process; c4, c8 and cc in the same range mean other things (ITU-T T.81, table B.1).
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def is_picture_file(data: NDArray[np.uint8]) -> bool:
    """Return whether the bytes begin as a JPEG or PNG file does."""
    return data[:8].tobytes().startswith(tuple(_MAGIC.values()))


def _check_jpeg(content: bytes) -> PictureFile:
    """Walk the segments of ITU-T T.81 B.1 to the end of the image."""
    file: PictureFile | None = None
    scans = _Scans()
    position = 2
    while True:
        # A marker may be preceded by any number of fill bytes ff.
        while content[position : position + 2] == b"\xff\xff":
            position += 1
        head = content[position : position + 4]
        if len(head) >= 2 and head[0] == 0xFF and head[1] == _END:
            break
        if len(head) < 4:
            raise _cut(FileKind.JPEG, content)
        marker, length = head[1], int.from_bytes(head[2:4], "big")
        segment = content[position + 4 : position + 2 + length]
        if head[0] != 0xFF or length < 2:
            raise EncodingError(f"no JPEG marker at byte {position}; need an undamaged file")
        if len(segment) < length - 2:
            raise _cut(FileKind.JPEG, content)
        if marker in _FRAMES and length >= 7:
            height, width = (int.from_bytes(segment[at : at + 2], "big") for at in (1, 3))
            file = PictureFile(FileKind.JPEG, width, height)
            scans.frame(segment)
        position += 2 + length
        if marker == _START_OF_SCAN:
            scans.add(segment)
            following = _NEXT_MARKER.search(content, position)
            if following is None and file is not None and scans.are_complete:
                return replace(file, has_end=False)
            if following is None:
                raise _cut(FileKind.JPEG, content)
            position = following.start()
    if file is None:
        raise EncodingError("a JPEG without a frame header; need an undamaged file")
    return file


class _Scans:
    """Which coefficients the scans of a JPEG have brought, by component (T.81 B.2.3, G.1.1.1)."""

    def __init__(self) -> None:
        self._lowest_bit: dict[int, list[int | None]] = {}

    def frame(self, segment: bytes) -> None:
        """Take the frame's components."""
        self._lowest_bit = {identity: [None] * 64 for identity in segment[6::3]}

    def add(self, segment: bytes) -> None:
        """Take a scan's components, and the bits of which coefficients it brings."""
        if not segment or len(segment) < 2 * segment[0] + 4:
            return
        first, last, bits = segment[2 * segment[0] + 1 :][:3]
        for identity in segment[1 : 2 * segment[0] + 1 : 2]:
            known = self._lowest_bit.get(identity)
            for k in range(first, min(last, 63) + 1):
                if known is not None:
                    known[k] = bits & 15

    @property
    def are_complete(self) -> bool:
        """Whether every bit of every coefficient has begun to come."""
        return all(bit == 0 for bits in self._lowest_bit.values() for bit in bits)


def _check_png(content: bytes) -> PictureFile:
    """Walk the chunks of the PNG specification (section 5.3) to IEND, checksums included."""
    file: PictureFile | None = None
    position = len(_MAGIC[FileKind.PNG])
    while True:
        if len(content) < position + 12:
            raise _cut(FileKind.PNG, content)
        length, name = struct.unpack_from(">I4s", content, position)
        end = position + 8 + length
        if len(content) < end + 4:
            raise _cut(FileKind.PNG, content)
        if zlib.crc32(memoryview(content)[position + 4 : end]) != int.from_bytes(content[end : end + 4], "big"):
            raise EncodingError(f"wrong checksum in PNG chunk {name!r} at byte {position}; need an undamaged file")
        if file is None:
            if name != b"IHDR" or length < 8:
                raise EncodingError(f"PNG begins with chunk {name!r}; need IHDR")
            file = PictureFile(FileKind.PNG, *struct.unpack_from(">II", content, position + 8))
        if name == b"IEND":
            return file
        position = end + 4


def _cut(kind: FileKind, content: bytes) -> EncodingError:
    return EncodingError(f"{kind.upper()} cut after {len(content)} bytes; need the whole file")


_MAGIC = {FileKind.JPEG: b"\xff\xd8\xff", FileKind.PNG: b"\x89PNG\r\n\x1a\n"}
_CHECKS: dict[FileKind, Callable[[bytes], PictureFile]] = {FileKind.JPEG: _check_jpeg, FileKind.PNG: _check_png}
