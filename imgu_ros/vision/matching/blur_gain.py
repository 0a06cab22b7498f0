# SPDX-License-Identifier: Apache-2.0
"""How far measured displacements go when patches truly move: less than all the way where the picture is blurred.

Lucas-Kanade takes the picture for the patch moved; of a picture that is less sharp than the patch it sees too small a
displacement, along the blur most of all. After a known motion the displacements tell by how much.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Points, as_points

#: RMS motion, px, that weighs as much as the prior assumption that nothing is blurred. Measured:
#: benchmarks/thresholds.py, study blur.
_ASSUMED_PX = 0.1
#: RMS motions, px, from which a gain is learned: Lucas-Kanade is not linear for longer ones, and shorter ones are
#: noise. Measured: benchmarks/thresholds.py, study blur.
_LONGEST_PX, _SHORTEST_PX = 1.5, 0.03
#: Limits of the singular values of a gain. Measured: benchmarks/thresholds.py, study blur.
_WEAKEST, _STRONGEST = 0.2, 1.5
#: Larger numbers are no displacements in a picture.
_LARGEST_PX = 1e6


class BlurGain:
    """The linear map (2, 2) from true displacements to measured ones; the identity until motions tell better.

    Attributes
    ----------
    matrix : (2, 2)
    weakest : its smaller singular value: below 1 where the picture is blurred
    """

    def __init__(self) -> None:
        self.matrix: Floats = np.eye(2)
        self.weakest = 1.0
        self._inverse: Floats = np.eye(2)
        self._products = np.zeros((2, 2))
        self._squares = np.zeros((2, 2))
        self._count = 0

    def corrected(self, measured: ArrayLike) -> Points:
        """Return the true displacements (N, 2) of measured ones, (N, 2)."""
        measured = _plain(measured, "measured")
        return measured if self._count == 0 else np.asarray(measured @ self._inverse.T)

    def learn(self, applied: ArrayLike, change: ArrayLike) -> None:
        """Take in what a motion brought.

        Parameters
        ----------
        applied : (N, 2) px, by how far patches were moved
        change : (N, 2) px, by how much less their measured displacements then were

        Raises
        ------
        ShapeError
            If the arrays do not fit each other, or hold numbers that are no displacements in a picture.
        """
        applied, change = _plain(applied, "applied"), _plain(change, "change")
        if applied.shape != change.shape:
            raise ShapeError(f"change: shape {change.shape}; need {applied.shape}")
        count = len(applied)
        squares = applied.T @ applied
        total = float(squares[0, 0] + squares[1, 1])
        if not _SHORTEST_PX**2 * count < total <= 2 * _LONGEST_PX**2 * count:
            return
        self._products += change.T @ applied
        self._squares += squares
        self._count = max(self._count, count)
        assumed = self._count * _ASSUMED_PX**2
        (a, b), (c, d) = self._products.tolist()
        (p, q), (_, r) = self._squares.tolist()
        a, d, p, r = a + assumed, d + assumed, p + assumed, r + assumed
        det = p * r - q * q
        told = np.array([[a * r - b * q, b * p - a * q], [c * r - d * q, d * p - c * q]]) / det
        self.weakest, strongest = _singular_values(told)
        if self.weakest < _WEAKEST or strongest > _STRONGEST:
            U, strengths, Vt = np.linalg.svd(told)
            told = (U * np.clip(strengths, _WEAKEST, _STRONGEST)) @ Vt
            self.weakest = max(self.weakest, _WEAKEST)
        self.matrix = told
        (a, b), (c, d) = told.tolist()
        self._inverse = np.array([[d, -b], [-c, a]]) / (a * d - b * c)


def _singular_values(matrix: Floats) -> tuple[float, float]:
    """Return the smaller and the larger singular value of a (2, 2) matrix."""
    (a, b), (c, d) = matrix.tolist()
    half, product = (a * a + b * b + c * c + d * d) / 2, abs(a * d - b * c)
    larger = math.sqrt(half + math.sqrt(max(half * half - product * product, 0.0)))
    return (product / larger if larger > 0 else 0.0), larger


def _plain(displacements: ArrayLike, name: str) -> Points:
    displacements = as_points(displacements, name)
    if displacements.size and not np.abs(displacements).max() < _LARGEST_PX:
        raise ShapeError(f"{name}: up to {np.abs(displacements).max():g}; need less than {_LARGEST_PX:g} px")
    return displacements
