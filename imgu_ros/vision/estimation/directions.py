# SPDX-License-Identifier: Apache-2.0
"""The rotation between two sets of directions, in space: least squares, or by consensus (Kabsch 1976; IU 7.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Indices, Mask, Matrix3, as_matrix, as_rows
from imgu_ros.vision.estimation.chance import pair_probability, shares_of_places

#: Squares of larger numbers, summed, overflow.
_LARGEST = 1e100
#: Least second singular value of the correlation, as a share of the first: below, all directions are parallel.
_PARALLEL = 1e-9
#: Radians between two directions, or between one and the other's opposite, that determine a rotation.
_NARROWEST = 1e-6


def align_directions(src: ArrayLike, dst: ArrayLike, weights: ArrayLike | None = None) -> Matrix3:
    """Return the rotation R with dst ~ R src that minimises the sum of squared chords between unit vectors.

    Kabsch's solution: the proper rotation nearest to the sum of the dyads dst src^T. Viewing rays of two images
    taken from one place are such directions.

    Parameters
    ----------
    src, dst : (N, 3), N >= 2, of any length but 0
    weights : (N,) >= 0; None: all 1. Directions of weight 0 change nothing, be they 0 themselves

    Returns
    -------
    (3, 3), det = 1

    Raises
    ------
    TooFewPoints
        If there are fewer than two.
    DegenerateConfiguration
        If a direction is 0, or they are all parallel.
    ShapeError
        If the arrays do not fit each other, a number is not finite or too large, or a weight negative.

    Examples
    --------
    >>> align_directions([[1, 0, 0], [0, 1, 0]], [[0, 2, 0], [-1, 0, 0]]).round(9).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    src, dst = as_rows(src, 3, "src"), as_rows(dst, 3, "dst")
    if len(src) != len(dst) or len(src) < 2:
        raise TooFewPoints(f"src, dst: {len(src)} and {len(dst)} directions; need at least 2 pairs")
    w = np.ones(len(src)) if weights is None else as_matrix(weights, (len(src),), "weights")
    if w.min() < 0 or not 0 < w.max() < _LARGEST:
        raise ShapeError("weights: negative, too large, or all 0; need numbers >= 0, some of them > 0")
    src, dst, w = src[w > 0], dst[w > 0], w[w > 0] / w.max()
    if len(src) < 2:
        raise TooFewPoints(f"weights: {len(src)} above 0; need at least 2")
    src, dst = _directions(src, "src") * w[:, None], _directions(dst, "dst")
    return np.asarray(_nearest(dst.T @ src), np.float64) + 0.0


class DirectionsModel:
    """The model of `ransac` for rotations: hypotheses are (B, 3, 3); the error is the angle in radians.

    Parameters
    ----------
    src, dst : (N, 3) directions, of any length but 0

    Raises
    ------
    TooFewPoints, DegenerateConfiguration, ShapeError
        As `align_directions`, save that parallel directions are found out later.
    """

    sample_size = 2
    codimension = 2

    def __init__(self, src: ArrayLike, dst: ArrayLike) -> None:
        self.src, self.dst = _directions(src, "src"), _directions(dst, "dst")
        if len(self.src) != len(self.dst) or len(self.src) < 2:
            raise TooFewPoints(f"src, dst: {len(self.src)} and {len(self.dst)} directions; need at least 2 pairs")

    @property
    def count(self) -> int:
        """Number of pairs of directions."""
        return len(self.src)

    def generate(self, samples: Indices) -> Floats:
        """Return the rotations (B', 3, 3) of samples (B, 2): the axes of each side's two directions, one on the other.

        Nearly parallel directions give none.
        """
        src, dst = _axes(self.src[samples]), _axes(self.dst[samples])
        good = np.isfinite(src).all(axis=(1, 2)) & np.isfinite(dst).all(axis=(1, 2))
        return np.asarray(dst[good] @ np.swapaxes(src[good], 1, 2), np.float64)

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared angles between R src and dst, (B, N), rad^2."""
        chord = np.linalg.norm(np.einsum("bij,nj->bni", hypotheses, self.src) - self.dst, axis=2)
        return np.asarray((2 * np.arcsin(np.minimum(chord / 2, 1.0))) ** 2, np.float64)

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return the rotation of all inliers."""
        del hypothesis
        return align_directions(self.src[inliers], self.dst[inliers])

    def shares(self, threshold: float) -> Floats:
        """Return what each pair counts, (N,): 1 / number of those within the threshold in dst."""
        return shares_of_places(self.dst, _chord(threshold))

    def agreement_probability(self, hypothesis: Floats, threshold: float) -> float:
        """Return the probability that a wrong pair agrees, told by wrong pairs of these directions."""
        return pair_probability(self.src @ hypothesis.T, self.dst, _chord(threshold))


def _chord(angle: float) -> float:
    return 2 * float(np.sin(min(angle, np.pi) / 2))


def _axes(pairs: Floats) -> Floats:
    """Return the orthonormal axes (B, 3, 3) about the mean of two unit vectors (B, 2, 3); NaN where undefined."""
    middle, apart = pairs[:, 0] + pairs[:, 1], pairs[:, 0] - pairs[:, 1]
    lengths = np.stack((np.linalg.norm(middle, axis=1), np.linalg.norm(apart, axis=1)))
    lengths[:, (lengths < _NARROWEST).any(axis=0)] = np.nan
    x, y = middle / lengths[0][:, None], apart / lengths[1][:, None]
    return np.stack((x, y, np.cross(x, y)), axis=2)


def _nearest(correlation: Floats) -> Floats:
    U, singular, V = np.linalg.svd(correlation)
    if not singular[1] > _PARALLEL * singular[0]:
        raise DegenerateConfiguration("src, dst: all directions are parallel; need two that differ")
    return np.asarray(U @ np.diag([1, 1, np.linalg.det(U) * np.linalg.det(V)]) @ V, np.float64)


def _directions(rows: ArrayLike, name: str) -> Floats:
    rows = as_rows(rows, 3, name)
    if rows.size and not np.abs(rows).max() < _LARGEST:
        raise ShapeError(f"{name}: up to {np.abs(rows).max():g}; need less than {_LARGEST:g}")
    length = np.linalg.norm(rows, axis=1)
    if rows.size and not length.min() > 1 / _LARGEST:
        raise DegenerateConfiguration(f"{name}: a direction has length 0; need vectors that point somewhere")
    return np.asarray(rows / length[:, None], np.float64)
