"""Homographies by minimised geometric error, as problems for `minimise` (notes 7.3.1; HZ sections 4.2, 4.3)."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from imgu_ros.types import Floats, Matrix3, Points
from imgu_ros.vision.estimation.nonlinear import Linearisation


class HomographyError(StrEnum):
    """What a fit minimises."""

    ALGEBRAIC = "algebraic"  #: the linear fit's own error
    TRANSFER = "transfer"  #: distance in the destination; right when the source points are exact
    SYMMETRIC = "symmetric"  #: distances in both images
    SAMPSON = "sampson"  #: first-order reprojection error; right when both sides are equally noisy


def tangent_basis(H: Matrix3) -> Floats:
    """Return an orthonormal basis (9, 8) of the steps that leave the norm of H alone.

    It is the Householder reflection that takes H (row-major) to an axis, without that axis.
    """
    h = H.ravel() / np.linalg.norm(H)
    v = h.copy()
    v[0] += 1.0 if h[0] >= 0 else -1.0
    reflection = np.eye(9) - 2 * np.outer(v, v) / (v @ v)
    return np.asarray(reflection[:, 1:], np.float64)


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
        by_h = _derivative_by_h(estimate, self._src)
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
        forward = _derivative_by_h(estimate, self._src) @ basis
        # d(H^-1) = -H^-1 dH H^-1, row-major.
        by_inverse = _derivative_by_h(inverse, self._dst)
        backward = by_inverse @ (-np.kron(inverse, inverse.T)) @ basis
        return Linearisation(self.residuals(estimate), np.concatenate((forward, backward), axis=1))


class SampsonProblem(_HomographyProblem):
    """Whitened Sampson residuals, (N, 2), px: their squares sum to the Sampson error (HZ section 4.2.6)."""

    def residuals(self, estimate: Floats) -> Floats:
        """Return W (H src - dst), with W^-1 W^-T = I + J J^T and J the derivative of H src by src."""
        transfer, J, _ = self._parts(estimate)
        return _solved(_whitening_factor(J), transfer[:, :, None])[:, :, 0]

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals (N, 2) and their derivative (N, 2, 8).

        The whitening's own change with H is of second order in the residual and is left out, as in Gauss-Newton.
        """
        transfer, J, by_h = self._parts(estimate)
        factor = _whitening_factor(J)
        residuals = _solved(factor, transfer[:, :, None])[:, :, 0]
        return Linearisation(residuals, _solved(factor, by_h @ tangent_basis(estimate)))

    def _parts(self, estimate: Floats) -> tuple[Floats, Floats, Floats]:
        mapped = self._src @ estimate[:, :2].T + estimate[:, 2]
        xy = mapped[:, :2] / mapped[:, 2:]
        J = (estimate[None, :2, :2] - xy[:, :, None] * estimate[2, :2]) / mapped[:, 2][:, None, None]
        return xy - self._dst, J, _derivative_by_h(estimate, self._src)


def stepped(H: Floats, delta: Floats) -> Floats:
    """Return H moved by `delta` (8,) along `tangent_basis` and brought back to unit norm."""
    moved = H.ravel() / np.linalg.norm(H) + tangent_basis(H) @ delta
    return np.asarray((moved / np.linalg.norm(moved)).reshape(3, 3), np.float64)


def _derivative_by_h(H: Floats, points: Points) -> Floats:
    """Return the derivative of the mapped points by the nine elements of H, row-major: (N, 2, 9)."""
    homogeneous = np.column_stack((points, np.ones(len(points))))
    mapped = homogeneous @ H.T
    xy = mapped[:, :2] / mapped[:, 2:]
    by_h = np.zeros((len(points), 2, 9))
    scaled = homogeneous / mapped[:, 2:]
    by_h[:, 0, 0:3] = scaled
    by_h[:, 1, 3:6] = scaled
    by_h[:, :, 6:9] = -xy[:, :, None] * scaled[:, None, :]
    return by_h


def _whitening_factor(J: Floats) -> Floats:
    """Return the Cholesky factor of I + J J^T, (N, 2, 2)."""
    return np.asarray(np.linalg.cholesky(np.eye(2) + J @ np.swapaxes(J, 1, 2)), np.float64)


def _inverse(H: Floats) -> Floats:
    return np.asarray(np.linalg.inv(H), np.float64)


def _solved(A: Floats, B: Floats) -> Floats:
    return np.asarray(np.linalg.solve(A, B), np.float64)
