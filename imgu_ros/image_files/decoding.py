# SPDX-License-Identifier: Apache-2.0
"""The pixels of a JPEG or PNG file, also of a JPEG that lacks nothing but its end marker."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.image_files.checks import check_picture_file
from imgu_ros.image_files.cost import PictureFile
from imgu_ros.types import Image


@dataclass(frozen=True, slots=True, eq=False)
class DecodedPicture:
    """A decoded file.

    Attributes
    ----------
    pixels : (H, W) or (H, W, C), as OpenCV orders channels
    remark : what is odd about the file, for people; empty when nothing is
    """

    pixels: Image
    remark: str = ""


def decode_picture_file(
    data: NDArray[np.uint8], limits: LimitsParameters = DEFAULT_LIMITS, pixel_bytes: int = 0
) -> DecodedPicture:
    """Decode a JPEG or PNG file: with alpha, and not turned by an orientation tag.

    A JPEG without an end marker, as some cameras send it, is decoded when its picture is complete: whatever is put
    behind it must change nothing. Where rows are missing, it would.

    Parameters
    ----------
    data : (N,) the file
    limits : what decoding may cost
    pixel_bytes : bytes that the caller will need for each pixel

    Raises
    ------
    EncodingError
        If the data are no JPEG or PNG, cut, damaged, or cost more than the limits allow.
    """
    checked = check_picture_file(data, limits, pixel_bytes)
    if checked.file.has_end:
        return DecodedPicture(decode_checked(checked.data, checked.file))
    content = _without_padding(data.tobytes())
    with _STDERR, _without_messages():
        ended, continued = (
            decode_checked(np.frombuffer(content + tail + _END, np.uint8), checked.file)
            for tail in (b"", _more(content))
        )
    # Row by row: at once, it would take as much memory again.
    if not all(map(np.array_equal, ended, continued)):
        raise EncodingError(f"JPEG cut after {len(data)} bytes; need the whole file")
    return DecodedPicture(ended, "JPEG without its end marker (ff d9), read as if it were there")


def decode_checked(data: NDArray[np.uint8], file: PictureFile) -> Image:
    """Decode a file whose structure was checked; the picture must be of the size that the structure says.

    Raises
    ------
    EncodingError
        If it does not decode, or to another size.
    """
    try:
        # Unchanged: with alpha, and not turned.
        pixels: Image | None = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        cause = " ".join((error.err or "damaged data").split())
        raise EncodingError(f"{cause}; need a {file.kind.upper()} that decodes") from None
    if pixels is None or pixels.size == 0:
        raise EncodingError(f"{len(data)} bytes that do not decode; need a {file.kind.upper()} that does")
    if pixels.shape[:2] != (file.height, file.width) or pixels.itemsize > file.value_bytes:
        got = f"{pixels.shape[1]} x {pixels.shape[0]} px of {8 * pixels.itemsize} bits"
        raise EncodingError(f"{file.kind.upper()} of {file.width} x {file.height} px decodes to {got}; need the former")
    return pixels


_END = b"\xff\xd9"
#: Codes of large coefficients: they change every block that is missing.
_NOISE = bytes.fromhex("fd5afb3cf796ee5c") * 16
#: As many zeros are no picture's end.
_PADDING = 8

_STDERR = threading.Lock()
_JPEG_MESSAGE = b"Corrupt JPEG data"


def _more(content: bytes) -> bytes:
    """Return what more of a picture could follow a JPEG's data, also where it has restart markers."""
    last, following = max((content.rfind(bytes((0xFF, 0xD0 + part))), part + 1) for part in range(8))
    following = following if last >= 0 else 0
    return _NOISE + b"".join(bytes((0xFF, 0xD0 + (following + part) % 8)) + _NOISE for part in range(8))


def _without_padding(content: bytes) -> bytes:
    """Return a JPEG's bytes without what follows its data: half an end marker, or a driver's zeros."""
    stripped = content.rstrip(b"\0")
    if len(content) - len(stripped) >= _PADDING:
        content = stripped + b"\0" if stripped.endswith(b"\xff") else stripped  # ff 00 is a byte of the picture
    return content.rstrip(b"\xff")


@contextmanager
def _without_messages() -> Iterator[None]:
    """Keep libjpeg's remarks about a missing end from stderr; what others write there meanwhile comes afterwards."""
    try:
        kept = os.memfd_create("stderr")
    except OSError:  # not on this system
        yield
        return
    try:
        real = os.dup(2)
    except OSError:  # stderr is closed
        os.close(kept)
        yield
        return
    os.dup2(kept, 2)
    try:
        yield
    finally:
        os.dup2(real, 2)
        os.lseek(kept, 0, os.SEEK_SET)
        lines = os.read(kept, 2**20).splitlines(keepends=True)
        others = b"".join(line for line in lines if not line.startswith(_JPEG_MESSAGE))
        if others:
            os.write(real, others)
        os.close(kept)
        os.close(real)
