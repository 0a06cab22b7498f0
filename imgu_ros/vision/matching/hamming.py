# SPDX-License-Identifier: Apache-2.0
"""Hamming distances between all rows of two sets, by one product of matrices (IU 5.4.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Indices, as_plain
from imgu_ros.vision.matching.metrics import checked_rows, comparable_rows, require_index

#: Of bits that one product sums up: two such sums fit exactly into the 24 bits of a float32.
_CHUNK_BITS = 256
#: What one product holds, 16 MB: a product has its threads wait for each other, and many small ones suffer where
#: other processes compete for the processors.
_PRODUCT_ELEMENTS = 2**22
#: What one block of a table holds: it stays in the cache, whatever the sizes of the sets.
_BLOCK_ELEMENTS = 2**18


@dataclass(frozen=True, slots=True, eq=False)
class BinaryRows:
    """Rows of bits, ready to be compared with others again and again.

    Attributes
    ----------
    rows : (M, D / 8) uint8
    chunks : for each 256 of the D bits, and for the rest (K), a ((M + 1) // 2, K + 1) float32 matrix, two rows in one
    """

    rows: Image
    chunks: tuple[NDArray[np.float32], ...]

    def tables(self, src: Image) -> Iterator[NDArray[Any]]:
        """Yield how many more bits agree than differ, for all pairs; by blocks of successive rows.

        Parameters
        ----------
        src : (N, D / 8) uint8

        Yields
        ------
        (n, M) int16 (int32 where D >= 2^14) of D - 2 Hamming, and 256 more for each chunk. The n sum up to N. The
        next block overwrites it. O(N M D).
        """
        src = comparable_rows(src, self.rows.shape[1], np.uint8)
        pairs, bits = (len(self.rows) + 1) // 2, 8 * self.rows.shape[1]
        operands = [np.pad(signs, ((0, 0), (0, 1)), constant_values=1) for signs in _signs(src)]
        height = max(1, min(len(src), _BLOCK_ELEMENTS // max(1, 2 * pairs)))
        at_once = height * max(1, _PRODUCT_ELEMENTS // max(1, height * pairs))
        both = np.empty((height, pairs), "<i4")
        table = np.empty((height, 2 * pairs), "<i2" if bits < 2**14 else "<i4")
        for start in range(0, len(src), height):
            some = slice(start % at_once, start % at_once + height)
            if not some.start:
                products = [
                    operand[start : start + at_once] @ chunk.T
                    for operand, chunk in zip(operands, self.chunks, strict=True)
                ]
            n = len(products[0][some])
            for index, product in enumerate(products):
                np.copyto(both[:n], product[some], casting="unsafe")
                # The lower numbers have their 256 by the last column of the operands; here the upper ones get theirs.
                both[:n] += _CHUNK_BITS * 2**16
                if len(products) == 1:
                    table = both.view("<i2")
                elif index == 0:
                    table[:n] = both[:n].view("<i2")
                else:
                    table[:n] += both[:n].view("<i2")
            yield table[:n, : len(self.rows)]

    def distances(self, src: Image, index: Indices) -> Floats:
        """Return in how many bits each row of `src`, (N, D / 8) uint8, differs from the one of its index, (N,)."""
        src = comparable_rows(src, self.rows.shape[1], np.uint8)
        require_index(index, len(src), len(self.rows))
        return hamming_distance(src, self.rows[index]).astype(np.float64)


def binary_rows(rows: Image) -> BinaryRows:
    """Prepare (M, D / 8) uint8 rows for comparison.

    With bits as -1 and 1 the product of two rows of K bits is a whole number from -K to K. The rows 2j and 2j + 1
    become one, `row[2j] + 2^16 row[2j + 1]`, so that one product yields both numbers in half the time. It is exact in
    float32: a sum of up to 255 terms is below 2^24 in magnitude, and that of all 256 is even and below 2^25. A last
    column adds 256 to the lower number, which then is positive and borrows nothing from the upper one.

    Raises
    ------
    ShapeError
        If the rows are not of that kind.
    """
    rows = checked_rows(rows, "rows")
    if rows.dtype != np.uint8:
        raise ShapeError(f"rows: data type {rows.dtype}; need uint8")
    chunks = []
    for signs in _signs(rows):
        packed = np.full(((len(rows) + 1) // 2, signs.shape[1] + 1), _CHUNK_BITS, np.float32)
        packed[:, :-1] = signs[0::2]
        packed[: len(rows) // 2, :-1] += 2**16 * signs[1::2]
        chunks.append(packed)
    return BinaryRows(rows, tuple(chunks))


def _signs(rows: Image) -> Iterator[NDArray[np.float32]]:
    """Yield (N, K <= 256) chunks of the bits, as -1 and 1."""
    for start in range(0, rows.shape[1], _CHUNK_BITS // 8):
        signs = np.unpackbits(rows[:, start : start + _CHUNK_BITS // 8], axis=1).astype(np.float32)
        signs *= 2
        signs -= 1
        yield signs


#: How many bits are set in each byte; np.bitwise_count is in NumPy 2 alone.
_SET_BITS = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1).sum(axis=1, dtype=np.uint8)


def hamming_distance(a: Image, b: Image) -> NDArray[np.int64]:
    """Return in how many bits the rows of two sets of binary descriptors differ.

    Parameters
    ----------
    a, b : (..., D / 8) uint8, eight bits in each byte, as ORB and BRIEF have them, or (..., D) bool, one row or many.
        Rows are compared as numpy broadcasts: (N, D / 8) with (N, D / 8) row by row, with (D / 8,) each with the one,
        and `a[:, None]` with `b` all pairs, (N, M)

    Returns
    -------
    int64, the shape that the rows broadcast to; () for two single rows. O(N M D) time and memory for all pairs:
    `match` needs less of both.

    Raises
    ------
    ShapeError
        If they are no such arrays, of different lengths or kinds, or do not broadcast.

    Examples
    --------
    >>> a = np.array([[0b1111_0000, 0b0000_0001], [0, 0]], np.uint8)
    >>> b = np.array([[0b1111_0000, 0], [0b1000_0000, 255], [0, 0]], np.uint8)
    >>> int(hamming_distance(a[0], b[0]))
    1
    >>> hamming_distance(a[:, None], b).tolist()
    [[1, 10, 5], [4, 9, 0]]
    """
    a, b = _bits(a, "a"), _bits(b, "b")
    if a.dtype != b.dtype or a.shape[-1] != b.shape[-1]:
        raise ShapeError(f"a, b: rows of {a.shape[-1]} {a.dtype} and {b.shape[-1]} {b.dtype}; need equal ones")
    try:
        differing = np.bitwise_xor(a, b)
    except ValueError:
        raise ShapeError(f"a, b: shapes {a.shape}, {b.shape}; need as many rows, or one") from None
    if differing.dtype == np.uint8:
        differing = _SET_BITS[differing]
    return np.asarray(differing.sum(axis=-1, dtype=np.int64))


def _bits(rows: Image, name: str) -> Image:
    rows = as_plain(rows, name)
    if rows.dtype not in (np.uint8, np.bool_) or not rows.ndim or not rows.shape[-1]:
        raise ShapeError(f"{name}: shape {rows.shape}, data type {rows.dtype}; need rows of uint8 or bool")
    return rows
