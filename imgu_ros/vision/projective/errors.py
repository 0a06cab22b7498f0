# SPDX-License-Identifier: Apache-2.0
"""How far corresponding points are from agreeing with a homography, by each measure (IU 7.3.1; HZ section 4.2).

All but the algebraic one are geometric: squared distances in pictures, unchanged when either picture is moved or
turned. Each function returns one number for each correspondence, which sum to the cost that a fit minimises.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.types import Floats
from imgu_ros.vision.projective.checks import Pairs, checked_pairs, finite
from imgu_ros.vision.projective.dlt import design_matrix
from imgu_ros.vision.projective.refine import SampsonProblem, SymmetricProblem, TransferProblem
from imgu_ros.vision.projective.reprojection import corrected_points


def algebraic_error(H: ArrayLike, src: ArrayLike, dst: ArrayLike) -> Floats:
    """Return the squared length of dst x H src, first two rows, for H of unit norm, (N,): what the DLT minimises.

    It depends on the origin and unit of the coordinates (HZ 4.4.2).

    Raises
    ------
    DegenerateConfiguration
        If H is singular.
    ShapeError
        If the arrays do not fit each other, or hold numbers that are not finite or too large.

    Examples
    --------
    >>> algebraic_error(np.eye(3), [[1, 2]], [[1, 5]]).round(6).tolist()  # 3^2 / |H|^2
    [3.0]
    """
    pairs = checked_pairs(H, src, dst)
    with np.errstate(over="ignore", invalid="ignore"):
        return finite(_squared(design_matrix(pairs.src, pairs.dst) @ pairs.H.ravel()), "errors")


def transfer_error(H: ArrayLike, src: ArrayLike, dst: ArrayLike) -> Floats:
    """Return the squared distances of H src from dst, (N,): right where src is exact (HZ 4.6).

    Raises
    ------
    DegenerateConfiguration
        If H is singular, or maps a point to infinity.
    ShapeError
        As `algebraic_error`.

    Examples
    --------
    >>> transfer_error(np.eye(3), [[1, 2]], [[4, 6]]).tolist()
    [25.0]
    """
    pairs = checked_pairs(H, src, dst)
    return _evaluated(TransferProblem(pairs.src, pairs.dst), pairs)


def symmetric_transfer_error(H: ArrayLike, src: ArrayLike, dst: ArrayLike) -> Floats:
    """Return the squared distances of H src from dst plus those of H^-1 dst from src, (N,) (HZ 4.7).

    Raises
    ------
    DegenerateConfiguration
        If H is singular, or maps a point to infinity, in either direction.
    ShapeError
        As `algebraic_error`.

    Examples
    --------
    >>> symmetric_transfer_error(np.diag([2, 2, 1]), [[1, 2]], [[2, 6]]).tolist()
    [5.0]
    """
    pairs = checked_pairs(H, src, dst)
    return _evaluated(SymmetricProblem(pairs.src, pairs.dst), pairs)


def reprojection_error(H: ArrayLike, src: ArrayLike, dst: ArrayLike) -> Floats:
    """Return the squared distances to the nearest pair that H maps onto each other, both images, (N,) (HZ 4.8).

    H, src and dst are those of `algebraic_error`.

    Raises
    ------
    DegenerateConfiguration
        If H is singular, or a point has no nearest pair on its side of the horizon.
    ShapeError
        As `algebraic_error`.

    Examples
    --------
    >>> reprojection_error(np.eye(3), [[0, 0]], [[2, 4]]).round(6).tolist()  # both move half way
    [10.0]
    """
    pairs = checked_pairs(H, src, dst)
    corrected = corrected_points(pairs.H, pairs.src, pairs.dst)
    return _squared(np.hstack((corrected.src - pairs.src, corrected.dst - pairs.dst)))


def sampson_error(H: ArrayLike, src: ArrayLike, dst: ArrayLike) -> Floats:
    """Return the reprojection errors to first order, (N,), without a search: Sampson's (HZ section 4.2.6).

    H, src and dst are those of `algebraic_error`.

    Raises
    ------
    DegenerateConfiguration
        If H is singular, or maps a point to infinity.
    ShapeError
        As `algebraic_error`.

    Examples
    --------
    >>> sampson_error(np.eye(3), [[0, 0]], [[2, 4]]).round(6).tolist()
    [10.0]
    """
    pairs = checked_pairs(H, src, dst)
    return _evaluated(SampsonProblem(pairs.src, pairs.dst), pairs)


def _evaluated(problem: TransferProblem | SymmetricProblem | SampsonProblem, pairs: Pairs) -> Floats:
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return finite(_squared(problem.residuals(pairs.H)), "errors")


def _squared(residuals: Floats) -> Floats:
    return np.asarray(np.einsum("nd,nd->n", residuals, residuals), np.float64)
