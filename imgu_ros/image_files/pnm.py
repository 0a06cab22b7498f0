# SPDX-License-Identifier: Apache-2.0
"""PNM files: PBM, PGM and PPM, plain (ASCII) and binary (IU 1.4.3; the netpbm project's format descriptions).

OpenCV reads them too, but scales plain files of maxval < 255 and not binary ones, lets values above maxval pass, and
writes to stderr about damaged ones. Here values are always those of the file.
"""

from __future__ import annotations

import math
import re

import numpy as np

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import EncodingError, ShapeError
from imgu_ros.image_files.cost import PictureFile, check_cost, check_passes
from imgu_ros.types import Image, as_image

#: Possessive: what could be taken back would be kept in memory, 200 bytes for each comment.
_GAP = rb"(?:[ \t\r\n\v\f]++|#[^\r\n]*+[\r\n])++"
_NUMBER = rb"(\d{1,10})"
_SIZE = re.compile(rb"P([1-6])" + _GAP + _NUMBER + _GAP + _NUMBER)
_MAXVAL = re.compile(_GAP + _NUMBER)
#: The one character between header and pixels, or a comment at once; after a space, # is the first pixel.
_END_OF_HEADER = re.compile(rb"#[^\r\n]*[\r\n]|[ \t\r\n\v\f]")
_COMMENT = re.compile(rb"#[^\r\n]*")
_END_OF_LINE = re.compile(rb"[\r\n]")
_SPACES = b" \t\r\n\v\f"
_PLAIN_NUMBERS = re.compile(rb"[0-9 \t\r\n\v\f]*")
#: Text is read in pieces of about so many bytes; a byte costs as much time as so many pixels, with comments more.
_PIECE, _TEXT_PX, _COMMENTED_PX = 2**20, 16, 64


def is_pnm(content: bytes) -> bool:
    """Return whether the bytes begin as a PBM, PGM or PPM file does."""
    return re.match(rb"P[1-6][ \t\r\n\v\f#]", content) is not None


def decode_pnm(content: bytes, limits: LimitsParameters = DEFAULT_LIMITS, pixel_bytes: int = 0) -> Image:
    """Decode the first image of a PNM file.

    Parameters
    ----------
    content : the file
    limits : what decoding may cost
    pixel_bytes : bytes that the caller will need for each pixel

    Returns
    -------
    (H, W), or (H, W, 3) RGB; values as in the file, never scaled: uint8 for maxval up to 255, else uint16. A bitmap
    (P1, P4) has 0 for black, which the file holds as 1, and 255 for white.

    Raises
    ------
    EncodingError
        If the header is none, the size is 0 or beyond the limits, the data are cut, or a value exceeds maxval.

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
    channels = 3 if kind in (3, 6) else 1
    dtype = np.uint16 if maxval > 255 else np.uint8
    check_cost(PictureFile("pnm", width, height, channels, np.dtype(dtype).itemsize, len(content)), limits, pixel_bytes)
    shape = (height, width, 3) if channels == 3 else (height, width)
    if kind == 4:
        return _bitmap(content, position, shape)
    if kind <= 3:
        return _plain(content, position, np.empty(shape, dtype), maxval, limits)
    values = _binary(content, position, shape, ">u2" if maxval > 255 else "u1")
    if int(values.max()) > maxval:
        raise _too_large(int(values.max()), maxval)
    return values.astype(dtype)


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
    values = np.unpackbits(rows, axis=1, count=shape[1])
    values -= 1  # 0 becomes 255, without memory for another picture
    return values


def _plain(content: bytes, start: int, out: Image, maxval: int, limits: LimitsParameters) -> Image:
    """Read numbers, or the digits of a bitmap, into `out`, piece by piece."""
    is_bitmap = content[:2] == b"P1"
    flat, filled, position, passes_px = out.reshape(-1), 0, start, 0
    while filled < flat.size and position < len(content):
        end = _end_of_piece(content, position)
        piece, position = content[position:end], end
        has_comments = b"#" in piece
        passes_px += (_COMMENTED_PX if has_comments else _TEXT_PX) * len(piece)
        check_passes(passes_px, f"PNM of {end - start} bytes of text", limits)
        if has_comments:
            piece = _COMMENT.sub(b" ", piece)
        values = (_digits if is_bitmap else _numbers)(piece, flat.size - filled)
        if values.size and int(values.max()) > maxval:
            if is_bitmap:
                raise EncodingError("PNM: something else than 0 and 1 in a bitmap; need these alone")
            raise _too_large(int(values.max()), maxval)
        flat[filled : filled + values.size] = values
        filled += values.size
    if filled < flat.size:
        raise EncodingError(f"PNM: {filled} values; need {flat.size}")
    if is_bitmap:
        flat -= 1  # black, 1, becomes 0 and 0 becomes 255
    return out


def _end_of_piece(content: bytes, position: int) -> int:
    """Return where a piece of text ends, between numbers and behind comments."""
    end = position + _PIECE
    if end >= len(content):
        return len(content)
    comment = content.rfind(b"#", position, end)
    if comment >= 0 and not _END_OF_LINE.search(content, comment, end):
        found = _END_OF_LINE.search(content, end)
        return len(content) if found is None else found.end()
    last = max(content.rfind(_SPACES[i : i + 1], position, end) for i in range(len(_SPACES)))
    return end if last < 0 else last + 1


def _digits(piece: bytes, most: int) -> Image:
    """Return the values of digits that may stand side by side."""
    digits = piece.translate(None, _SPACES)
    return np.frombuffer(digits, np.uint8, min(most, len(digits))) - np.uint8(ord("0"))


def _numbers(piece: bytes, most: int) -> Image:
    if not _PLAIN_NUMBERS.fullmatch(piece):  # what follows the picture may be anything
        tokens = piece.split(None, most)[:most]
        if not all(token.isdigit() for token in tokens):
            raise EncodingError("PNM: something else than numbers among the values; need decimal digits")
        piece = b" ".join(tokens)
    # A number beyond all bounds becomes the largest, which exceeds every maxval.
    values: Image = np.fromstring(piece.decode("ascii"), np.int64, sep=" ")[:most]
    return values


def _too_large(value: int, maxval: int) -> EncodingError:
    return EncodingError(f"PNM: value {value}; need at most the maxval of {maxval}")


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
