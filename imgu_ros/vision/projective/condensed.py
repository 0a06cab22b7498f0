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
from imgu_ros.types import Floats, Mask, Matrix3, as_matrix, as_points
from imgu_ros.vision.projective.estimate import common_unit, unscaled
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.refine import TransferProblem, stepped, tangent_basis
from imgu_ros.vision.projective.transform import normalised_homography

_ROUNDS = 2
_OUTLIER_SIGMAS = 3.6
_RAYLEIGH_MEDIAN = 1.1774  # in sigmas of one coordinate
_FLOOR_PX = 0.02


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

    At first those within `threshold_px` of the start are good; then, twice, those within 3.6 robust standard
    deviations (from the median distance) of the least-squares fit to the good ones (least trimmed squares, Rousseeuw
    1984). The transfer error is linearised once: from a start that is right to a pixel or two, the rest is below a
    thousandth of a pixel. Covariance as by `propagated_covariance`.

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
    H = normalised_homography(as_matrix(start, (3, 3), "start"))
    if count < min_points:
        raise NoConsensus(f"src, dst: {count} correspondences agree; need {min_points}")
    T_src, T_dst = common_unit(src, dst)
    unit = float(T_dst[0, 0])
    scaled = normalised_homography(T_dst @ H @ np.linalg.inv(T_src))
    src, dst = (points @ T[:2, :2].T + T[:2, 2] for points, T in ((src, T_src), (dst, T_dst)))
    ahead = src @ scaled[2, :2] + scaled[2, 2] > 1e-6
    _require(ahead, min_points)
    safe = src if ahead.all() else np.where(ahead[:, None], src, src[np.argmax(ahead)])
    at_start = TransferProblem(safe, dst).linearise(scaled)
    residuals, jacobian = at_start.residuals, at_start.jacobian
    if metric is not None:
        metric = as_matrix(metric, (count, 2, 2), "metric")
        residuals, jacobian = (metric @ residuals[:, :, None])[:, :, 0], metric @ jacobian
    step, kept = _trimmed(residuals, jacobian, ahead, threshold_px * unit, _FLOOR_PX * unit, min_points)
    rows = jacobian[kept].reshape(-1, 8)
    left = residuals[kept].ravel() + rows @ step
    normal = rows.T @ rows
    middle = normal
    taken = 8.0
    inverse = _inverse(normal)
    if correlation is not None:
        middle = _with_correlation(jacobian[kept], correlation[np.ix_(kept, kept)])
        # Correlated errors are followed by the fit more closely: trace(P C) degrees of freedom instead of P.
        taken = float(np.trace(inverse @ middle))
    squares = float(left @ left)
    noise = math.sqrt(squares / max(len(left) - taken, 1.0))
    scaled = normalised_homography(stepped(scaled, step))
    H, by_scaled = unscaled(scaled, T_src, T_dst)
    spread_out = by_scaled @ tangent_basis(scaled)
    covariance = noise**2 * spread_out @ (inverse @ middle @ inverse) @ spread_out.T
    rms = math.sqrt(squares / len(left)) / unit
    estimate = HomographyEstimate(H, (covariance + covariance.T) / 2, kept, rms, 0)
    return CondensedHomography(estimate, T_src, T_dst, scaled, normal, middle, squares, noise)


def _trimmed(
    residuals: Floats, jacobian: Floats, ahead: Mask, threshold: float, floor: float, min_points: int
) -> tuple[Floats, Mask]:
    """Return the step (8,) to the trimmed least-squares fit, and which correspondences it rests on."""
    distance = np.where(ahead, np.sqrt((residuals**2).sum(axis=1)), np.inf)
    kept = distance <= threshold
    step = np.zeros(8)
    for turn in range(_ROUNDS + 1):
        _require(kept, min_points)
        rows = jacobian[kept].reshape(-1, 8)
        try:
            step = -np.linalg.solve(rows.T @ rows, rows.T @ residuals[kept].ravel())
        except np.linalg.LinAlgError:
            raise _not_determined() from None
        if turn < _ROUNDS:
            distance = np.where(ahead, np.sqrt(((residuals + jacobian @ step) ** 2).sum(axis=1)), np.inf)
            good = distance[kept]
            # The distance that half of them are within; np.median takes ten times as long.
            sigma = float(np.partition(good, len(good) // 2)[len(good) // 2]) / _RAYLEIGH_MEDIAN
            kept = distance <= max(_OUTLIER_SIGMAS * sigma, floor)
    return step, kept


def _with_correlation(jacobian: Floats, correlation: Floats) -> Floats:
    """Return J^T (C x I_2) J for J of (N, 2, 8)."""
    total = np.zeros((8, 8))
    for axis in (0, 1):
        rows = jacobian[:, axis]
        total += rows.T @ (correlation @ rows)
    return total


def _inverse(normal: Floats) -> Floats:
    scale = np.sqrt(np.diag(normal))
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise _not_determined()
    scaled = normal / np.outer(scale, scale)
    if not np.linalg.eigvalsh(scaled)[0] > 1e-12:
        raise _not_determined()
    return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale), np.float64)


def _not_determined() -> DegenerateConfiguration:
    return DegenerateConfiguration("src: the good points lie on a line; need points that span the plane")


def _require(kept: Mask, min_points: int) -> None:
    if np.count_nonzero(kept) < min_points:
        raise NoConsensus(f"src, dst: {np.count_nonzero(kept)} correspondences agree; need {min_points}")
