# SPDX-License-Identifier: Apache-2.0
"""Distances between all rows of two sets of numbers, by one product of matrices (IU 5.1, 5.3.1, 5.3.3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Indices
from imgu_ros.vision.matching.metrics import (
    Metric,
    checked_rows,
    comparable_rows,
    metric_of_rows,
    require_index,
)

#: What one block of a table holds: some MB, whatever the sizes of the sets.
_BLOCK_ELEMENTS = 2**20
#: Metrics by the angle between two rows, and those of rows less their means.
_ANGULAR = (Metric.COSINE, Metric.NCC)
_ZERO_MEAN = (Metric.ZMSSD, Metric.NCC)


@dataclass(frozen=True, slots=True, eq=False)
class NumberRows:
    """Rows of numbers, ready to be compared with others again and again.

    Attributes
    ----------
    metric : neither auto nor hamming
    rows : (M, D), as the metric compares them: without their means, of unit length; float32 where products of them
        are exact, else float64
    origin : (D,) what was subtracted from every row, for larger rows to lose no digits
    """

    metric: Metric
    rows: NDArray[Any]
    origin: Floats

    def tables(self, src: Image) -> Iterator[NDArray[Any]]:
        """Yield numbers that are larger the nearer two rows are, for all pairs; by blocks of successive rows.

        Parameters
        ----------
        src : (N, D) float32

        Yields
        ------
        (n, M) float32 or float64, the n sum up to N. O(N M D).
        """
        src = comparable_rows(src, self.rows.shape[1], np.float32)
        a, b = _compared(src, self.metric, self.origin), self.rows
        if a.dtype != b.dtype:
            a, b = a.astype(np.float64), b.astype(np.float64)
        halves = [np.einsum("nd,nd->n", rows, rows) / 2 for rows in (a, b)]
        height = max(1, _BLOCK_ELEMENTS // max(1, len(b)))
        for start in range(0, len(a), height):
            some = slice(start, start + height)
            table = a[some] @ b.T
            if self.metric not in _ANGULAR:
                # -|a - b|^2 / 2 = a b - |b|^2 / 2 - |a|^2 / 2; |a| is the same along a row, not for the mutual check.
                table -= halves[1]
                table -= halves[0][some, None]
            yield table

    def distances(self, src: Image, index: Indices) -> Floats:
        """Return the distance of each row of `src`, (N, D) float32, to the one of its index, (N,), as float64."""
        src = comparable_rows(src, self.rows.shape[1], np.float32)
        require_index(index, len(src), len(self.rows))
        a, b = _compared(src, self.metric, self.origin), self.rows[index]
        squared = np.square(a.astype(np.float64) - b).sum(axis=1)
        if self.metric in _ANGULAR:
            # |a - b|^2 / 2 = 1 - a b for unit rows. A row of zeros has no direction: its product with any other is 0.
            return np.asarray(np.where(a.any(axis=1) & b.any(axis=1), squared / 2, 1.0))
        return np.asarray(np.sqrt(squared) if self.metric is Metric.EUCLIDEAN else squared)


def number_rows(rows: Image, metric: Metric | str) -> NumberRows:
    """Prepare (M, D) float32 rows for comparison by a metric of numbers.

    Raises
    ------
    ShapeError
        If the rows or the metric are not of that kind.
    """
    rows = checked_rows(rows, "rows")
    metric = metric_of_rows(rows, metric)
    if metric is Metric.HAMMING:
        raise ShapeError(f"rows: data type {rows.dtype}; need float32")
    origin = np.zeros(rows.shape[1])
    if len(rows) and metric in (Metric.EUCLIDEAN, Metric.SSD) and not _are_exact(rows):
        origin = rows.mean(axis=0, dtype=np.float64)
    return NumberRows(metric, _compared(rows, metric, origin), origin)


def _compared(rows: Image, metric: Metric, origin: Floats) -> NDArray[Any]:
    if metric in (Metric.EUCLIDEAN, Metric.SSD):
        if not origin.any() and _are_exact(rows):
            return rows
        return np.asarray(rows - origin)
    numbers = rows.astype(np.float64)
    if metric in _ZERO_MEAN:
        # A mean of equal numbers may differ from them in the last digit; differences to one of them are exactly 0.
        numbers -= numbers[:, :1].copy()
        numbers -= numbers.mean(axis=1, keepdims=True)
    if metric in _ANGULAR:
        length = np.linalg.norm(numbers, axis=1, keepdims=True)
        numbers /= np.where(length > 0, length, 1)
    return numbers


def _are_exact(rows: Image) -> bool:
    """Whether the rows are whole numbers so small that sums of their products are exact in float32, as SIFT's are."""
    if not rows.size:
        return True
    largest = float(max(rows.max(), -rows.min()))
    # |a|^2 / 2 may end in a half: 2^23 of them, not 2^24.
    return largest**2 * rows.shape[1] < 2**23 and bool((rows == np.rint(rows)).all())
