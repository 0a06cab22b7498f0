# SPDX-License-Identifier: Apache-2.0
"""The structure of a WebP file (RFC 9649): its size, and what decoding costs."""

from __future__ import annotations

import re
import struct
from functools import cache

import cv2

from imgu_ros.errors import EncodingError
from imgu_ros.image_files.cost import PictureFile

#: Older ones come with a decoder that a file can make write beyond its memory (CVE-2023-4863).
_SAFE_OPENCV = (4, 8, 1)
_ANIMATED, _TRANSPARENT = 0x02, 0x10
#: Of a lossless picture: a group of code tables is for 4 x 4 px or more, and takes so many bits of file and bytes.
_MOST_GROUPS, _GROUP_PX, _GROUP_BITS, _GROUP_BYTES = 2**16, 16, 20, 8000


def is_webp(content: bytes) -> bool:
    """Return whether the bytes begin as a WebP file does."""
    return content[:4] == b"RIFF" and content[8:12] == b"WEBP"


@cache
def is_decoder_safe() -> bool:
    """Return whether this OpenCV decodes WebP safely: it is new enough, or uses the system's library."""
    version = tuple(int(part) for part in cv2.__version__.split(".")[:3])
    return version >= _SAFE_OPENCV or not re.search(r"WEBP:\s+build", cv2.getBuildInformation())


def check_webp(content: bytes) -> PictureFile:
    """Find the picture among the chunks.

    Raises
    ------
    EncodingError
        If there is none, it is animated, damaged, or this OpenCV's decoder is not safe.
    """
    if not is_decoder_safe():
        need = "need OpenCV 4.8.1 or newer, whose decoder no file can harm, or the picture as PNG"
        raise EncodingError(f"WebP with OpenCV {cv2.__version__}; {need}")
    position, canvas, is_transparent = 12, None, False
    while position + 8 <= len(content):
        name, length = struct.unpack_from("<4sI", content, position)
        head = content[position + 8 : position + 18]
        if len(head) < min(length, 10):
            break
        if name == b"VP8X" and len(head) == 10 and canvas is None:
            if head[0] & _ANIMATED:
                raise EncodingError("WebP animation; need a single picture")
            is_transparent = bool(head[0] & _TRANSPARENT)
            canvas = 1 + int.from_bytes(head[4:7], "little"), 1 + int.from_bytes(head[7:10], "little")
        elif name in (b"VP8 ", b"VP8L"):
            return _picture(content, name, head, canvas, is_transparent)
        position += 8 + length + length % 2
    raise EncodingError(f"WebP without a picture in its {len(content)} bytes; need the whole file")


def _picture(
    content: bytes, name: bytes, head: bytes, canvas: tuple[int, int] | None, is_transparent: bool
) -> PictureFile:
    is_lossless = name == b"VP8L"
    if is_lossless and len(head) >= 5 and head[0] == 0x2F:
        bits = int.from_bytes(head[1:5], "little")
        width, height, is_transparent = 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF), True
    elif not is_lossless and head[3:6] == b"\x9d\x01\x2a" and len(head) == 10:
        width, height = (value & 0x3FFF for value in struct.unpack("<HH", head[6:10]))
    else:
        raise EncodingError(f"WebP chunk {name!r} begins with {head[:6].hex(' ')}; need an undamaged file")
    if canvas is not None and canvas != (width, height):
        raise EncodingError(f"WebP of {canvas[0]} x {canvas[1]} px with a picture of {width} x {height}; need one size")
    pixels, working = width * height, 0
    if is_lossless or is_transparent:
        groups = min(_MOST_GROUPS, pixels // _GROUP_PX + 1, 8 * len(content) // _GROUP_BITS)
        working = 5 * pixels + groups * _GROUP_BYTES
    return PictureFile("webp", width, height, 4 if is_transparent else 3, 1, len(content), working_bytes=working)
