# SPDX-License-Identifier: Apache-2.0
"""The structure of a TIFF or BigTIFF file (TIFF 6.0): its first picture, and what decoding that costs.

A decoder gets the first directory with the tags that make the picture, and no other: fewer ways to harm it, and no
orientation, which decoders apply unasked.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np

from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.image_files.checks import CheckedPicture
from imgu_ros.image_files.cost import PART_PX, PictureFile, check_memory

#: Byte order, and whether it is a BigTIFF, by the first four bytes.
BYTE_ORDERS = {b"II*\0": ("<", False), b"MM\0*": (">", False), b"II+\0": ("<", True), b"MM\0+": (">", True)}
#: numpy's letters for TIFF's unsigned integer types: BYTE, SHORT, LONG, LONG8.
INTEGERS = {1: "u1", 3: "u2", 4: "u4", 16: "u8"}

_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC, _FILL_ORDER = 256, 257, 258, 259, 262, 266
_STRIP_OFFSETS, _SAMPLES, _STRIP_ROWS, _STRIP_SIZES, _PLANES = 273, 277, 278, 279, 284
_PREDICTOR, _COLORS, _TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_SIZES = 317, 320, 322, 323, 324, 325
_EXTRA, _FORMAT = 338, 339
#: The tags of a picture, and how many values one has at most; None: one for each strip or tile.
_TAGS: dict[int, int | None] = {
    _WIDTH: 1, _HEIGHT: 1, _BITS: 4, _COMPRESSION: 1, _PHOTOMETRIC: 1, _FILL_ORDER: 1,
    _STRIP_OFFSETS: None, _SAMPLES: 1, _STRIP_ROWS: 1, _STRIP_SIZES: None, _PLANES: 1, _PREDICTOR: 1,
    _COLORS: 3 * 2**16, _TILE_WIDTH: 1, _TILE_HEIGHT: 1, _TILE_OFFSETS: None, _TILE_SIZES: None, _EXTRA: 3,
    _FORMAT: 4,
}  # fmt: skip
_COMPRESSIONS = {1: "none", 5: "LZW", 8: "deflate", 32946: "deflate", 32773: "PackBits"}
#: Grey (white or black is 0), RGB, palette, CMYK.
_PALETTE, _PHOTOMETRICS = 3, (0, 1, 2, 3, 5)
_DEPTHS = (1, 2, 4, 8, 10, 12, 14, 16, 32)
_MOST_TAGS = 4096


def is_tiff(content: bytes) -> bool:
    """Return whether the bytes begin as a TIFF or BigTIFF file does."""
    return content[:4] in BYTE_ORDERS


def check_tiff(content: bytes, limits: LimitsParameters) -> CheckedPicture:
    """Read the first directory, and make it one of the picture's tags alone.

    Raises
    ------
    EncodingError
        If the directory is damaged, or the picture of a kind that is not read: compressed as JPEG or for fax, of other
        colours than grey, RGB, palette and CMYK, or of other depths.
    """
    check_memory(2 * len(content), "TIFF", limits)
    directory = _Directory(content)
    file = _picture(directory.values, len(content), limits)
    return CheckedPicture(file, np.frombuffer(directory.stripped(), np.uint8))


class _Directory:
    """The first directory: the values of the picture's tags, by tag."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._order, self._is_big = BYTE_ORDERS[content[:4]]
        self._count_form = self._order + ("Q" if self._is_big else "H")
        try:
            (self._position,) = struct.unpack_from(self._order + ("8xQ" if self._is_big else "4xI"), content)
            (count,) = struct.unpack_from(self._count_form, content, self._position)
        except (struct.error, OverflowError):
            raise _damaged("no directory") from None
        self._start = self._position + struct.calcsize(self._count_form)
        self._entry_size = 20 if self._is_big else 12
        if count > _MOST_TAGS or self._start + self._entry_size * count > len(content):
            raise _damaged(f"a directory of {count} tags")
        self._count = count
        self._entries: list[bytes] = []
        self.values: dict[int, np.ndarray] = {}
        for at in range(self._start, self._start + self._entry_size * count, self._entry_size):
            self._add(content[at : at + self._entry_size])

    def _add(self, entry: bytes) -> None:
        tag, kind = struct.unpack_from(self._order + "HH", entry)
        if tag not in _TAGS:
            return
        if tag in self.values:
            raise _damaged(f"tag {tag} twice")
        place = self._order + ("Q" if self._is_big else "I")
        (count,) = struct.unpack_from(place, entry, 4)
        most = _TAGS[tag]
        dtype = np.dtype(INTEGERS.get(kind, "V1")).newbyteorder(self._order)  # type: ignore[arg-type]
        value_at = len(entry) - struct.calcsize(place)
        if dtype.kind != "u" or not count or (most is not None and count > most):
            raise _damaged(f"tag {tag} of type {kind} with {count} values")
        if count * dtype.itemsize <= len(entry) - value_at:
            values = np.frombuffer(entry, dtype, count, value_at)
        else:
            (offset,) = struct.unpack_from(place, entry, value_at)
            if offset + count * dtype.itemsize > len(self._content):
                raise _damaged(f"tag {tag} of {count} values, beyond the end of the file")
            values = np.frombuffer(self._content, dtype, count, offset)
        self.values[tag] = values
        self._entries.append(entry)

    def stripped(self) -> bytearray:
        """Return the file with the tags that were read alone, and no further directory."""
        data = bytearray(self._content)
        struct.pack_into(self._count_form, data, self._position, len(self._entries))
        entries = b"".join(self._entries)
        end = struct.pack(self._order + ("Q" if self._is_big else "I"), 0)
        block = (entries + end)[: len(data) - self._start]
        data[self._start : self._start + len(block)] = block
        return data


def _picture(values: Mapping[int, np.ndarray], size: int, limits: LimitsParameters) -> PictureFile:
    def one(tag: int, default: int = 0) -> int:
        return int(values[tag][0]) if tag in values else default

    width, height, samples = one(_WIDTH), one(_HEIGHT), one(_SAMPLES, 1)
    bits, photometric, compression = one(_BITS, 1), one(_PHOTOMETRIC, 1), one(_COMPRESSION, 1)
    if not width or not height:
        raise EncodingError(f"TIFF of {width} x {height} px; need at least 1 x 1")
    if samples == 2:  # decoders lose alpha, and depth
        raise EncodingError("a TIFF of grey and alpha; need it without transparency, or as a PNG")
    if compression not in _COMPRESSIONS:
        raise EncodingError(f"TIFF of compression {compression}; need none, LZW, deflate or PackBits")
    if bits not in _DEPTHS or not 1 <= samples <= 4 or photometric not in _PHOTOMETRICS:
        said = f"{samples} samples of {bits} bits, colours of kind {photometric}"
        raise EncodingError(f"TIFF of {said}; need grey, RGB, palette or CMYK of 8 or 16 bits, or float32")
    if _BITS in values and (values[_BITS] != bits).any():
        raise EncodingError(f"TIFF of {values[_BITS].tolist()} bits; need the same for each sample")
    planes = samples if one(_PLANES, 1) == 2 else 1
    is_tiled = _TILE_WIDTH in values or _TILE_OFFSETS in values
    across = one(_TILE_WIDTH) if is_tiled else width
    down = one(_TILE_HEIGHT) if is_tiled else min(one(_STRIP_ROWS, height), height)
    if not across or not down:
        raise _damaged(f"parts of {across} x {down} px")
    parts = -(-width // across) * -(-height // down) * planes
    offsets, sizes = (_TILE_OFFSETS, _TILE_SIZES) if is_tiled else (_STRIP_OFFSETS, _STRIP_SIZES)
    count = len(values.get(offsets, ()))
    if count != parts or len(values.get(sizes, ())) not in (0, parts):
        raise _damaged(f"{count} strips or tiles for {width} x {height} px in parts of {across} x {down}")
    # Parts may lie upon each other: each is read as often as it is named.
    check_memory(sum(map(int, values.get(sizes, ()))), f"TIFF of {parts} strips or tiles", limits)
    channels = 1 if samples == 1 and photometric != _PALETTE else 4 if samples == 4 else 3
    value_bytes = 1 if bits <= 8 else 2 if bits <= 16 else 4
    part_bytes = across * down * (4 + 2 * max(samples * bits // 8, 1))
    return PictureFile(
        "tiff", width, height, channels, value_bytes, size,
        working_bytes=part_bytes, passes_px=parts * (across * down + PART_PX),
    )  # fmt: skip


def _damaged(what: str) -> EncodingError:
    return EncodingError(f"TIFF with {what}; need an undamaged file")
