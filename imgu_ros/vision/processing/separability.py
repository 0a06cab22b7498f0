# SPDX-License-Identifier: Apache-2.0
"""Splitting a kernel into rows and columns (IU 2.2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats

#: Singular values below this share of the largest are rounding.
_TOLERANCE = 1e-7
_MOST_PX = 1023
_LARGEST = 1e30


@dataclass(frozen=True, slots=True, eq=False)
class SplitKernel:
    """A kernel as a sum of products: sum over r of columns[r][:, None] * rows[r].

    Attributes
    ----------
    columns : (R, h)
    rows : (R, w)
    """

    columns: Floats
    rows: Floats

    @property
    def rank(self) -> int:
        """Number of products; a separable kernel has one."""
        return len(self.rows)

    @property
    def multiplications(self) -> int:
        """Multiplications for each pixel, rank (h + w); the whole kernel takes h w."""
        return self.rank * int(self.columns.shape[1] + self.rows.shape[1])


def split(kernel: ArrayLike, tolerance: float = _TOLERANCE) -> SplitKernel:
    """Split any kernel into the fewest products of a column and a row, by its singular value decomposition.

    Parameters
    ----------
    kernel : (h, w), each up to 1023
    tolerance : singular values up to this share of the largest are left out, 0 to 1

    Returns
    -------
    A sum that equals the kernel to `tolerance` times its largest singular value for each one left out; of rank 0 for
    a kernel of zeros.

    Raises
    ------
    ShapeError
        If the kernel is not such a matrix of finite numbers up to 1e30, or the tolerance lies outside its range.

    Notes
    -----
    Source: IU 2.2.3; the best approximation of each rank by Eckart & Young 1936.

    Examples
    --------
    >>> parts = split([[1, 2, 1], [2, 4, 2], [1, 2, 1]])
    >>> parts.rank, parts.multiplications
    (1, 6)
    >>> (parts.columns.T @ parts.rows).round(6).tolist()
    [[1.0, 2.0, 1.0], [2.0, 4.0, 2.0], [1.0, 2.0, 1.0]]
    """
    tolerance = as_number(tolerance, "tolerance")
    weights = as_kernel(kernel)
    if not 0 <= tolerance <= 1:
        raise ShapeError(f"tolerance: {tolerance!r}; need 0 to 1")
    largest = float(np.abs(weights).max())
    if largest == 0:
        return SplitKernel(np.zeros((0, weights.shape[0])), np.zeros((0, weights.shape[1])))
    U, s, Vt = np.linalg.svd(weights / largest, full_matrices=False)
    # Exact zeros never count, whatever the tolerance.
    rank = int(np.count_nonzero(s > max(tolerance, 1e-15) * s[0]))
    root = np.sqrt(s[:rank])
    sign = np.where(U[np.argmax(np.abs(U[:, :rank]), axis=0), np.arange(rank)] < 0, -1.0, 1.0)
    return SplitKernel((U[:, :rank] * (root * sign)).T * largest, Vt[:rank] * (root * sign)[:, None])


def is_separable(kernel: ArrayLike, tolerance: float = _TOLERANCE) -> bool:
    """Whether a kernel is one column times one row: of rank 1 (or 0).

    Parameters
    ----------
    kernel, tolerance : as in `split`

    Examples
    --------
    >>> is_separable([[1, 1], [1, 1]]), is_separable([[0, 1, 0], [1, -4, 1], [0, 1, 0]])
    (True, False)
    """
    tolerance = as_number(tolerance, "tolerance")
    return split(kernel, tolerance).rank <= 1


def as_kernel(kernel: ArrayLike) -> Floats:
    """Return a kernel as a finite float64 matrix.

    Raises
    ------
    ShapeError
        If it is not a matrix of finite numbers up to 1e30, with 1 to 1023 rows and columns.
    """
    try:
        given = np.asarray(kernel)
        if given.dtype.kind not in "biufO":
            raise ShapeError(f"kernel: data type {given.dtype}; need real numbers")
        weights = given.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, ShapeError):
            raise
        raise ShapeError(f"kernel: {' '.join(str(error).split())}; need numbers") from None
    if weights.ndim != 2 or not all(1 <= n <= _MOST_PX for n in weights.shape):
        raise ShapeError(f"kernel: shape {weights.shape}; need (h, w), each 1 to {_MOST_PX}")
    if not np.all(np.abs(weights) <= _LARGEST):
        raise ShapeError(f"kernel: values not finite or beyond {_LARGEST:g}; need finite numbers up to it")
    return weights
