# SPDX-License-Identifier: Apache-2.0
"""A homography with its covariance from correspondences without outliers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_number
from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Matrix3, Points, as_points
from imgu_ros.vision.estimation.covariance import propagated_covariance
from imgu_ros.vision.estimation.nonlinear import LeastSquaresProblem, Minimiser, minimise
from imgu_ros.vision.projective.dlt import homography_dlt, normalisation
from imgu_ros.vision.projective.homography import (
    HomographyEstimate,
    Orientation,
    normalised_homography,
    tangent_basis,
    unscaled_unchecked,
)
from imgu_ros.vision.projective.refine import (
    HomographyError,
    SampsonProblem,
    SymmetricProblem,
    TransferProblem,
)
from imgu_ros.vision.projective.reprojection import ReprojectionProblem
from imgu_ros.vision.projective.transform import faces_camera

#: Smallest extent of the inliers across their main direction, as a share of that along it (both RMS): nearer to a line,
#: the homography is not determined across it. Measured: benchmarks/thresholds.py, study lines.
_MIN_ASPECT = 0.02
#: px, of the errors where four correspondences leave no residual that could tell them.
_UNTOLD_NOISE_PX = 1.0
#: x turned over: what makes of a plane seen mirrored one seen from its front.
_TURNED = np.array([-1.0, 1.0, 1.0])


def fit_homography(
    src: ArrayLike,
    dst: ArrayLike,
    *,
    error: HomographyError | str = HomographyError.SAMPSON,
    refine: Minimiser | str | None = Minimiser.LEVENBERG_MARQUARDT,
    start: Matrix3 | None = None,
    noise_px: float | None = None,
    correlation: Floats | None = None,
    orientation: Orientation | str = Orientation.FRONT,
) -> HomographyEstimate:
    """Fit H with dst ~ H src to correspondences without outliers.

    Parameters
    ----------
    src, dst : (N, 2) px, N >= 4: of four the homography is exact
    error, refine : what is minimised, and how; refine None (or error algebraic): the linear fit
    start : where the refinement starts; None: the linear fit
    noise_px : standard deviation of one coordinate; None: from the residuals. Four correspondences leave none: 1 px
        is taken then, and the covariance is for the caller to scale by the variance
    correlation : (N, N) correlation of the errors of different correspondences; None: independent
    orientation : from which side the plane may be seen

    Returns
    -------
    With every correspondence an inlier and no iterations. Covariance: `propagated_covariance` on
    the tangent of the unit sphere that H lies on.

    Raises
    ------
    TooFewPoints, DegenerateConfiguration
        If the correspondences do not determine a homography that shows the plane from a side that is allowed.
    ShapeError
        If the arrays do not fit each other, or hold numbers that are not finite or too large.

    Examples
    --------
    >>> src = [[0, 0], [4, 0], [4, 3], [0, 3], [2, 1]]
    >>> estimate = fit_homography(src, [[10, 5], [14, 5], [14, 8], [10, 8], [12, 6]], error="reprojection")
    >>> (estimate.H / estimate.H[2, 2])[0, [0, 2]].round(6).tolist()
    [1.0, 10.0]
    """
    noise_px = None if noise_px is None else as_number(noise_px, "noise_px")
    src, dst = as_points(src, "src"), as_points(dst, "dst")
    if len(src) != len(dst):
        raise ShapeError(f"dst: {len(dst)} points; need {len(src)}, one for each of src")
    require_spread(src, "src")
    require_spread(dst, "dst")
    if noise_px is None and len(src) == 4:
        noise_px = _UNTOLD_NOISE_PX
    error = HomographyError(error)
    refined = refine is not None and error is not HomographyError.ALGEBRAIC
    H = normalised_homography(start) if refined and start is not None else homography_dlt(src, dst)
    mirrored = _is_mirrored(H, src, Orientation(orientation))
    turned = _TURNED if mirrored else np.ones(3)
    front = _fitted(src * turned[:2], dst, H * turned, error, refine if refined else None, noise_px, correlation)
    if not mirrored:
        return front
    # H is linear in the plane's x, and so is its covariance in both of its indices.
    signs = np.tile(turned, 3)
    return replace(front, H=front.H * turned, covariance=front.covariance * signs[:, None] * signs)


def _is_mirrored(H: Matrix3, src: Points, orientation: Orientation) -> bool:
    """Whether the plane is seen mirrored, by a homography with det H > 0.

    Raises
    ------
    DegenerateConfiguration
        If it is seen from a side that is not allowed, or across the horizon.
    """
    depths = src @ H[2, :2] + H[2, 2]
    front, mirrored = bool((depths > 0).all()), bool((depths < 0).all())
    if mirrored and orientation is Orientation.FRONT:
        raise DegenerateConfiguration(
            "src, dst: the plane is seen mirrored (y up in one and down in the other, or from behind); "
            'need orientation="mirrored" or "any" where that is meant'
        )
    if front and orientation is Orientation.MIRRORED:
        raise DegenerateConfiguration('src, dst: the plane is seen from its front; need orientation="front" or "any"')
    if not (front or mirrored):
        raise DegenerateConfiguration("H: the points are seen across the horizon; need one side of the plane")
    return mirrored


def _fitted(
    src: Points,
    dst: Points,
    H: Matrix3,
    error: HomographyError,
    refine: Minimiser | str | None,
    noise_px: float | None,
    correlation: Floats | None,
) -> HomographyEstimate:
    """Return the fit, from H on, to a plane seen from its front."""
    # Both sides centred and divided by one unit: well conditioned, and distances keep their proportions.
    T_src, T_dst = _common_unit(src, dst)
    problem = _PROBLEMS[error](_mapped(T_src, src), _mapped(T_dst, dst))
    scaled = normalised_homography(T_dst @ H @ np.linalg.inv(T_src))
    # No step at all still gives the residuals and their derivative, from which the covariance comes.
    method = Minimiser(Minimiser.GAUSS_NEWTON if refine is None else refine)
    minimum = minimise(problem, scaled, method, max_iterations=0 if refine is None else _MOST_STEPS[method])
    if not faces_camera(minimum.estimate, _mapped(T_src, src)):
        raise DegenerateConfiguration("H: the refined plane passes through the camera; need better spread points")
    noise = None if noise_px is None else noise_px * float(T_dst[0, 0])
    covariance = propagated_covariance(minimum, noise, correlation)
    basis = tangent_basis(minimum.estimate)
    H, by_scaled = unscaled_unchecked(minimum.estimate, T_src, T_dst)
    spread_out = by_scaled @ basis
    rms = math.sqrt(float((TransferProblem(src, dst).residuals(H) ** 2).mean()))
    return HomographyEstimate(H, spread_out @ covariance @ spread_out.T, np.ones(len(src), bool), rms, 0)


def require_spread(points: ArrayLike, name: str) -> None:
    """Raise `DegenerateConfiguration` when points lie (nearly) on a line or coincide; `name` is what it calls them.

    Raises
    ------
    TooFewPoints
        If there are fewer than four.
    """
    points = as_points(points, name)
    if len(points) < 4:
        raise TooFewPoints(f"{name}: {len(points)} points; need at least 4")
    away = points - points.mean(axis=0)
    singular = np.linalg.svd(away / (np.abs(away).max() or 1.0), compute_uv=False)
    if not singular[1] > _MIN_ASPECT * singular[0]:
        raise DegenerateConfiguration(
            f"{name}: {len(points)} points on a line (width / length {singular[1] / max(singular[0], 1e-300):.2g}); "
            f"need more than {_MIN_ASPECT}"
        )


def _common_unit(src: Points, dst: Points) -> tuple[Matrix3, Matrix3]:
    """Return the similarities (3, 3) that centre `src` and `dst`, (N, 2) each, and scale both by the same factor.

    Raises
    ------
    DegenerateConfiguration
        If all points of a side coincide.
    """
    T_src, T_dst = normalisation(src), normalisation(dst)
    unit = math.sqrt(float(T_src[0, 0] * T_dst[0, 0]))
    for T in (T_src, T_dst):
        T[:2] *= unit / T[0, 0]
    return T_src, T_dst


def _mapped(T: Matrix3, points: Points) -> Points:
    return points @ T[:2, :2].T + T[:2, 2]


#: Most iterations: steepest descent converges linearly, the others nearly quadratically.
_MOST_STEPS = {
    Minimiser.STEEPEST_DESCENT: 300,
    Minimiser.GAUSS_NEWTON: 30,
    Minimiser.LEVENBERG_MARQUARDT: 30,
}
_PROBLEMS: dict[HomographyError, Callable[[Points, Points], LeastSquaresProblem]] = {
    HomographyError.ALGEBRAIC: TransferProblem,
    HomographyError.TRANSFER: TransferProblem,
    HomographyError.SYMMETRIC: SymmetricProblem,
    HomographyError.SAMPSON: SampsonProblem,
    HomographyError.REPROJECTION: ReprojectionProblem,
}
