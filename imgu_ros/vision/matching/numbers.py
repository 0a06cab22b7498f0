"""Euclidean and cosine distances between all rows of two sets of numbers, by one product of matrices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imgu_ros.types import Floats, Image, Indices
from imgu_ros.vision.matching.metrics import Metric

#: What one block of a table holds: some MB, whatever the sizes of the sets.
_BLOCK_ELEMENTS = 2**20


@dataclass(frozen=True, slots=True, eq=False)
class NumberRows:
    """Rows of numbers, ready to be compared with others again and again.

    Attributes
    ----------
    metric : neither auto nor hamming
    rows : (M, D) float32; of unit length for cosine
    halves : (M,) half the squared length of each
    """

    metric: Metric
    rows: NDArray[np.float32]
    halves: NDArray[np.float32]

    def tables(self, src: Image) -> Iterator[NDArray[Any]]:
        """Yield numbers that are larger the nearer two rows are, for all pairs; by blocks of successive rows.

        Parameters
        ----------
        src : (N, D) float32

        Yields
        ------
        (n, M) float32, the n sum up to N. O(N M D).
        """
        prepared = number_rows(src, self.metric)
        height = max(1, _BLOCK_ELEMENTS // len(self.rows))
        for start in range(0, len(src), height):
            some = slice(start, start + height)
            table = prepared.rows[some] @ self.rows.T
            if self.metric is not Metric.COSINE:
                # -|a - b|^2 / 2 = a b - |b|^2 / 2 - |a|^2 / 2; |a| is the same along a row, not for the mutual check.
                table -= self.halves
                table -= prepared.halves[some, None]
            yield table

    def distances(self, src: Image, index: Indices) -> Floats:
        """Return the distance of each row of `src`, (N, D) float32, to the one of its index, (N,), as float64."""
        a, b = number_rows(src, self.metric).rows, self.rows[index]
        squared = np.square(a.astype(np.float64) - b).sum(axis=1)
        if self.metric is Metric.COSINE:
            # |a - b|^2 / 2 = 1 - a b for unit rows. A row of zeros has no direction: its product with any other is 0.
            return np.asarray(np.where(a.any(axis=1) & b.any(axis=1), squared / 2, 1.0))
        return np.asarray(np.sqrt(squared))


def number_rows(rows: Image, metric: Metric) -> NumberRows:
    """Prepare (M, D) float32 rows for comparison."""
    if metric is Metric.COSINE:
        length = np.linalg.norm(rows, axis=1, keepdims=True)
        rows = np.asarray(rows / np.where(length > 0, length, 1), np.float32)
    return NumberRows(metric, rows, np.einsum("nd,nd->n", rows, rows) / 2)
