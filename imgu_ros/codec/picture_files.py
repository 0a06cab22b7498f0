"""Whether the bytes of a JPEG or PNG file are whole, before a decoder sees them.

OpenCV decodes a cut JPEG to a half-grey picture, and takes the memory that a hostile size asks for; it says nothing.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

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


def check_picture_file(data: NDArray[np.uint8]) -> FileKind:
    """Check the structure of a JPEG or PNG file, from its first marker to its last.

    Raises
    ------
    EncodingError
        If it is neither, has no pixels or more than `MAX_PIXELS`, is cut, (PNG) fails a checksum, or is so much smaller
        than the picture it claims to hold that it was made to fill the memory.
    """
    content = data.tobytes()
    for kind, magic in _MAGIC.items():
        if content.startswith(magic):
            width, height = _CHECKS[kind](content)
            if width == 0 or height == 0 or width * height > MAX_PIXELS:
                raise EncodingError(f"{width} x {height} px; need 1 to {MAX_PIXELS} pixels")
            if width * height > max(_FREE_PIXELS, _MOST_PIXELS_PER_BYTE * len(content)):
                need = f"at most {_MOST_PIXELS_PER_BYTE} px for each byte above {_FREE_PIXELS} px"
                raise EncodingError(f"{width} x {height} px in {len(content)} bytes; need {need}")
            return kind
    start = content[:8].hex(" ") or "nothing"
    raise EncodingError(f"{len(content)} bytes that begin with {start}; need JPEG (ff d8 ff) or PNG (89 50 4e 47)")


class _Size(NamedTuple):
    width: int
    height: int


#: A marker inside the compressed scan: not a stuffed byte (ff 00), a fill byte, or a restart (ff d0 to ff d7).
_NEXT_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")
_START_OF_SCAN, _END = 0xDA, 0xD9
#: Start of frame, any process; c4, c8 and cc in the same range mean other things (ITU-T T.81, table B.1).
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def is_picture_file(data: NDArray[np.uint8]) -> bool:
    """Return whether the bytes begin as a JPEG or PNG file does."""
    return data[:8].tobytes().startswith(tuple(_MAGIC.values()))


def _check_jpeg(content: bytes) -> _Size:
    """Walk the segments of ITU-T T.81 B.1 to the end of the image."""
    size: _Size | None = None
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
            size = _Size(int.from_bytes(segment[3:5], "big"), int.from_bytes(segment[1:3], "big"))
        position += 2 + length
        if marker == _START_OF_SCAN:
            following = _NEXT_MARKER.search(content, position)
            if following is None:
                raise _cut(FileKind.JPEG, content)
            position = following.start()
    if size is None:
        raise EncodingError("a JPEG without a frame header; need an undamaged file")
    return size


def _check_png(content: bytes) -> _Size:
    """Walk the chunks of the PNG specification (section 5.3) to IEND, checksums included."""
    size: _Size | None = None
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
        if size is None:
            if name != b"IHDR" or length < 8:
                raise EncodingError(f"PNG begins with chunk {name!r}; need IHDR")
            size = _Size(*struct.unpack_from(">II", content, position + 8))
        if name == b"IEND":
            return size
        position = end + 4


def _cut(kind: FileKind, content: bytes) -> EncodingError:
    return EncodingError(f"{kind.upper()} cut after {len(content)} bytes; need the whole file")


_MAGIC = {FileKind.JPEG: b"\xff\xd8\xff", FileKind.PNG: b"\x89PNG\r\n\x1a\n"}
_CHECKS: dict[FileKind, Callable[[bytes], _Size]] = {FileKind.JPEG: _check_jpeg, FileKind.PNG: _check_png}
