# SPDX-License-Identifier: Apache-2.0
"""PNM files: PBM, PGM and PPM, plain (ASCII) and binary (notes 1.4.3; the netpbm project's format descriptions).

OpenCV reads them too, but scales plain files of maxval < 255 and not binary ones, lets values above maxval pass, and
writes to stderr about damaged ones. Here values are always those of the file.
"""

from __future__ import annotations

import math
import re

import numpy as np

from imgu_ros.codec.picture_files import MAX_PIXELS
from imgu_ros.errors import EncodingError, ShapeError
from imgu_ros.types import Image, as_image

_GAP = rb"(?:[ \t\r\n\v\f]|#[^\r\n]*[\r\n])+"
_NUMBER = rb"(\d{1,10})"
_SIZE = re.compile(rb"P([1-6])" + _GAP + _NUMBER + _GAP + _NUMBER)
_MAXVAL = re.compile(_GAP + _NUMBER)
#: The one character between header and pixels, or a comment at once; after a space, # is the first pixel.
_END_OF_HEADER = re.compile(rb"#[^\r\n]*[\r\n]|[ \t\r\n\v\f]")
_COMMENT = re.compile(rb"#[^\r\n]*")


def is_pnm(content: bytes) -> bool:
    """Return whether the bytes begin as a PBM, PGM or PPM file does."""
    return re.match(rb"P[1-6][ \t\r\n\v\f#]", content) is not None


def decode_pnm(content: bytes) -> Image:
    """Decode the first image of a PNM file.

    Parameters
    ----------
    content : the file

    Returns
    -------
    (H, W), or (H, W, 3) RGB; values as in the file, never scaled: uint8 for maxval up to 255, else uint16. A bitmap
    (P1, P4) has 0 for black, which the file holds as 1, and 255 for white.

    Raises
    ------
    EncodingError
        If the header is none, the size is 0 or beyond `MAX_PIXELS`, the data are cut, or a value exceeds maxval.

    Examples
    --------
    >>> decode_pnm(b"P2 3 1 4095  0 7 4095").tolist()
    [[0, 7, 4095]]
    """
    head = _SIZE.match(content)
    if head is None:
        raise EncodingError(f"PNM: header {content[:20]!r}; need P1 to P6, width and height")
    kind, width, height = (int(group) for group in head.groups())
    position, maxval = head.end(), 1
    if kind not in (1, 4):
        found = _MAXVAL.match(content, position)
        if found is None or not 1 <= int(found[1]) <= 65535:
            raise EncodingError(f"PNM: maxval {content[position : position + 12]!r}; need 1 to 65535")
        position, maxval = found.end(), int(found[1])
    if not 1 <= width * height <= MAX_PIXELS:
        raise EncodingError(f"PNM: {width} x {height} px; need 1 to {MAX_PIXELS} pixels")
    shape = (height, width, 3) if kind in (3, 6) else (height, width)
    if kind == 4:
        return _bitmap(content, position, shape)
    if kind <= 3:
        values = _plain(content[position:], shape, bitmap=kind == 1)
    else:
        values = _binary(content, position, shape, ">u2" if maxval > 255 else "u1")
    if int(values.max()) > maxval:
        raise EncodingError(f"PNM: value {values.max()}; need at most the maxval of {maxval}")
    if kind == 1:
        return np.where(values == 1, 0, 255).astype(np.uint8)
    return values.astype(np.uint16 if maxval > 255 else np.uint8)


def encode_pnm(pixels: Image, *, plain: bool = False, bitmap: bool = False) -> bytes:
    r"""Encode an image as PGM (grey), PPM (colour) or PBM.

    Parameters
    ----------
    pixels : (H, W) or (H, W, 3) RGB, uint8 or uint16; maxval is 255 or 65535, 16 bit is written big-endian
    plain : as text (P1, P2, P3), not binary (P4, P5, P6)
    bitmap : as PBM; then only 0 (black) and 255 (white) are allowed

    Raises
    ------
    ShapeError
        If it is no such image.

    Examples
    --------
    >>> encode_pnm(np.array([[1, 2]], np.uint16))
    b'P5\n2 1\n65535\n\x00\x01\x00\x02'
    """
    dtypes = (np.uint8,) if bitmap else (np.uint8, np.uint16)
    pixels = as_image(pixels, "image", (1,) if bitmap else (1, 3), dtypes, rescaled=False)
    height, width = pixels.shape[:2]
    if bitmap:
        if not np.isin(pixels, (0, 255)).all():
            raise ShapeError("image: grey values; need 0 and 255 alone for a bitmap")
        bits = pixels == 0
        head = f"P{1 if plain else 4}\n{width} {height}\n".encode()
        return head + (_text(bits.astype(np.uint8)) if plain else np.packbits(bits, axis=1).tobytes())
    kind = (2 if pixels.ndim == 2 else 3) + (0 if plain else 3)
    head = f"P{kind}\n{width} {height}\n{np.iinfo(pixels.dtype).max}\n".encode()
    return head + (_text(pixels) if plain else pixels.astype(pixels.dtype.newbyteorder(">")).tobytes())


def _binary(content: bytes, position: int, shape: tuple[int, ...], dtype: str) -> Image:
    position = _after_header(content, position)
    count = math.prod(shape)
    need = count * np.dtype(dtype).itemsize
    if len(content) - position < need:
        raise EncodingError(f"PNM: {len(content) - position} bytes of pixels; need {need}")
    return np.frombuffer(content, dtype, count, position).reshape(shape)


def _bitmap(content: bytes, position: int, shape: tuple[int, ...]) -> Image:
    """Decode rows of bits, each filled up to whole bytes."""
    rows = _binary(content, position, (shape[0], (shape[1] + 7) // 8), "u1")
    bits = np.unpackbits(rows, axis=1, count=shape[1])
    return np.where(bits == 1, 0, 255).astype(np.uint8)


def _plain(text: bytes, shape: tuple[int, ...], *, bitmap: bool) -> Image:
    text = _COMMENT.sub(b" ", text)
    # The digits of a bitmap may stand side by side.
    tokens = b"".join(text.split()) if bitmap else text.split(None, math.prod(shape))
    wanted = tokens[: math.prod(shape)]
    if len(wanted) < math.prod(shape):
        raise EncodingError(f"PNM: {len(wanted)} values; need {math.prod(shape)}")
    values: Image
    if isinstance(wanted, bytes):
        values = np.frombuffer(wanted, np.uint8) - np.uint8(ord("0"))
    elif all(token.isdigit() and len(token) <= 10 for token in wanted):
        values = np.array(wanted).astype(np.int64)
    else:
        raise EncodingError("PNM: something else than numbers among the values; need decimal digits")
    if bitmap and values.max() > 1:
        raise EncodingError("PNM: something else than 0 and 1 in a bitmap; need these alone")
    return values.reshape(shape)


def _text(values: Image) -> bytes:
    """Write numbers, a row of the picture in lines of at most 70 characters, as the format asks."""
    lines = []
    for row in values.reshape(len(values), -1).tolist():
        numbers = [str(value) for value in row]
        step = 70 // (max(map(len, numbers)) + 1)
        lines += [" ".join(numbers[i : i + step]) for i in range(0, len(numbers), step)]
    return ("\n".join(lines) + "\n").encode()


def _after_header(content: bytes, position: int) -> int:
    end = _END_OF_HEADER.match(content, position)
    if end is None:
        raise EncodingError("PNM: no white space after the header; need one character")
    return end.end()
