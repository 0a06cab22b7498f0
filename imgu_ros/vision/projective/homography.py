# SPDX-License-Identifier: Apache-2.0
"""A homography with its covariance, and its estimate from the displacements of a plane's points.

The estimate is by trimmed least squares. It keeps the normal equations of the correspondences, eight numbers and two
small matrices: further models of the same plane, such as the pose of a calibrated camera, are fitted to those instead
of to the points (HZ section 5.2.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import shown_value
from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError
from imgu_ros.types import Choice, Floats, Mask, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.projective.plane_motion import Motion, PlaneMotion

#: Displacements within this many robust standard deviations are inliers. Measured: benchmarks/thresholds.py, study
#: covariance.
_OUTLIER_SIGMAS = 3.6
#: Displacements within this are inliers however small the standard deviation, px. Measured: benchmarks/thresholds.py,
#: study covariance.
_FLOOR_PX = 0.02
_RAYLEIGH_MEDIAN = 1.1774  # in sigmas of one coordinate
#: Noise alone exceeds this misfit in one frame of a thousand (chi-squared of 10 degrees of freedom).
_BY_CHANCE = 2.96
#: Squared errors of the estimate for each unit of misfit beyond that: errors of a rolling shutter that the homography
#: absorbs leave no residual. Measured: benchmarks/thresholds.py, study covariance.
_UNSEEN = 9.0
#: Condition of the normal equations beyond which the points do not determine a homography.
_WORST_CONDITION = 1e12
#: Limits the local scale of a homography, whose reciprocal must be finite.
_SMALLEST_AREA = 1e-12
#: Squares and products of three such numbers are finite.
_LARGEST = 1e30
#: Squares and products of three such numbers are finite and normal floats.
_MODERATE = (1e-90, 1e90)
#: The derivatives of I + [[p0 p1 p2] [p3 p4 p5] [p6 p7 0]] by its parameters.
_BY_PARAMETER = np.eye(9)[:8].reshape(8, 3, 3)
#: Cells across and down: means over fewer miss a bend, over more they are lost in noise. Measured:
#: benchmarks/thresholds.py, study covariance.
_CELLS = 3
_CELL_NUMBERS = np.arange(_CELLS * _CELLS)[:, None]
#: Largest misfit that is reported.
_LARGEST_MISFIT = 1e12


class Orientation(Choice):
    """From which side a plane may be seen."""

    FRONT = "front"  #: turning the same way in both sets of points, as a picture and a photograph of it do
    MIRRORED = "mirrored"  #: turning the other way: y up in one and down in the other, or a plane seen from behind
    ANY = "any"  #: either: for an estimate of wrong and right matches, the one that more agree on


@dataclass(frozen=True, slots=True, eq=False)
class HomographyEstimate:
    """An estimated homography.

    Attributes
    ----------
    H : (3, 3), unit Frobenius norm, w > 0 at the points: det H > 0, or < 0 where the plane is seen mirrored
    covariance : (9, 9) of H's elements, row-major, rank 8 (nothing along H itself)
    inliers : (N,) which of the points it was estimated from agree with it
    rms_px : root mean square residual of the inliers in the destination image, px (per coordinate)
    iterations : samples drawn by the robust search
    """

    H: Matrix3
    covariance: Floats
    inliers: Mask
    rms_px: float
    iterations: int


@dataclass(frozen=True, slots=True, eq=False)
class HomographyNormalEquations:
    """A homography fitted by least squares, and the sum of squared residuals of every other one.

    In coordinates of moderate size, x' = T_dst x and X' = T_src X, a homography with the row-major elements
    s (h + B delta), with h those of the fitted one and B `basis`, has the sum of squared residuals
    `squares` + delta^T `normal` delta, to second order in delta.

    Attributes
    ----------
    estimate : the homography with its covariance and the inliers
    T_src, T_dst : (3, 3) similarities with a common unit of length
    scaled : (3, 3) T_dst H T_src^-1, unit norm
    basis : (9, 8) `tangent_basis` there
    normal : (8, 8) J^T J
    middle : (8, 8) J^T C J, C the correlation of the errors; `normal` where they are independent
    squares : sum of squared residuals, in units of T_dst's
    noise : standard deviation of one residual that explains the errors, in units of T_dst's
    """

    estimate: HomographyEstimate
    T_src: Matrix3
    T_dst: Matrix3
    scaled: Matrix3
    basis: Floats
    normal: Floats
    middle: Floats
    squares: float
    noise: float


def homography_normal_equations(
    motions: PlaneMotion,
    displacements: Points,
    start: Motion,
    H_dst_points: Matrix3,
    points_from_src: Matrix3,
    correlation: Floats | None = None,
    min_points: int = 5,
    usable: Mask | None = None,
) -> HomographyNormalEquations:
    """Fit a homography to the displacements of a plane's points, some of which may be outliers.

    Inliers are displacements within 3.6 robust standard deviations of a robust motion (least trimmed squares,
    Rousseeuw 1984); the estimate is their least-squares motion, to first order in the displacements, of distances in
    dst. The covariance is that of `propagated_covariance`, enlarged where neighbouring residuals are alike beyond what
    noise explains: by lens distortion, a rolling shutter or a plane that is not flat.

    Parameters
    ----------
    motions : of the N points, projective
    displacements : (N, 2) px of the points: the point x is seen where `H_dst_points` maps x minus its displacement
    start : motion that `motions` fitted to them
    H_dst_points : (3, 3)
    points_from_src : (3, 3) px of the points from the px that the estimate is to map
    correlation : (N, N) of the errors of different displacements; None: independent
    min_points : least number of inliers, >= 5
    usable : (N,) bool, possible inliers; None: the inliers of `start`

    Raises
    ------
    NoConsensus
        If there are fewer inliers.
    DegenerateConfiguration
        If the inliers do not determine a homography, or a matrix is singular.
    ShapeError
        If the arrays do not fit each other, or hold numbers that are not finite or too large.

    Examples
    --------
    Points of a template at half its size, seen 1 px left of where they are expected:

    >>> points = np.array([[10, 10], [90, 12], [88, 70], [9, 72], [50, 40], [30, 60]])
    >>> motions, displacements = PlaneMotion(points), np.tile([1.0, 0.0], (6, 1))
    >>> start = motions.fit(displacements, np.ones(6, bool))
    >>> found = homography_normal_equations(motions, displacements, start, np.eye(3), np.diag([0.5, 0.5, 1]))
    >>> H = found.estimate.H / found.estimate.H[2, 2]
    >>> (H.round(6) + 0.0).tolist()
    [[0.5, 0.0, -1.0], [0.0, 0.5, 0.0], [0.0, 0.0, 1.0]]
    """
    if not (isinstance(motions, PlaneMotion) and isinstance(start, Motion) and isinstance(min_points, int)):
        raise ShapeError(
            f"motions, start, min_points: {shown_value(motions)}, {shown_value(start)}, {shown_value(min_points)}; "
            "need a PlaneMotion, a Motion and an integer"
        )
    displacements = as_points(displacements, "displacements")
    by = motions.by_parameters
    if displacements.shape != by.shape[:2] or start.agreeing.shape != by.shape[:1] or by.shape[2] != 8:
        raise ShapeError(f"displacements: shape {displacements.shape}; need {by.shape[:2]}, of a projective motion")
    if usable is not None and (
        not isinstance(usable, np.ndarray) or usable.shape != by.shape[:1] or usable.dtype != bool
    ):
        raise ShapeError(f"usable: {getattr(usable, 'shape', shown_value(usable))}; need {by.shape[:1]} bool")
    if min_points < 5:
        raise ShapeError(f"min_points: {min_points}; need at least 5")
    H_dst_points = _moderate(H_dst_points, "H_dst_points")
    points_from_src = _moderate(points_from_src, "points_from_src")
    if displacements.size and not np.abs(displacements).max() < _LARGEST:
        raise ShapeError(f"displacements: up to {np.abs(displacements).max():g}; need places in an image")
    if correlation is not None:
        correlation = as_matrix(correlation, (len(by),) * 2, "correlation")
        if not np.abs(correlation).max() < _LARGEST:
            raise ShapeError(f"correlation: up to {np.abs(correlation).max():g}; need -1 to 1")
    return homography_normal_equations_unchecked(
        motions, displacements, start, H_dst_points, points_from_src, correlation, min_points, usable
    )


def homography_normal_equations_unchecked(
    motions: PlaneMotion,
    displacements: Points,
    start: Motion,
    H_dst_points: Matrix3,
    points_from_src: Matrix3,
    correlation: Floats | None,
    min_points: int,
    usable: Mask | None,
) -> HomographyNormalEquations:
    """`homography_normal_equations` without the checks of its arguments."""
    by, unit, points = motions.by_parameters, motions.unit_px, motions.points
    T_dst = _unit_similarity(H_dst_points, motions)
    # Errors have the same size in dst, not in the plane: the far side of an oblique plane is known less well.
    mapped = points @ H_dst_points[:, :2].T + H_dst_points[:, 2]
    w = mapped[:, 2:]
    jacobian = (H_dst_points[:2, :2] - (mapped[:, :2] / w)[:, :, None] * H_dst_points[2, :2]) / w[:, :, None]
    if not math.isfinite(np.vdot(jacobian, jacobian)):
        raise DegenerateConfiguration("points: one is mapped to infinity by H; need points off the vanishing line")
    metric = float(T_dst[0, 0]) * unit * jacobian
    by = metric @ by
    moved = (metric @ displacements[:, :, None])[:, :, 0] / unit
    away = moved - (by.reshape(-1, 8) @ start.parameters).reshape(-1, 2)
    away *= away
    squared = away[:, 0] + away[:, 1]
    used = squared[start.agreeing]
    if len(used) < min_points:
        raise NoConsensus(f"displacements: {len(used)} agree; need {min_points}")
    # The median distance; np.median takes ten times as long.
    sigma = math.sqrt(float(np.partition(used, len(used) // 2)[len(used) // 2])) / _RAYLEIGH_MEDIAN
    # Errors of the plane's far side are large in the plane and small in dst.
    kept = start.agreeing if usable is None else usable
    kept = kept & (squared <= max(_OUTLIER_SIGMAS * sigma, _FLOOR_PX * float(T_dst[0, 0])) ** 2)
    count = int(np.count_nonzero(kept))
    if count < min_points:
        raise NoConsensus(f"displacements: {count} agree; need {min_points}")
    if count < len(kept):
        # Zeros for outliers: cheaper than to select the others' rows and columns of the correlation.
        by, moved = by * kept[:, None, None], moved * kept[:, None]
    rows, moved = by.reshape(-1, 8), moved.ravel()
    normal = middle = rows.T @ rows
    if correlation is not None:
        # Both coordinates of a point side by side: one product for the two of them.
        middle = rows.T @ (correlation @ by.reshape(len(by), -1)).reshape(rows.shape)
    inverse = _inverse(normal)
    motion = inverse @ (moved @ rows)
    left = moved - rows @ motion
    # The fit follows correlated errors more closely: it takes trace(P C) degrees of freedom instead of P.
    taken = float(np.vdot(inverse, middle))
    squares = float(left @ left)
    variance = squares / max(2 * count - taken, 1.0)
    left = left.reshape(-1, 2)
    misfit = smooth_misfit_unchecked(points, left, kept, variance)
    if misfit > _BY_CHANCE and correlation is not None:
        # Errors that neighbours share are no misfit. Computed only here: it takes longer than the rest.
        misfit = smooth_misfit_unchecked(points, left, kept, variance, correlation)
    noise = math.sqrt(variance * (1 + _UNSEEN * max(misfit - _BY_CHANCE, 0)))
    # dst at H(x - d) shows x: H is followed by the inverse of the motion by d.
    H = H_dst_points @ motions.inverse_unchecked(motion)
    T_src = motions.normalised @ points_from_src
    scaled = normalised_unchecked(T_dst @ H @ motions.back)
    basis = tangent_basis_unchecked(scaled)
    # H after a motion of the points: scaled (I + M)^-1, to first order scaled - scaled M.
    by_motion = -((scaled @ _BY_PARAMETER).reshape(8, 9) @ basis).T
    try:
        by_tangent = np.linalg.inv(by_motion)
    except np.linalg.LinAlgError:
        raise DegenerateConfiguration(
            "displacements: they map the plane to a line; need displacements of a regular motion"
        ) from None
    gain = by_motion @ inverse
    H, by_scaled = unscaled_unchecked(scaled, T_src, T_dst)
    spread_out = by_scaled @ basis
    covariance = noise**2 * spread_out @ (gain @ middle @ gain.T) @ spread_out.T
    rms_px = math.sqrt(squares / (2 * count)) / float(T_dst[0, 0])
    estimate = HomographyEstimate(H, (covariance + covariance.T) / 2, kept, rms_px, 0)
    return HomographyNormalEquations(
        estimate,
        T_src,
        T_dst,
        scaled,
        basis,
        by_tangent.T @ normal @ by_tangent,
        by_tangent.T @ middle @ by_tangent,
        squares,
        noise,
    )


def _moderate(matrix: Matrix3, name: str) -> Matrix3:
    """Return a checked (3, 3) matrix whose products and squares are finite."""
    matrix = as_matrix(matrix, (3, 3), name)
    largest = float(np.abs(matrix).max())
    if not 1 / _LARGEST < largest < _LARGEST:
        raise DegenerateConfiguration(f"{name}: up to {largest:g}; need {1 / _LARGEST:g} to {_LARGEST:g}")
    return matrix


def _unit_similarity(H: Matrix3, motions: PlaneMotion) -> Matrix3:
    """Return the similarity of dst that is centred at the points' centre, in units of the points there."""
    x, y, w = H @ motions.back[:, 2]
    if not abs(w) > 0:
        raise DegenerateConfiguration(
            "H_dst_points: it maps the points to infinity; need points off the vanishing line"
        )
    # The determinant of the local Jacobian.
    enlarged = abs(cv2.determinant(H) / w**3)
    factor = 1 / (motions.unit_px * math.sqrt(min(max(enlarged, _SMALLEST_AREA), 1 / _SMALLEST_AREA)))
    x, y = x / w, y / w
    return np.array([[factor, 0, -factor * x], [0, factor, -factor * y], [0, 0, 1]])


def _inverse(normal: Floats) -> Floats:
    scale = np.sqrt(normal.diagonal())
    if not (scale.min() > 0 and math.isfinite(float(scale.max()))):
        raise _not_determined()
    by_scale = scale[:, None] * scale
    # Of a few rows, OpenCV is three times as fast as numpy.
    regular, inverse = cv2.invert(normal / by_scale, flags=cv2.DECOMP_CHOLESKY)
    # Of a matrix with unit diagonal, the inverse's diagonal is as large as its condition is bad.
    if not regular or not 0 < float(inverse.diagonal().max()) < _WORST_CONDITION:
        raise _not_determined()
    return np.asarray(inverse / by_scale, np.float64)


def _not_determined() -> DegenerateConfiguration:
    return DegenerateConfiguration("displacements: the good points lie on a line; need points that span the plane")


def smooth_misfit_unchecked(
    points: Points, residuals: Points, used: Mask, variance: float, correlation: Floats | None = None, fitted: int = 8
) -> float:
    """Return the ratio of the residuals' squared means over 3 x 3 cells of the plane to those of noise, 1 on average.

    A distorting lens, a rolling shutter or a plane that is not flat leave residuals that neighbours share.

    Parameters
    ----------
    points, residuals : (N, 2) in the plane
    used : (N,) bool, points that the model was fitted to
    variance : of one coordinate of a residual
    correlation : (N, N) of the errors of different points; None: independent
    fitted : parameters of the model

    Returns
    -------
    The sum of the squared means, each in units of its variance, over its degrees of freedom; 1 where too few cells
    have points, or without residuals.
    """
    if not variance > 0 or not used.any():
        return 1.0
    # Cells of the bounding box of all points, also of unused ones.
    low = points.min(axis=0)
    third = np.maximum((points.max(axis=0) - low) / _CELLS, 1e-300)
    column, row = np.minimum((points - low) / third, _CELLS - 0.5).astype(np.intp).T
    cells = np.where(used, column + _CELLS * row, -1)
    members = (cells == _CELL_NUMBERS).astype(np.float64)
    shared = members.sum(axis=1)
    if not shared.all():
        members, shared = members[shared > 0], shared[shared > 0]
    freedom = 2 * len(members) - fitted
    if freedom <= 0:
        return 1.0
    sums = members @ residuals
    if correlation is not None:
        shared = np.einsum("gi,gi->g", members @ correlation, members)
        # Errors that cancel (a negative correlation) say nothing about a misfit that neighbours share.
        shared = np.maximum(shared, 1e-300)
    scaled = sums / np.sqrt(shared * variance)[:, None]
    squared = float(np.vdot(scaled, scaled)) / freedom
    return min(squared, _LARGEST_MISFIT) if math.isfinite(squared) else _LARGEST_MISFIT


def normalised_homography(H: ArrayLike) -> Matrix3:
    """Scale a homography to unit Frobenius norm and positive determinant.

    A homography of odd size keeps its orientation under a change of sign only if the determinant changes too:
    det H > 0 is reached for every regular H. Whether the sign also makes w positive for the points at hand is the
    caller's to check (`faces_camera`).

    Raises
    ------
    DegenerateConfiguration
        If H is zero.

    Examples
    --------
    >>> normalised_homography([[-2, -1, -1], [-1, -2, -1], [-1, -1, -1]]).round(3).tolist()
    [[0.516, 0.258, 0.258], [0.258, 0.516, 0.258], [0.258, 0.258, 0.258]]
    """
    return normalised_unchecked(as_matrix(H, (3, 3), "H"))


def normalised_unchecked(H: Matrix3) -> Matrix3:
    """`normalised_homography` without the checks of its argument's type and shape."""
    largest = float(np.abs(H).max())
    if not 0 < largest < math.inf:
        raise DegenerateConfiguration("H: all zero, or not finite; need a homography")
    if not _MODERATE[0] < largest < _MODERATE[1]:
        H = H / largest
    return H * ((1 if cv2.determinant(H) >= 0 else -1) / math.sqrt(float(np.vdot(H, H))))


def tangent_basis(H: ArrayLike) -> Floats:
    """Return an orthonormal basis (9, 8) of the steps that leave the norm of H alone.

    It is the Householder reflection that takes H (row-major) to an axis, without that axis.

    Raises
    ------
    DegenerateConfiguration
        If H is zero.
    """
    return tangent_basis_unchecked(as_matrix(H, (3, 3), "H"))


def tangent_basis_unchecked(H: Matrix3) -> Floats:
    """`tangent_basis` without the checks of its argument's type, shape and finiteness."""
    largest = float(np.abs(H).max())
    if largest == 0:
        raise DegenerateConfiguration("H: all zero; need a homography")
    v = H.ravel() / largest
    v = v / np.linalg.norm(v)
    v[0] += 1.0 if v[0] >= 0 else -1.0
    basis = v[:, None] * (v[1:] * (-2 / float(v @ v)))
    basis.ravel()[8::9] += 1
    return np.asarray(basis, np.float64)


def unscaled_unchecked(scaled: Matrix3, T_src: Matrix3, T_dst: Matrix3) -> tuple[Matrix3, Floats]:
    """Return the unit-norm H ~ T_dst^-1 scaled T_src, (3, 3), and its derivative (9, 9) by `scaled`, row-major.

    Parameters
    ----------
    scaled : (3, 3) homography of coordinates of moderate size
    T_src, T_dst : (3, 3) similarities that make them

    Raises
    ------
    DegenerateConfiguration
        If T_dst is singular, H zero, or the derivative beyond floats.
    """
    regular, T_inverse = cv2.invert(T_dst)
    if not regular or not math.isfinite(np.vdot(T_inverse, T_inverse)):
        raise DegenerateConfiguration("T_dst: singular or nearly so; need a regular matrix")
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        raw = T_inverse @ scaled @ T_src
        H = normalised_unchecked(raw)
        norm = math.copysign(float(np.linalg.norm(raw)), float(np.vdot(raw, H)))
        h = H.ravel()
        # The Kronecker product of T_dst^-1 and T_src^T; np.kron takes several times as long.
        by_scaled = (T_inverse[:, None, :, None] * T_src.T[None, :, None, :]).reshape(9, 9) / norm
        # The component along H does not change H.
        by_scaled -= h[:, None] * (h @ by_scaled)
    if not (math.isfinite(norm) and np.isfinite(by_scaled).all()):
        raise DegenerateConfiguration("scaled, T_src, T_dst: numbers too large or small; need those of an image")
    return H, by_scaled
