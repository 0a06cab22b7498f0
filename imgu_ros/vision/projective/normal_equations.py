# SPDX-License-Identifier: Apache-2.0
"""A homography by trimmed least squares, with all that its correspondences tell condensed to eight numbers and two
small matrices: further models of the same plane (a calibrated camera's pose) are fitted to those instead of to the
points (HZ section 5.2.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.arguments import shown_value
from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError
from imgu_ros.types import Floats, Mask, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.projective.fit import unscaled
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.increments import Motion, PlaneMotion, motion_sums
from imgu_ros.vision.projective.misfit import smooth_misfit
from imgu_ros.vision.projective.refine import tangent_basis
from imgu_ros.vision.projective.transform import local_jacobian, normalised_homography

#: Displacements within this many robust standard deviations are used. Measured: benchmarks/thresholds.py, study
#: covariance.
_OUTLIER_SIGMAS = 3.6
#: Displacements within this are used however small the standard deviation, px. Measured: benchmarks/thresholds.py,
#: study covariance.
_FLOOR_PX = 0.02
_RAYLEIGH_MEDIAN = 1.1774  # in sigmas of one coordinate
#: By chance, one frame in a thousand shows more of a misfit (chi-squared of 10 degrees of freedom).
_BY_CHANCE = 2.96
#: Squared errors of the estimate for each unit of misfit beyond that: errors of a rolling shutter that the homography
#: absorbs leave no residual. Measured: benchmarks/thresholds.py, study covariance.
_UNSEEN = 9.0
#: Condition of the normal equations beyond which the points do not determine a homography.
_WORST_CONDITION = 1e12
#: Limits the local scale of a homography, whose reciprocal must be finite.
_SMALLEST_AREA = 1e-12
#: Squares and products of three of such numbers are finite.
_LARGEST = 1e30
#: The derivatives of I + [[p0 p1 p2] [p3 p4 p5] [p6 p7 0]] by its parameters.
_BY_PARAMETER = np.eye(9)[:8].reshape(8, 3, 3)


@dataclass(frozen=True, slots=True, eq=False)
class HomographyNormalEquations:
    """A homography fitted by least squares, and the cost of any other one.

    In coordinates of moderate size, x' = T_dst x and X' = T_src X, a homography whose row-major elements are
    s (h + B delta), with h the fitted one's and B `basis`, has the sum of squared residuals
    `squares` + delta^T `normal` delta, to second order in delta.

    Attributes
    ----------
    estimate : the homography with its covariance; `inliers` are those that were not left out
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
    """Fit the homography that displacements of a plane's points tell, some of which may be wrong.

    Displacements within 3.6 robust standard deviations of a robust motion are good (least trimmed squares, Rousseeuw
    1984); their least-squares motion is the estimate, to first order in the displacements. Distances
    in dst are minimised. The covariance is that of `propagated_covariance`; it grows with what residuals of neighbours
    share and noise does not explain (`smooth_misfit`): a lens, a shutter or a bend that the model does not know.

    Parameters
    ----------
    motions : of the N points, projective
    displacements : (N, 2) px of the points: the point x is seen where `H_dst_points` maps x minus its displacement
    start : what `motions` made of them
    H_dst_points : (3, 3)
    points_from_src : (3, 3) px of the points from the px that the estimate is to map
    correlation : (N, N) of the errors of different displacements; None: independent
    min_points : fewest good displacements, >= 5
    usable : (N,) bool, those that may be good; None: those that agree with `start`

    Raises
    ------
    NoConsensus
        If fewer are good.
    DegenerateConfiguration
        If the good ones do not determine a homography, or a matrix is singular.
    ShapeError
        If the arrays do not fit each other, or hold numbers that are not finite or too large.

    Examples
    --------
    Points of a target's picture, half as large as the target itself, that are seen 1 px left of where they should be:

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
    by, unit = motions.by_parameters, motions.unit_px
    if displacements.shape != by.shape[:2] or start.agreeing.shape != by.shape[:1] or by.shape[2] != 8:
        raise ShapeError(f"displacements: shape {displacements.shape}; need {by.shape[:2]}, of a projective motion")
    if usable is not None and not isinstance(usable, np.ndarray):
        raise ShapeError(f"usable: {shown_value(usable)}; need {by.shape[:1]} bool")
    if usable is not None and (usable.shape != by.shape[:1] or usable.dtype != bool):
        raise ShapeError(f"usable: shape {usable.shape} {usable.dtype}; need {by.shape[:1]} bool")
    if min_points < 5:
        raise ShapeError(f"min_points: {min_points}; need at least 5")
    H_dst_points, points_from_src = _plain(H_dst_points, "H_dst_points"), _plain(points_from_src, "points_from_src")
    if displacements.size and not np.abs(displacements).max() < _LARGEST:
        raise ShapeError(f"displacements: up to {np.abs(displacements).max():g}; need places in a picture")
    T_dst = _unit_similarity(H_dst_points, motions)
    # Errors are alike in the picture, not in the plane: of a plane seen obliquely its far side is known less well.
    metric = float(T_dst[0, 0]) * unit * local_jacobian(H_dst_points, motions.points)
    by = metric @ by
    moved = (metric @ displacements[:, :, None])[:, :, 0] / unit
    away = moved - (by.reshape(-1, 8) @ start.parameters).reshape(-1, 2)
    away *= away
    squared = away[:, 0] + away[:, 1]
    used = squared[start.agreeing]
    if len(used) < min_points:
        raise NoConsensus(f"displacements: {len(used)} agree; need {min_points}")
    # The distance that half of them are within; np.median takes ten times as long.
    sigma = math.sqrt(float(np.partition(used, len(used) // 2)[len(used) // 2])) / _RAYLEIGH_MEDIAN
    # What the plane's far side says may lie far off in the plane, and near in dst.
    kept = start.agreeing if usable is None else usable
    kept = kept & (squared <= max(_OUTLIER_SIGMAS * sigma, _FLOOR_PX * float(T_dst[0, 0])) ** 2)
    count = int(np.count_nonzero(kept))
    if count < min_points:
        raise NoConsensus(f"displacements: {count} agree; need {min_points}")
    if count < len(kept):
        # What is left out becomes zero: cheaper than to pick the others out of all pairs.
        by, moved = by * kept[:, None, None], moved * kept[:, None]
    sums = motion_sums(by, correlation)
    rows, moved = by.reshape(-1, 8), moved.ravel()
    inverse = _inverse(sums.normal)
    motion = inverse @ (moved @ rows)
    left = moved - rows @ motion
    # Correlated errors are followed by the fit more closely: trace(P C) degrees of freedom instead of P.
    taken = float(np.vdot(inverse, sums.middle))
    squares = float(left @ left)
    variance = squares / max(2 * count - taken, 1.0)
    misfit = smooth_misfit(motions.points, left.reshape(-1, 2), kept, variance)
    if misfit > _BY_CHANCE and correlation is not None:
        # Errors that neighbours share are no misfit. To know how much they share takes the longest here.
        misfit = smooth_misfit(motions.points, left.reshape(-1, 2), kept, variance, correlation)
    noise = math.sqrt(variance * (1 + _UNSEEN * max(misfit - _BY_CHANCE, 0)))
    # The picture at H(x - d) shows x: H is followed by the inverse of the motion by d.
    H = H_dst_points @ motions.inverse(motion)
    T_src = motions.normalised @ points_from_src
    scaled = normalised_homography(T_dst @ H @ motions.back)
    basis = tangent_basis(scaled)
    # H after a motion of the points: scaled (I + M)^-1, to first order scaled - scaled M.
    by_motion = -((scaled @ _BY_PARAMETER).reshape(8, 9) @ basis).T
    by_tangent = _inverted(by_motion, "displacements")
    normal, middle = (by_tangent.T @ M @ by_tangent for M in (sums.normal, sums.middle))
    gain = by_motion @ inverse
    of_tangent = gain @ sums.middle @ gain.T
    estimated, by_scaled = unscaled(scaled, T_src, T_dst)
    spread_out = by_scaled @ basis
    covariance = noise**2 * spread_out @ of_tangent @ spread_out.T
    rms_px = math.sqrt(squares / (2 * count)) / float(T_dst[0, 0])
    estimate = HomographyEstimate(estimated, (covariance + covariance.T) / 2, kept, rms_px, 0)
    return HomographyNormalEquations(estimate, T_src, T_dst, scaled, basis, normal, middle, squares, noise)


def _plain(matrix: Matrix3, name: str) -> Matrix3:
    """Return a matrix, checked, of which products and squares are floats."""
    matrix = as_matrix(matrix, (3, 3), name)
    largest = float(np.abs(matrix).max())
    if not 1 / _LARGEST < largest < _LARGEST:
        raise DegenerateConfiguration(f"{name}: up to {largest:g}; need {1 / _LARGEST:g} to {_LARGEST:g}")
    return matrix


def _unit_similarity(H: Matrix3, motions: PlaneMotion) -> Matrix3:
    """Return the similarity of the picture that makes a unit of the points a unit, at their centre, and centres it."""
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


def _inverted(matrix: Floats, name: str) -> Floats:
    try:
        return np.asarray(np.linalg.inv(matrix), np.float64)
    except np.linalg.LinAlgError:
        raise DegenerateConfiguration(f"{name}: they squeeze the plane to a line; need a regular motion") from None


def _not_determined() -> DegenerateConfiguration:
    return DegenerateConfiguration("displacements: the good points lie on a line; need points that span the plane")
