# SPDX-License-Identifier: Apache-2.0
"""Which picture files are read, beside JPEG, PNG and PNM; their structure is checked before a decoder sees them."""

from __future__ import annotations

import re
import struct
from functools import cache

import cv2
import numpy as np

from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.image_files.checks import CheckedPicture
from imgu_ros.image_files.cost import PictureFile
from imgu_ros.image_files.tiff import check_tiff, is_tiff

_NEED = "need a PNM, PNG, TIFF, JPEG, BMP or WebP"
#: Formats that are not read, for people, by the pattern that a file of each begins with.
_NOT_READ = {
    "a GIF": rb"GIF8",
    "a JPEG 2000": rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51",
    "an AVIF or HEIC": rb".{4}ftyp(avi[fs]|hei[cfmsx]|hev[cmsx]|mi[fa][f1]|msf1)",
    "a video": rb".{4}(ftyp|moov|mdat|wide)|\x1aE\xdf\xa3|RIFF.{4}AVI ",
    "an OpenEXR": rb"v/1\x01",
    "a Radiance HDR": rb"#\?R",
    "a Sun raster": rb"\x59\xa6\x6a\x95",
    "a PAM or PFM": rb"P[7fF][ \t\r\n]",
}


def check_structure(content: bytes, limits: LimitsParameters) -> CheckedPicture:
    """Check the structure of a TIFF, WebP or BMP file.

    Raises
    ------
    EncodingError
        If it is none of these, cut, damaged, or of a kind that is not read.
    """
    if is_tiff(content):
        return check_tiff(content, limits)
    if is_webp(content):
        return CheckedPicture(check_webp(content), np.frombuffer(content, np.uint8))
    if is_bmp(content):
        return CheckedPicture(check_bmp(content), np.frombuffer(content, np.uint8))
    known = (name for name, start in _NOT_READ.items() if re.match(start, content, re.DOTALL))
    raise EncodingError(f"{next(known, f'not an image ({len(content)} bytes)')}; {_NEED}")


_OLD_HEADER = 12
_UNCOMPRESSED = (0, 3)
_DEPTHS = (1, 4, 8, 16, 24, 32)


def is_bmp(content: bytes) -> bool:
    """Return whether the bytes begin as a BMP file does."""
    return content[:2] == b"BM"


def check_bmp(content: bytes) -> PictureFile:
    """Read the header.

    Raises
    ------
    EncodingError
        If it is damaged or cut, or the pixels are compressed.
    """
    try:
        offset, header = struct.unpack_from("<II", content, 10)
        if header == _OLD_HEADER:
            width, height, _, bits = struct.unpack_from("<HHHH", content, 18)
            compression = 0
        else:
            width, height, _, bits, compression = struct.unpack_from("<iiHHI", content, 18)
    except struct.error:
        raise EncodingError(f"BMP cut after {len(content)} bytes; need the whole file") from None
    height = abs(height)
    if width <= 0 or height == 0 or bits not in _DEPTHS or (header != _OLD_HEADER and header < 40):
        raise EncodingError(f"BMP of {width} x {height} px, {bits} bits, header {header}; need an undamaged file")
    if compression not in _UNCOMPRESSED:
        raise EncodingError(f"BMP of compression {compression}; need none")
    need = offset + height * ((width * bits + 31) // 32 * 4)
    if len(content) < need:
        raise EncodingError(f"BMP of {width} x {height} px cut after {len(content)} bytes; need {need}")
    return PictureFile("bmp", width, height, 4 if bits == 32 else 3, 1, len(content))


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
