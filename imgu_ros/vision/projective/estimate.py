# SPDX-License-Identifier: Apache-2.0
"""A homography with its covariance from correspondences that may be wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_generator, as_integer, as_number
from imgu_ros.errors import DegenerateConfiguration, EstimationError, NoConsensus, ShapeError, TooFewPoints
from imgu_ros.types import Mask, Matrix3, Points, as_points
from imgu_ros.vision.estimation.covariance import selection_efficiency
from imgu_ros.vision.estimation.nonlinear import Minimiser
from imgu_ros.vision.estimation.ransac import ransac
from imgu_ros.vision.estimation.sampling import Sampler
from imgu_ros.vision.estimation.search import Consensus, Score
from imgu_ros.vision.estimation.settling import InlierFit
from imgu_ros.vision.projective.fit import fit_homography
from imgu_ros.vision.projective.homography import HomographyEstimate, Orientation
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.refine import HomographyError, TransferProblem

#: Correspondences of which one can contradict the others.
_FEWEST = 5
#: Number of inliers on a line from which it is suspected. Measured: benchmarks/thresholds.py, study lines.
_MANY_ON_LINE = 8
#: Number of inliers beside that line that are not chance. Measured: benchmarks/thresholds.py, study lines.
_FEWEST_OFF_LINE = 5
#: Iterations in which the line is found by reweighted least squares: bounds the time.
_LINE_ROUNDS = 10
#: Samples that are drawn to tell whether the plane is seen from the side that is not allowed.
_OTHER_SIDE_SAMPLES = 500
_OTHER_SIDE = {Orientation.FRONT: Orientation.MIRRORED, Orientation.MIRRORED: Orientation.FRONT}


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
    max_by_chance: float = 1e-3,
    error: HomographyError | str = HomographyError.SAMPSON,
    refine: Minimiser | str | None = Minimiser.LEVENBERG_MARQUARDT,
    orientation: Orientation | str = Orientation.FRONT,
) -> HomographyEstimate:
    """Estimate H with dst ~ H src by sample consensus, then minimise the inliers' error.

    Where wrong matches lie changes nothing: neither far ones nor many. Of matches at one place of dst the search counts
    one. An answer is given only when wrong matches would not agree as well by chance: of few matches nearly all must,
    or more closely than the threshold asks; of thousands, a few more than would anyhow.

    Parameters
    ----------
    src, dst : (N, 2) px, N >= 5, best first when the sampler is prosac. Any four agree with a homography, so that
        nothing tells whether they are right: `fit_homography` takes four
    rng : source of the draws, or its seed
    threshold_px : largest distance in dst of an inlier
    sampler, confidence, max_iterations, min_inliers, max_by_chance : see `ransac`
    score : what the search minimises. `biweight`: of the distances in both images, for most inliers also where
        matches are few, wrong or oblique; `truncated`: of the distance in dst, several times faster
    error, refine : what the refinement minimises, and how; refine None (or error algebraic): the linear fit stays.
        `sampson`, `symmetric` and `reprojection` take errors of both sides to be equal in their own units; where src
        is in metres, or exact, `transfer` is right
    orientation : from which side the plane may be seen; `mirrored` where y points up in one and down in the other

    Returns
    -------
    H and its covariance are those of the inliers that are returned. The covariance allows for what the threshold cut
    off (`selection_efficiency`).

    Raises
    ------
    TooFewPoints
        If there are fewer than 5 correspondences.
    NoConsensus
        If too few correspondences agree, or as many would by chance.
    DegenerateConfiguration
        If the inliers lie (nearly) on a line, or the plane is seen from the other side than `orientation` allows.
    ShapeError
        If the arrays do not fit each other, or an option is out of range.
    """
    threshold_px = as_number(threshold_px, "threshold_px")
    max_iterations = as_integer(max_iterations, "max_iterations")
    src, dst = as_points(src, "src"), as_points(dst, "dst")
    if len(src) != len(dst):
        raise ShapeError(f"dst: {len(dst)} points; need {len(src)}, one for each of src")
    if len(src) < _FEWEST:
        raise TooFewPoints(
            f"src, dst: {len(src)} correspondences; need at least {_FEWEST}, or fit_homography for four that are right"
        )
    score, orientation, rng = Score(score), Orientation(orientation), as_generator(rng)

    def consensus(model: HomographyModel, score: Score, samples: int) -> Consensus:
        return ransac(
            model,
            threshold_px,
            rng,
            sampler=sampler,
            score=score,
            confidence=confidence,
            max_iterations=samples,
            min_inliers=min_inliers,
            max_by_chance=max_by_chance,
            unit=" px",
        )

    model = HomographyModel(src, dst, score is Score.BIWEIGHT, orientation)
    try:
        found = consensus(model, score, max_iterations)
    except NoConsensus:
        other = _OTHER_SIDE.get(orientation)
        if other is not None:
            samples = min(max_iterations, _OTHER_SIDE_SAMPLES)
            try:
                seen = consensus(HomographyModel(src, dst, orientation=other), Score.TRUNCATED, samples)
            except EstimationError:
                pass
            else:
                raise DegenerateConfiguration(_other_side(seen, other)) from None
        raise
    estimate = _settled(src, dst, model.denormalised(found.hypothesis), threshold_px, error, refine)
    if not estimate.inliers.all():
        _require_off_line(dst[estimate.inliers], threshold_px)
    return replace(estimate, iterations=found.iterations)


def _other_side(seen: Consensus, other: Orientation) -> str:
    agree = f"{np.count_nonzero(seen.inliers)} of {len(seen.inliers)} correspondences agree on a plane seen"
    if other is Orientation.MIRRORED:
        return (
            f"src, dst: {agree} mirrored (y up in one and down in the other, or from behind); "
            'need orientation="mirrored" or "any" where that is meant'
        )
    return f'src, dst: {agree} from its front; need orientation="front" or "any"'


def _require_off_line(dst: Points, threshold_px: float) -> None:
    """Refuse inliers of which all but a few lie on a line: of many wrong matches, two or three always fit beside it.

    The line is the one with the least sum of distances, by weighted total least squares.
    """
    distance = np.ones(len(dst))
    for _ in range(_LINE_ROUNDS):
        weights = 1 / np.maximum(distance, threshold_px)
        away = dst - weights @ dst / weights.sum()
        _, vectors = np.linalg.eigh((weights[:, None] * away).T @ away)
        distance = np.abs(away @ vectors[:, 0])
    on = int(np.count_nonzero(distance <= threshold_px))
    if on >= _MANY_ON_LINE and len(dst) - on < _FEWEST_OFF_LINE:
        raise DegenerateConfiguration(
            f"inliers: {on} of {len(dst)} on a line, the few beside it by chance; need {_FEWEST_OFF_LINE} off it"
        )


def _settled(
    src: Points,
    dst: Points,
    H: Matrix3,
    threshold_px: float,
    error: HomographyError | str,
    refine: Minimiser | str | None,
) -> HomographyEstimate:
    """Return the fit to the inliers of H, then to those of that fit, and so on until they stay the same."""
    # From their own linear fit, so that it is theirs alone, however they were found.
    settled = InlierFit(
        lambda mask: fit_homography(src[mask], dst[mask], error=error, refine=refine, orientation=Orientation.ANY),
        lambda estimate: _inliers(estimate.H, src, dst, threshold_px),
        _FEWEST,
        len(src),
    ).settled(_inliers(H, src, dst, threshold_px))
    estimate, fitted = settled.result, settled.inliers
    count = int(np.count_nonzero(fitted))
    squares = float((TransferProblem(src[fitted], dst[fitted]).residuals(estimate.H) ** 2).sum())
    efficiency = selection_efficiency(squares / max(count - 4, 1), threshold_px)
    return replace(estimate, covariance=estimate.covariance / efficiency**2, inliers=fitted)


def _inliers(H: Matrix3, src: Points, dst: Points, threshold_px: float) -> Mask:
    mapped = src @ H[:, :2].T + H[:, 2]
    ahead = mapped[:, 2] > 0
    xy = mapped[:, :2] / np.where(ahead, mapped[:, 2], 1.0)[:, None]
    return np.asarray(ahead & (np.hypot(*(xy - dst).T) <= threshold_px))
