# SPDX-License-Identifier: Apache-2.0
"""A homography with h33 = 1 by linear least squares, weighted with a covariance of the noise (IU 6.5, 7.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Matrix3, as_matrix
from imgu_ros.vision.estimation.linear import least_squares, shape_of
from imgu_ros.vision.projective.dlt import design_matrix, normalisation
from imgu_ros.vision.projective.homography import normalised_homography

#: Most iterations of reweighting: bounds the time.
_ROUNDS = 10
#: Relative change below which iterations stop: that of rounding.
_SETTLED = 1e-12


def homography_inhomogeneous(src: ArrayLike, dst: ArrayLike, covariance: ArrayLike | None = None) -> Matrix3:
    """Return H with dst ~ H src from the eight unknowns that h33 = 1 leaves, by (weighted) linear least squares.

    Solves (A^T W A) h = A^T W b of IU 7.2, of normalised points, so that it is the picture of src's centroid that
    must not be at infinity. An equation's error is that of dst times its depth w; the weights follow w, in a few
    rounds, so that the answer is the weighted least-squares one of the distances in dst.

    Parameters
    ----------
    src, dst : (N, 2), N >= 4; src exact
    covariance : (N, 2, 2) of each point's errors in dst, or (2 N, 2 N) of all, ordered x1 y1 x2 y2 ...; None: the
        equations count alike, which is the plain least squares of the notes

    Returns
    -------
    (3, 3), unit Frobenius norm, positive determinant

    Raises
    ------
    TooFewPoints
        If there are fewer than four correspondences.
    DegenerateConfiguration
        If the points do not determine a homography, the centroid of src is mapped to infinity, or the covariance is
        not positive definite.
    ShapeError
        If the arrays do not fit each other, or hold numbers that are not finite or too large.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> H = homography_inhomogeneous(square, [[5, 5], [7, 5], [7, 7], [5, 7]])
    >>> ((H / H[2, 2]).round(9) + 0.0).tolist()
    [[2.0, 0.0, 5.0], [0.0, 2.0, 5.0], [0.0, 0.0, 1.0]]
    """
    T_src, T_dst = normalisation(src), normalisation(dst)
    src, dst = (np.asarray(p, np.float64) @ T[:2, :2].T + T[:2, 2] for p, T in ((src, T_src), (dst, T_dst)))
    if len(src) != len(dst) or len(src) < 4:
        raise TooFewPoints(f"src, dst: {len(src)} and {len(dst)} points; need at least 4 pairs")
    # The design's rows are w (v - y) and w (x - u); the covariance's order and signs are those of x and y.
    rows = (design_matrix(src, dst) * [[-1.0], [1.0]])[:, ::-1].reshape(-1, 9)
    A, b = rows[:, :8], -rows[:, 8]
    noise = None if covariance is None else _full(covariance, len(src)) * T_dst[0, 0] ** 2
    h = least_squares(A, b, None if noise is None else noise).x
    for _ in range(0 if noise is None else _ROUNDS):
        before = h
        depth = np.repeat(np.abs(src @ h[6:8] + 1), 2)
        if not depth.min() > 0:
            raise DegenerateConfiguration("src: a point is mapped to infinity; need points off the vanishing line")
        h = least_squares(A, b, noise * np.outer(depth, depth)).x
        if np.abs(h - before).max() <= _SETTLED * np.abs(h).max():
            break
    H = np.append(h, 1.0).reshape(3, 3)
    if not abs(np.linalg.det(H)) > 1e-9 * np.linalg.norm(H) ** 3:
        raise DegenerateConfiguration("src, dst: the homography is singular; need points that span the plane in both")
    return normalised_homography(np.linalg.solve(T_dst, H @ T_src))


def _full(covariance: ArrayLike, count: int) -> Floats:
    """Return the covariance of all coordinates, (2 N, 2 N)."""
    if len(shape_of(covariance, "covariance")) == 2:
        return as_matrix(covariance, (2 * count, 2 * count), "covariance")
    blocks = as_matrix(covariance, (count, 2, 2), "covariance")
    if not np.abs(blocks).max() < 1e90:
        raise ShapeError(f"covariance: up to {np.abs(blocks).max():g}; need less than 1e90")
    full = np.zeros((count, 2, count, 2))
    full[np.arange(count), :, np.arange(count), :] = blocks
    return full.reshape(2 * count, 2 * count)
