"""A homography by trimmed least squares, and all that its correspondences tell condensed to eight numbers and two
small matrices: further models of the same plane (a calibrated camera's pose) are fitted to those instead of to the
points (HZ section 5.2.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError
from imgu_ros.types import Floats, Mask, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.projective.estimate import unscaled
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.refine import tangent_basis
from imgu_ros.vision.projective.transform import normalised_homography

_OUTLIER_SIGMAS = 3.6
_RAYLEIGH_MEDIAN = 1.1774  # in sigmas of one coordinate
_FLOOR_PX = 0.02
#: Third homogeneous coordinate, of a homography of unit norm and points of unit size, below which a point is not ahead.
_NEAREST = 1e-6
_LEAST_UNIT = 1e-12
_WORST_CONDITION = 1e12


@dataclass(frozen=True, slots=True, eq=False)
class CondensedHomography:
    """A homography fitted by least squares, and the cost of any other one.

    In coordinates of moderate size, x' = T_dst x and X' = T_src X, a homography whose row-major elements are
    s (h + B delta), with h the fitted one's and B `tangent_basis`, has the sum of squared residuals
    `squares` + delta^T `normal` delta, to second order in delta.

    Attributes
    ----------
    estimate : the homography with its covariance; `inliers` are those that were not left out
    T_src, T_dst : (3, 3) similarities with a common unit of length
    scaled : (3, 3) T_dst H T_src^-1, unit norm
    normal : (8, 8) J^T J
    middle : (8, 8) J^T C J, C the correlation of the errors; `normal` where they are independent
    squares : sum of squared residuals, in units of T_dst's
    noise : standard deviation of one residual, in units of T_dst's
    """

    estimate: HomographyEstimate
    T_src: Matrix3
    T_dst: Matrix3
    scaled: Matrix3
    normal: Floats
    middle: Floats
    squares: float
    noise: float


def condensed_homography(
    src: ArrayLike,
    dst: ArrayLike,
    start: Matrix3,
    threshold_px: float,
    min_points: int = 5,
    correlation: Floats | None = None,
    metric: Floats | None = None,
) -> CondensedHomography:
    """Fit H with dst ~ H src to correspondences of which some may be wrong, from a homography that is nearly right.

    At first those within `threshold_px` of the start are good; then those within 3.6 robust standard deviations (from
    the median distance) of the least-squares fit to the good ones (least trimmed squares, Rousseeuw 1984). The
    transfer error is linearised once: from a start that is right to a pixel or two, the rest is below a thousandth of
    a pixel. Covariance as by `propagated_covariance`.

    Parameters
    ----------
    src, dst : (N, 2) px
    start : dst ~ start src
    threshold_px : largest distance in dst at first
    min_points : fewest good correspondences, >= 5
    correlation : (N, N) of the errors of different correspondences; None: independent
    metric : (N, 2, 2) what a residual in dst is multiplied by before it is measured; None: the identity

    Raises
    ------
    NoConsensus
        If fewer are good.
    DegenerateConfiguration
        If all points coincide, or the good ones do not determine a homography.
    ShapeError
        If the arrays do not fit each other.
    """
    src, dst = as_points(src, "src"), as_points(dst, "dst")
    count = len(src)
    if count != len(dst):
        raise ShapeError(f"dst: {len(dst)} points; need {count}, one for each of src")
    if not threshold_px > 0 or min_points < 5:
        raise ShapeError(f"threshold_px, min_points: {threshold_px!r}, {min_points!r}; need > 0, at least 5")
    if correlation is not None:
        correlation = as_matrix(correlation, (count, count), "correlation")
    start = as_matrix(start, (3, 3), "start")
    if count < min_points:
        raise NoConsensus(f"src, dst: {count} correspondences agree; need {min_points}")
    T_src, T_dst, T_src_inverse = _common_unit(src, dst)
    unit = float(T_dst[0, 0])
    scaled = normalised_homography(T_dst @ start @ T_src_inverse)
    at_start = _linearised(scaled, src @ T_src[:2, :2] + T_src[:2, 2], dst @ T_dst[:2, :2] + T_dst[:2, 2], min_points)
    residuals, jacobian, ahead = at_start.residuals, at_start.jacobian, at_start.ahead
    if metric is not None:
        metric = as_matrix(metric, (count, 2, 2), "metric")
        residuals, jacobian = (metric @ residuals[:, :, None])[:, :, 0], metric @ jacobian
    step, kept = _trimmed(residuals, jacobian, ahead, threshold_px * unit, _FLOOR_PX * unit, min_points)
    good = jacobian[kept]
    rows = good.reshape(-1, 8)
    left = residuals[kept].ravel() + rows @ step
    normal = rows.T @ rows
    middle = normal
    taken = 8.0
    inverse = _inverse(normal)
    if correlation is not None:
        among = correlation if kept.all() else correlation[np.ix_(kept, kept)]
        middle = good[:, 0].T @ (among @ good[:, 0]) + good[:, 1].T @ (among @ good[:, 1])
        # Correlated errors are followed by the fit more closely: trace(P C) degrees of freedom instead of P.
        taken = float(np.vdot(inverse, middle))
    squares = float(left @ left)
    noise = math.sqrt(squares / max(len(left) - taken, 1.0))
    # Brought back to unit norm after the step along its tangent.
    moved = scaled.ravel() + at_start.basis @ step
    scaled = (moved / math.sqrt(float(moved @ moved))).reshape(3, 3)
    H, by_scaled = unscaled(scaled, T_src, T_dst)
    spread_out = by_scaled @ tangent_basis(scaled)
    covariance = noise**2 * spread_out @ (inverse @ middle @ inverse) @ spread_out.T
    rms = math.sqrt(squares / len(left)) / unit
    estimate = HomographyEstimate(H, (covariance + covariance.T) / 2, kept, rms, 0)
    return CondensedHomography(estimate, T_src, T_dst, scaled, normal, middle, squares, noise)


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """Residuals (N, 2), derivative (N, 2, 8) by steps along `basis` (9, 8), and which points lie ahead, (N,)."""

    residuals: Floats
    jacobian: Floats
    basis: Floats
    ahead: Mask


def _linearised(H: Matrix3, src: Points, dst: Points, min_points: int) -> _Linearised:
    """The transfer error in one go, as `TransferProblem` has it."""
    at = src @ H[:, :2].T + H[:, 2]
    ahead = at[:, 2] > _NEAREST
    _require(ahead, min_points)
    w = np.maximum(at[:, 2:], _NEAREST)
    xy = at[:, :2] / w
    by_h = np.zeros((len(src), 2, 9))
    by_h[:, 0, :2] = by_h[:, 1, 3:5] = src / w
    by_h[:, 0, 2] = by_h[:, 1, 5] = 1 / w[:, 0]
    np.multiply(-xy[:, :, None], by_h[:, 0, None, :3], out=by_h[:, :, 6:])
    basis = tangent_basis(H)
    return _Linearised(xy - dst, by_h @ basis, basis, ahead)


def _common_unit(src: Points, dst: Points) -> tuple[Matrix3, Matrix3, Matrix3]:
    """Return the similarities that centre each side and divide it by one unit, and the first one's inverse."""
    centre_src, centre_dst = src.mean(axis=0), dst.mean(axis=0)
    spreads = [
        float(np.sqrt(((points - centre) ** 2).mean())) for points, centre in ((src, centre_src), (dst, centre_dst))
    ]
    if not (min(spreads) > 0 and _LEAST_UNIT < spreads[0] * spreads[1] < 1 / _LEAST_UNIT):
        raise DegenerateConfiguration("src, dst: all points of a side coincide, or they are no places in a picture")
    # One factor for both sides: distances keep their proportions.
    factor = 1 / math.sqrt(spreads[0] * spreads[1])
    T_src, T_dst, T_src_inverse = np.eye(3), np.eye(3), np.eye(3)
    T_src[0, 0] = T_src[1, 1] = T_dst[0, 0] = T_dst[1, 1] = factor
    T_src[:2, 2], T_dst[:2, 2] = -factor * centre_src, -factor * centre_dst
    T_src_inverse[0, 0] = T_src_inverse[1, 1] = 1 / factor
    T_src_inverse[:2, 2] = centre_src
    return T_src, T_dst, T_src_inverse


def _trimmed(
    residuals: Floats, jacobian: Floats, ahead: Mask, threshold: float, floor: float, min_points: int
) -> tuple[Floats, Mask]:
    """Return the step (8,) to the trimmed least-squares fit, and which correspondences it rests on."""
    distance = np.where(ahead, np.sqrt((residuals**2).sum(axis=1)), np.inf)
    kept = distance <= threshold
    step = np.zeros(8)
    for turn in (0, 1):
        _require(kept, min_points)
        rows = jacobian[kept].reshape(-1, 8)
        try:
            step = -np.linalg.solve(rows.T @ rows, rows.T @ residuals[kept].ravel())
        except np.linalg.LinAlgError:
            raise _not_determined() from None
        if turn == 0:
            distance = np.where(ahead, np.sqrt(((residuals + jacobian @ step) ** 2).sum(axis=1)), np.inf)
            good = distance[kept]
            # The distance that half of them are within; np.median takes ten times as long.
            sigma = float(np.partition(good, len(good) // 2)[len(good) // 2]) / _RAYLEIGH_MEDIAN
            kept = distance <= max(_OUTLIER_SIGMAS * sigma, floor)
    return step, kept


def _inverse(normal: Floats) -> Floats:
    scale = np.sqrt(np.diag(normal))
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise _not_determined()
    by_scale = np.outer(scale, scale)
    try:
        inverse = np.linalg.inv(normal / by_scale)
    except np.linalg.LinAlgError:
        raise _not_determined() from None
    # Of a matrix with unit diagonal, the inverse's diagonal is as large as its condition is bad.
    if not 0 < float(np.diag(inverse).max()) < _WORST_CONDITION:
        raise _not_determined()
    return np.asarray(inverse / by_scale, np.float64)


def _not_determined() -> DegenerateConfiguration:
    return DegenerateConfiguration("src: the good points lie on a line; need points that span the plane")


def _require(kept: Mask, min_points: int) -> None:
    if np.count_nonzero(kept) < min_points:
        raise NoConsensus(f"src, dst: {np.count_nonzero(kept)} correspondences agree; need {min_points}")
