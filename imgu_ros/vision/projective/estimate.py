"""A homography with its covariance from correspondences that may be wrong."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Mask, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.estimation.covariance import propagated_covariance
from imgu_ros.vision.estimation.nonlinear import LeastSquaresProblem, Minimiser, minimise
from imgu_ros.vision.estimation.ransac import Score, ransac
from imgu_ros.vision.estimation.sampling import Sampler
from imgu_ros.vision.projective.dlt import homography_dlt, normalisation
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.refine import (
    HomographyError,
    SampsonProblem,
    SymmetricProblem,
    TransferProblem,
    tangent_basis,
)
from imgu_ros.vision.projective.reprojection import ReprojectionProblem
from imgu_ros.vision.projective.transform import faces_camera, inverse3, normalised_homography

#: Inliers must reach this far across their main direction, as a share of their extent along it (both RMS):
#: nearer to a line, the homography is not determined across it.
_MIN_ASPECT = 0.02


def estimate_homography(
    src: ArrayLike,
    dst: ArrayLike,
    rng: np.random.Generator | int,
    *,
    threshold_px: float = 3.0,
    sampler: Sampler | str = Sampler.UNIFORM,
    score: Score | str = Score.BIWEIGHT,
    confidence: float = 0.9999,
    max_iterations: int = 2000,
    min_inliers: int = 5,
    error: HomographyError | str = HomographyError.SAMPSON,
    refine: Minimiser | str | None = Minimiser.LEVENBERG_MARQUARDT,
) -> HomographyEstimate:
    """Estimate H with dst ~ H src by sample consensus, then minimise the inliers' error.

    Parameters
    ----------
    src, dst : (N, 2) px, N >= 4, best first when the sampler is prosac
    rng : source of the draws, or its seed
    threshold_px : largest distance in dst of an inlier
    sampler, confidence, max_iterations, min_inliers : see `ransac`
    score : what the search minimises. `biweight`: of the distances in both images, for most inliers also where
        matches are few, wrong or oblique; `truncated`: of the distance in dst, several times faster
    error, refine : what the refinement minimises, and how; refine None (or error algebraic): the linear fit stays

    Raises
    ------
    TooFewPoints
        If there are fewer than 4 correspondences.
    NoConsensus
        If too few correspondences agree.
    DegenerateConfiguration
        If the inliers lie (nearly) on a line, or the homography is mirrored or singular.
    """
    threshold_px = as_number(threshold_px, "threshold_px")
    confidence = as_number(confidence, "confidence")
    max_iterations = as_integer(max_iterations, "max_iterations")
    min_inliers = as_integer(min_inliers, "min_inliers")
    src, dst = as_points(src, "src"), as_points(dst, "dst")
    if len(src) != len(dst):
        raise ShapeError(f"dst: {len(dst)} points; need {len(src)}, one for each of src")
    if len(src) < 4:
        raise TooFewPoints(f"src, dst: {len(src)} correspondences; need at least 4")
    score = Score(score)
    model = HomographyModel(src, dst, symmetric=score is Score.BIWEIGHT)
    consensus = ransac(
        model,
        threshold_px,
        rng,
        sampler=sampler,
        score=score,
        confidence=confidence,
        max_iterations=max_iterations,
        min_inliers=min_inliers,
        unit=" px",
    )
    H = model.denormalised(consensus.hypothesis)
    inliers = _inliers(H, src, dst, threshold_px) & consensus.inliers
    estimate = fit_homography(src[inliers], dst[inliers], error=error, refine=refine, start=H)
    inliers = _inliers(estimate.H, src, dst, threshold_px)
    return HomographyEstimate(estimate.H, estimate.covariance, inliers, estimate.rms_px, consensus.iterations)


def fit_homography(
    src: ArrayLike,
    dst: ArrayLike,
    *,
    error: HomographyError | str = HomographyError.SAMPSON,
    refine: Minimiser | str | None = Minimiser.LEVENBERG_MARQUARDT,
    start: Matrix3 | None = None,
    noise_px: float | None = None,
    correlation: Floats | None = None,
) -> HomographyEstimate:
    """Fit H with dst ~ H src to correspondences without outliers.

    Parameters
    ----------
    src, dst : (N, 2) px, N >= 4
    error, refine : what is minimised, and how; refine None (or error algebraic): the linear fit
    start : where the refinement starts; None: the linear fit
    noise_px : standard deviation of one coordinate; None: from the residuals, which needs N >= 5
    correlation : (N, N) correlation of the errors of different correspondences; None: independent

    Returns
    -------
    With every correspondence an inlier and no iterations. Covariance: `propagated_covariance` on
    the tangent of the unit sphere that H lies on.

    Raises
    ------
    TooFewPoints, DegenerateConfiguration
        If the correspondences do not determine a homography that keeps the plane's orientation.
    ShapeError
        If the arrays do not fit each other, or hold numbers that are not finite or too large.

    Examples
    --------
    >>> src = [[0, 0], [4, 0], [4, 3], [0, 3], [2, 1]]
    >>> estimate = fit_homography(src, [[10, 5], [14, 5], [14, 8], [10, 8], [12, 6]], error="reprojection")
    >>> (estimate.H / estimate.H[2, 2]).round(6).tolist()[0]
    [1.0, 0.0, 10.0]
    """
    noise_px = None if noise_px is None else as_number(noise_px, "noise_px")
    src, dst = as_points(src, "src"), as_points(dst, "dst")
    if len(src) != len(dst):
        raise ShapeError(f"dst: {len(dst)} points; need {len(src)}, one for each of src")
    require_spread(src, "src")
    require_spread(dst, "dst")
    error = HomographyError(error)
    refined = refine is not None and error is not HomographyError.ALGEBRAIC
    H = normalised_homography(start) if refined and start is not None else homography_dlt(src, dst)
    # Both sides centred and divided by one unit: well conditioned, and distances keep their proportions.
    T_src, T_dst = _common_unit(src, dst)
    problem = _PROBLEMS[error](_mapped(T_src, src), _mapped(T_dst, dst))
    scaled = normalised_homography(T_dst @ H @ np.linalg.inv(T_src))
    if not faces_camera(scaled, _mapped(T_src, src)):
        raise DegenerateConfiguration(
            "H: the points are seen mirrored or across the horizon; need one side of the plane"
        )
    # No step at all still gives the residuals and their derivative, from which the covariance comes.
    method = Minimiser(Minimiser.GAUSS_NEWTON if refine is None else refine)
    minimum = minimise(problem, scaled, method, max_iterations=_MOST_STEPS[method] if refined else 0)
    if not faces_camera(minimum.estimate, _mapped(T_src, src)):
        raise DegenerateConfiguration("H: the refined plane passes through the camera; need better spread points")
    noise = None if noise_px is None else noise_px * float(T_dst[0, 0])
    covariance = propagated_covariance(minimum, noise, correlation)
    basis = tangent_basis(minimum.estimate)
    H, by_scaled = unscaled(minimum.estimate, T_src, T_dst)
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


def _inliers(H: Matrix3, src: Points, dst: Points, threshold_px: float) -> Mask:
    mapped = src @ H[:, :2].T + H[:, 2]
    ahead = mapped[:, 2] > 0
    xy = mapped[:, :2] / np.where(ahead, mapped[:, 2], 1.0)[:, None]
    return np.asarray(ahead & (np.hypot(*(xy - dst).T) <= threshold_px))


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


def unscaled(scaled: Matrix3, T_src: Matrix3, T_dst: Matrix3) -> tuple[Matrix3, Floats]:
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
    scaled, T_src, T_dst = (
        as_matrix(M, (3, 3), name) for M, name in ((scaled, "scaled"), (T_src, "T_src"), (T_dst, "T_dst"))
    )
    T_inverse = inverse3(T_dst, "T_dst")
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        raw = T_inverse @ scaled @ T_src
        H = normalised_homography(raw)
        norm = math.copysign(float(np.linalg.norm(raw)), float(np.vdot(raw, H)))
        h = H.ravel()
        # The Kronecker product of T_dst^-1 and T_src^T; np.kron takes several times as long.
        by_scaled = T_inverse[:, None, :, None] * T_src.T[None, :, None, :]
        by_scaled = by_scaled.reshape(9, 9) / norm
        # Without what goes along H.
        by_scaled -= h[:, None] * (h @ by_scaled)
    if not (math.isfinite(norm) and np.isfinite(by_scaled).all()):
        raise DegenerateConfiguration("scaled, T_src, T_dst: numbers too large or small; need those of a picture")
    return H, by_scaled


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
