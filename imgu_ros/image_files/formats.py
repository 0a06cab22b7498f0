# SPDX-License-Identifier: Apache-2.0
"""Which picture files are read, beside JPEG, PNG and PNM; their structure is checked before a decoder sees them."""

from __future__ import annotations

import re

import numpy as np

from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.image_files.bmp import check_bmp, is_bmp
from imgu_ros.image_files.checks import CheckedPicture
from imgu_ros.image_files.tiff import check_tiff, is_tiff
from imgu_ros.image_files.webp import check_webp, is_webp

_NEED = "need a PNM, PNG, TIFF, JPEG, BMP or WebP"
#: Formats that are not read, for people, by the pattern that a file of each begins with.
_NOT_READ = {
    "a GIF": rb"GIF8",
    "a JPEG 2000": rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51",
    "an AVIF or HEIC": rb".{4}ftyp",
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
