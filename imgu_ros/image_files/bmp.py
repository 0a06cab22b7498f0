# SPDX-License-Identifier: Apache-2.0
"""The structure of a BMP file without compression: its size, and whether it is whole."""

from __future__ import annotations

import struct

from imgu_ros.errors import EncodingError
from imgu_ros.image_files.cost import PictureFile

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
