"""A homography by least squares that leaves out what is improbably far off (least trimmed squares, Rousseeuw 1984)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError
from imgu_ros.types import Mask, Matrix3, as_matrix, as_points
from imgu_ros.vision.projective.dlt import normalisation
from imgu_ros.vision.projective.refine import TransferProblem, stepped
from imgu_ros.vision.projective.transform import normalised_homography

_ROUNDS = 2
_OUTLIER_SIGMAS = 3.6
_RAYLEIGH_MEDIAN = 1.1774  # in sigmas of one coordinate
_FLOOR_PX = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class TrimmedHomography:
    """What remained.

    Attributes
    ----------
    H : (3, 3) unit Frobenius norm; one Gauss-Newton step from the start
    inliers : (N,) correspondences that are not improbably far off
    """

    H: Matrix3
    inliers: Mask


def trimmed_homography(
    src: ArrayLike, dst: ArrayLike, start: Matrix3, threshold_px: float, min_points: int = 5
) -> TrimmedHomography:
    """Tell the good correspondences from the others, from a homography that is nearly right.

    At first those within `threshold_px` of the start are good; then, twice, those within 3.6 robust standard
    deviations (from the median distance) of the least-squares fit to the good ones. The transfer error is
    linearised once: from a start that is right to a pixel or two, the rest is below a thousandth of a pixel.

    Parameters
    ----------
    src, dst : (N, 2) px
    start : dst ~ start src
    threshold_px : largest distance in dst at first
    min_points : fewest good correspondences, >= 4

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
    if len(src) != len(dst):
        raise ShapeError(f"dst: {len(dst)} points; need {len(src)}, one for each of src")
    if not threshold_px > 0 or min_points < 4:
        raise ShapeError(f"threshold_px, min_points: {threshold_px!r}, {min_points!r}; need > 0, at least 4")
    H = normalised_homography(as_matrix(start, (3, 3), "start"))
    if len(src) < min_points:
        raise NoConsensus(f"src, dst: {len(src)} correspondences agree; need {min_points}")
    T_src, T_dst = normalisation(src), normalisation(dst)
    unit = float(T_dst[0, 0])
    scaled = normalised_homography(T_dst @ H @ np.linalg.inv(T_src))
    src, dst = (points @ T[:2, :2].T + T[:2, 2] for points, T in ((src, T_src), (dst, T_dst)))
    ahead = src @ scaled[2, :2] + scaled[2, 2] > 0
    safe = np.where(ahead[:, None], src, src[np.argmax(ahead)])
    at_start = TransferProblem(safe, dst).linearise(scaled)
    residuals, jacobian = at_start.residuals, at_start.jacobian
    distance = np.where(ahead, np.hypot(*residuals.T), np.inf)
    kept = distance <= threshold_px * unit
    step = np.zeros(8)
    for _ in range(_ROUNDS):
        _require(kept, min_points)
        rows = jacobian[kept].reshape(-1, 8)
        try:
            step = -np.linalg.solve(rows.T @ rows, rows.T @ residuals[kept].ravel())
        except np.linalg.LinAlgError:
            raise DegenerateConfiguration(
                "src: the good points lie on a line; need points that span the plane"
            ) from None
        distance = np.where(ahead, np.hypot(*(residuals + jacobian @ step).T), np.inf)
        sigma = float(np.median(distance[kept])) / _RAYLEIGH_MEDIAN
        kept = distance <= max(_OUTLIER_SIGMAS * sigma, _FLOOR_PX * unit)
    _require(kept, min_points)
    return TrimmedHomography(normalised_homography(np.linalg.solve(T_dst, stepped(scaled, step) @ T_src)), kept)


def _require(kept: Mask, min_points: int) -> None:
    if np.count_nonzero(kept) < min_points:
        raise NoConsensus(f"src, dst: {np.count_nonzero(kept)} correspondences agree; need {min_points}")
