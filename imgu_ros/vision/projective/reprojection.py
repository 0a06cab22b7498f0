# SPDX-License-Identifier: Apache-2.0
"""The reprojection error of a homography: the gold standard (IU 7.3.1; HZ section 4.2.4, algorithm 4.3).

Each correspondence is corrected to the nearest pair of points that H maps exactly onto each other; the error is how
far both had to move. H and all corrected points are estimated together. At any H each pair can be corrected on its
own, so the points are eliminated from the normal equations (the Schur complement of HZ appendix 6.3, as an orthogonal
projection): the cost of a step grows linearly with the number of points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Floats, Points
from imgu_ros.vision.estimation.nonlinear import Linearisation
from imgu_ros.vision.projective.checks import checked_pairs, finite
from imgu_ros.vision.projective.homography import tangent_basis
from imgu_ros.vision.projective.refine import TransferProblem, derivative_by_h

#: Most iterations of Newton's method, which converges quadratically.
_ROUNDS = 20
#: Relative step below which iterations stop: that of rounding.
_SETTLED = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedPoints:
    """Pairs of points that a homography maps exactly onto each other.

    Attributes
    ----------
    src, dst : (N, 2) each, dst = H src
    """

    src: Points
    dst: Points


def corrected_points(H: ArrayLike, src: ArrayLike, dst: ArrayLike) -> CorrectedPoints:
    """Return the pairs nearest to the measured ones, by the sum of squared distances in both images.

    Gauss-Newton for each pair at once, from the measured point in src.

    Parameters
    ----------
    H : (3, 3), dst ~ H src, regular
    src, dst : (N, 2)

    Raises
    ------
    DegenerateConfiguration
        If H is singular, or a point comes to lie on or beyond the horizon on the way.
    ShapeError
        If the arrays do not fit each other, or hold numbers that are not finite or too large.

    Examples
    --------
    >>> pair = corrected_points(np.eye(3), [[0, 0]], [[2, 4]])
    >>> pair.src.round(6).tolist(), pair.dst.round(6).tolist()
    ([[1.0, 2.0]], [[1.0, 2.0]])
    """
    pairs = checked_pairs(H, src, dst)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        corrected, mapped = _corrected(pairs.H, pairs.src, pairs.dst)
    return CorrectedPoints(finite(corrected, "src"), finite(mapped, "dst"))


class ReprojectionProblem(TransferProblem):
    """Residuals of corrected points in both images, (N, 4), px; their squares sum to the reprojection error."""

    def residuals(self, estimate: Floats) -> Floats:
        """Return (corrected src - src, corrected dst - dst), (N, 4)."""
        corrected, mapped = _corrected(estimate, self._src, self._dst)
        return np.hstack((corrected - self._src, mapped - self._dst))

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals (N, 4) and their derivative (N, 4, 8) with the points following H."""
        corrected, mapped = _corrected(estimate, self._src, self._dst)
        B = _by_point(estimate, corrected, mapped)
        A = np.zeros((len(corrected), 4, 8))
        A[:, 2:] = derivative_by_h(estimate, corrected) @ tangent_basis(estimate)
        # What a step of the point can undo costs nothing.
        A -= B @ _least_squares(B, A)
        return Linearisation(np.hstack((corrected - self._src, mapped - self._dst)), A)


def _corrected(H: Floats, src: Points, dst: Points) -> list[Points]:
    """Return the corrected points in src and what H maps them to."""
    side = np.sign(src @ H[2, :2] + H[2, 2])
    if not (side != 0).all():
        raise DegenerateConfiguration("src: a point lies on the horizon of H; need points off it")
    # A pair further from H than the horizon is cannot be corrected within one side.
    at = src.copy()
    for _ in range(_ROUNDS):
        mapped = _mapped(H, at)
        B = _by_point(H, at, mapped)
        residuals = np.hstack((at - src, mapped - dst))
        step = -_least_squares(B, residuals[:, :, None])[:, :, 0]
        at = at + step
        if not (side * (at @ H[2, :2] + H[2, 2]) > 0).all():
            raise DegenerateConfiguration("src: a corrected point lies beyond the horizon of H; need a nearer start")
        if not np.abs(step).max(initial=0) > _SETTLED * (1 + np.abs(at).max(initial=0)):
            break
    return [at, _mapped(H, at)]


def _mapped(H: Floats, points: Points) -> Points:
    mapped = points @ H[:, :2].T + H[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:], np.float64)


def _by_point(H: Floats, points: Points, mapped: Points) -> Floats:
    """Return the derivative of a pair by its point in src, (N, 4, 2): the identity, and H's local affine part."""
    B = np.zeros((len(points), 4, 2))
    B[:, 0, 0] = B[:, 1, 1] = 1
    w = points @ H[2, :2] + H[2, 2]
    B[:, 2:] = (H[None, :2, :2] - mapped[:, :, None] * H[2, :2]) / w[:, None, None]
    return B


def _least_squares(B: Floats, columns: Floats) -> Floats:
    """Return (B^T B)^-1 B^T columns, (N, 2, C), of B (N, 4, 2), by Cramer's rule."""
    normal = np.swapaxes(B, 1, 2) @ B
    right = np.swapaxes(B, 1, 2) @ columns
    a, b, d = (normal[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 1)))
    solution = np.stack((d * right[:, 0] - b * right[:, 1], a * right[:, 1] - b * right[:, 0]), axis=1)
    return np.asarray(solution / (a * d - b * b)[:, None], np.float64)
