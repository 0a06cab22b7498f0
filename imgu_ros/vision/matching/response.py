"""How far measured displacements go when patches truly move: less than all the way where the picture is blurred.

Lucas-Kanade takes the picture for the patch moved; of a picture that is less sharp than the patch it sees too small a
displacement, along the blur most of all. After a known motion the displacements tell by how much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Points, as_points

#: Motions, px root mean square, that tell as much as the assumption that nothing is blurred.
_ASSUMED_PX = 0.1
#: Longer motions than this tell little: Lucas-Kanade is not linear so far away.
_LONGEST_PX = 1.5
#: Singular values of a response.
_WEAKEST, _STRONGEST = 0.2, 1.5
_LARGEST_PX = 1e6


class Response:
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
        return np.asarray(_plain(measured, "measured") @ self._inverse.T)

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
        if not len(applied) or float((applied**2).mean()) > _LONGEST_PX**2:
            return
        self._products += change.T @ applied
        self._squares += applied.T @ applied
        self._count = max(self._count, len(applied))
        assumed = self._count * _ASSUMED_PX**2 * np.eye(2)
        told = (self._products + assumed) @ np.linalg.inv(self._squares + assumed)
        U, strengths, Vt = np.linalg.svd(told)
        strengths = np.clip(strengths, _WEAKEST, _STRONGEST)
        self.matrix = (U * strengths) @ Vt
        self.weakest = float(strengths[-1])
        self._inverse = (Vt.T / strengths) @ U.T


def _plain(displacements: ArrayLike, name: str) -> Points:
    displacements = as_points(displacements, name)
    if displacements.size and not np.abs(displacements).max() < _LARGEST_PX:
        raise ShapeError(f"{name}: up to {np.abs(displacements).max():g}; need less than {_LARGEST_PX:g} px")
    return displacements
