# SPDX-License-Identifier: Apache-2.0
"""Whether the bytes of a JPEG or PNG file are whole, and what decoding them costs, before a decoder sees them.

OpenCV decodes a cut JPEG to a half-grey picture, and takes the memory that a hostile size asks for; it says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.image_files.cost import PictureFile, check_cost
from imgu_ros.image_files.jpeg import check_jpeg
from imgu_ros.image_files.png import PNG_MAGIC, check_png

_JPEG_MAGIC = b"\xff\xd8\xff"


@dataclass(frozen=True, slots=True, eq=False)
class CheckedPicture:
    """A file that may be decoded: what its structure tells, and the bytes for the decoder."""

    file: PictureFile
    data: NDArray[np.uint8]


def check_picture_file(
    data: NDArray[np.uint8], limits: LimitsParameters = DEFAULT_LIMITS, pixel_bytes: int = 0
) -> CheckedPicture:
    """Check the structure of a JPEG or PNG file, from its first marker to its last, and what it costs.

    Parameters
    ----------
    data : (N,) the file
    limits : what decoding may cost
    pixel_bytes : bytes that the caller will need for each pixel

    Raises
    ------
    EncodingError
        If it is neither, has no pixels, is cut (a JPEG: before its last scan begins), damaged, of a kind that not all
        decoders read alike, or costs more than the limits allow.
    """
    content = memoryview(np.ascontiguousarray(data))
    start = bytes(content[:8])
    if start.startswith(_JPEG_MAGIC):
        checked = CheckedPicture(check_jpeg(content, limits), data)
    elif start == PNG_MAGIC:
        png = check_png(content, limits)
        checked = CheckedPicture(png.file, png.data)
    else:
        said = start.hex(" ") or "nothing"
        raise EncodingError(f"{len(data)} bytes that begin with {said}; need JPEG (ff d8 ff) or PNG (89 50 4e 47)")
    check_cost(checked.file, limits, pixel_bytes)
    return checked


def is_picture_file(data: NDArray[np.uint8]) -> bool:
    """Return whether the bytes begin as a JPEG or PNG file does."""
    return data[:8].tobytes().startswith((_JPEG_MAGIC, PNG_MAGIC))
