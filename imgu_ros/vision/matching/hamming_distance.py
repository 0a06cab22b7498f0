# SPDX-License-Identifier: Apache-2.0
"""The Hamming distance of binary descriptors (IU 5.4.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_plain

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
