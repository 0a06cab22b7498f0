# SPDX-License-Identifier: Apache-2.0
"""Homographies by minimised geometric error, as problems for `minimise` (IU 7.3.1; HZ sections 4.2, 4.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Choice, Floats, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.estimation.nonlinear import Linearisation
from imgu_ros.vision.projective.homography import tangent_basis


class HomographyError(Choice):
    """What a fit minimises."""

    ALGEBRAIC = "algebraic"  #: the linear fit's own error
    TRANSFER = "transfer"  #: distance in the destination; right when the source points are exact
    SYMMETRIC = "symmetric"  #: distances in both images
    SAMPSON = "sampson"  #: first-order reprojection error; right when both sides are equally noisy
    REPROJECTION = "reprojection"  #: distances to the nearest pair of points that H joins: the gold standard


class _HomographyProblem:
    """What the problems share: corresponding points, (N, 2) each, and the step."""

    def __init__(self, src: Points, dst: Points) -> None:
        self._src = src
        self._dst = dst

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        """Return H moved along its tangent and brought back to unit norm."""
        return stepped(estimate, delta)


class TransferProblem(_HomographyProblem):
    """Residuals in the destination image: (N, 2), px."""

    def residuals(self, estimate: Floats) -> Floats:
        """Return mapped - measured, (N, 2)."""
        mapped = self._src @ estimate[:, :2].T + estimate[:, 2]
        return np.asarray(mapped[:, :2] / mapped[:, 2:] - self._dst)

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals (N, 2) and their derivative by the eight tangent steps, (N, 2, 8)."""
        by_h = derivative_by_h(estimate, self._src)
        return Linearisation(self.residuals(estimate), by_h @ tangent_basis(estimate))


class SymmetricProblem(_HomographyProblem):
    """Residuals in the destination and, by the inverse, in the source: (N, 4), px."""

    def residuals(self, estimate: Floats) -> Floats:
        """Return (H src - dst, H^-1 dst - src), (N, 4)."""
        forward = TransferProblem(self._src, self._dst).residuals(estimate)
        backward = TransferProblem(self._dst, self._src).residuals(_inverse(estimate))
        return np.hstack((forward, backward))

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals (N, 4) and their derivative by the eight tangent steps, (N, 4, 8)."""
        inverse = _inverse(estimate)
        basis = tangent_basis(estimate)
        forward = derivative_by_h(estimate, self._src) @ basis
        # d(H^-1) = -H^-1 dH H^-1, row-major.
        by_inverse = derivative_by_h(inverse, self._dst)
        backward = by_inverse @ (-np.kron(inverse, inverse.T)) @ basis
        return Linearisation(self.residuals(estimate), np.concatenate((forward, backward), axis=1))


class SampsonProblem(_HomographyProblem):
    """Whitened Sampson residuals, (N, 2), px: their squares sum to the Sampson error (HZ section 4.2.6)."""

    def residuals(self, estimate: Floats) -> Floats:
        """Return L^-1 (H src - dst), with L L^T = I + J J^T and J the derivative of H src by src."""
        mapped = self._src @ estimate[:, :2].T + estimate[:, 2]
        xy = mapped[:, :2] / mapped[:, 2:]
        return _whitened(estimate, xy, mapped[:, 2], (xy - self._dst)[:, :, None])[:, :, 0]

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals (N, 2) and their derivative (N, 2, 8).

        The whitening's own change with H is of second order in the residual and is left out, as in Gauss-Newton.
        """
        mapped = self._src @ estimate[:, :2].T + estimate[:, 2]
        xy = mapped[:, :2] / mapped[:, 2:]
        columns = np.empty((len(xy), 2, 9))
        columns[:, :, 0] = xy - self._dst
        columns[:, :, 1:] = derivative_by_h(estimate, self._src) @ tangent_basis(estimate)
        whitened = _whitened(estimate, xy, mapped[:, 2], columns)
        return Linearisation(whitened[:, :, 0], whitened[:, :, 1:])


def stepped(H: ArrayLike, delta: ArrayLike) -> Matrix3:
    """Return H moved by `delta` (8,) along `tangent_basis` and brought back to unit norm.

    Raises
    ------
    DegenerateConfiguration
        If H is zero, or the step beyond floats.

    Examples
    --------
    >>> bool(np.linalg.norm(stepped(np.eye(3), [0.1] * 8)).round(12) == 1)
    True
    """
    H, delta = as_matrix(H, (3, 3), "H"), as_matrix(delta, (8,), "delta")
    moved = _unit(H) + tangent_basis(H) @ (delta / max(1.0, float(np.abs(delta).max()) / 1e100))
    return np.asarray((moved / np.linalg.norm(moved)).reshape(3, 3), np.float64)


def derivative_by_h(H: ArrayLike, points: ArrayLike) -> Floats:
    """Return the derivative of the mapped points by the nine elements of H, row-major: (N, 2, 9).

    Raises
    ------
    DegenerateConfiguration
        If a point is mapped to infinity.

    Examples
    --------
    >>> derivative_by_h(np.eye(3), [[2, 3]])[0].tolist()[0]
    [2.0, 3.0, 1.0, 0.0, 0.0, 0.0, -4.0, -6.0, -2.0]
    """
    H, points = as_matrix(H, (3, 3), "H"), as_points(points)
    by_h = np.zeros((len(points), 2, 9))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        mapped = points @ H[:, :2].T + H[:, 2]
        xy = mapped[:, :2] / mapped[:, 2:]
        by_h[:, 0, 0:2] = points / mapped[:, 2:]
        by_h[:, 0, 2] = 1 / mapped[:, 2]
        by_h[:, 1, 3:6] = by_h[:, 0, 0:3]
        by_h[:, :, 6:9] = -xy[:, :, None] * by_h[:, 0, None, 0:3]
    if not np.isfinite(by_h).all():
        raise DegenerateConfiguration("points: one is mapped to infinity by H; need points off the vanishing line")
    return by_h


def _unit(H: Matrix3) -> Floats:
    largest = float(np.abs(H).max())
    if largest == 0:
        raise DegenerateConfiguration("H: all zero; need a homography")
    h = H.ravel() / largest
    return np.asarray(h / np.linalg.norm(h), np.float64)


def _whitened(H: Floats, xy: Points, w: Floats, columns: Floats) -> Floats:
    """Return L^-1 columns, (N, 2, C), with L the Cholesky factor of I + J J^T, by hand: it is 2 x 2."""
    J = (H[None, :2, :2] - xy[:, :, None] * H[2, :2]) / w[:, None, None]
    squares = np.einsum("nij,nij->ni", J, J)
    first = np.sqrt(1 + squares[:, 0])
    below = np.einsum("nj,nj->n", J[:, 0], J[:, 1]) / first
    area = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
    second = np.sqrt(1 + squares.sum(axis=1) + area**2) / first
    whitened = np.empty_like(columns)
    whitened[:, 0] = columns[:, 0] / first[:, None]
    whitened[:, 1] = (columns[:, 1] - below[:, None] * whitened[:, 0]) / second[:, None]
    return whitened


def _inverse(H: Floats) -> Floats:
    try:
        return np.asarray(np.linalg.inv(H), np.float64)
    except np.linalg.LinAlgError:
        raise DegenerateConfiguration("H: singular; need a homography") from None
