# SPDX-License-Identifier: Apache-2.0
"""Robust estimators of homographies: from matches, some of them wrong, to a homography on which most agree.

| estimator | method | use it |
|---|---|---|
| `usac_then_ransac` | OpenCV's USAC; where its answer may be chance, `ransac` of this package goes on | for speed |
| `ransac` | `ransac` of this package alone | to compare |
| `usac_magsac` | OpenCV's USAC_MAGSAC (Barath, Noskova, Ivashechkin & Matas 2020) | to compare |

USAC of OpenCV 4.6 has crashed: with OpenCV before 5 `usac_then_ransac` is `ransac` alone, and `usac_magsac` is at the
user's own risk.

All refuse what wrong matches would agree on by chance (`max_by_chance`), and give the matches within the threshold as
inliers. OpenCV draws by a seed that comes from `rng`: the same matches and generator give the same homography.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Protocol

import cv2
import numpy as np

from imgu_ros.arguments import as_generator, as_integer, as_number, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Mask, Matrix3, Points
from imgu_ros.vision.estimation.ransac import Proposal, accepted, ransac
from imgu_ros.vision.estimation.sampling import Sampler
from imgu_ros.vision.estimation.search import Consensus, Score
from imgu_ros.vision.projective.minimal import HomographyModel

#: USAC of OpenCV 4.6 ended the process with a segmentation fault once in some thousand frames.
_HAS_USAC = int(cv2.__version__.partition(".")[0]) >= 5
#: Bounds the time of OpenCV's USAC: its graph cut has a term for each pair of neighbours, so that its time grows with
#: the square of the number of matches where they crowd. A frame has fewer matches than this by default.
_MOST_PROPOSED = 1000


@dataclass(frozen=True, slots=True)
class RansacParameters:
    """Parameters of `ransac`: see there."""

    sampler: str = "prosac"
    score: str = "truncated"
    confidence: float = 0.9999
    max_iterations: int = 1000
    min_inliers: int = 8


@dataclass(frozen=True, slots=True)
class UsacParameters:
    """Parameters of OpenCV's USAC; they mean what those of `ransac` mean."""

    confidence: float = 0.9999
    max_iterations: int = 1000
    min_inliers: int = 8


@dataclass(frozen=True, slots=True, eq=False)
class RobustHomography:
    """A homography on which matches agree.

    Attributes
    ----------
    H : (3, 3), dst ~ H src, unit Frobenius norm
    inliers : (N,) within the threshold in dst
    iterations : samples drawn by `ransac`
    """

    H: Matrix3
    inliers: Mask
    iterations: int


class HomographyEstimator(Protocol):
    """What a row of `ESTIMATORS` makes."""

    def __call__(
        self, src: Points, dst: Points, threshold_px: float, rng: np.random.Generator | int, max_by_chance: float = 1e-3
    ) -> RobustHomography:
        """Estimate H with dst ~ H src from matches (N, 2), best first; raise EstimationError when there is none."""


def ransac_estimator(parameters: RansacParameters) -> HomographyEstimator:
    """Return the `ransac` of this package, with `parameters`, as an estimator of homographies."""
    require_type(parameters, RansacParameters, "parameters")
    return partial(_by_ransac, parameters, Score(parameters.score) is Score.BIWEIGHT, None)


def usac_then_ransac_estimator(parameters: RansacParameters) -> HomographyEstimator:
    """Return `ransac`, with `parameters`, beginning with OpenCV's USAC: its answer stands if it is more than chance.

    With the score `biweight`, for matches of which few are right, it is `ransac` alone.
    """
    require_type(parameters, RansacParameters, "parameters")
    if Score(parameters.score) is Score.BIWEIGHT:
        return ransac_estimator(parameters)
    _require_ranges(parameters)
    is_ordered = Sampler(parameters.sampler) is Sampler.PROSAC
    return partial(_by_ransac, parameters, False, cv2.SAMPLING_PROSAC if is_ordered else cv2.SAMPLING_UNIFORM)


def usac_magsac_estimator(parameters: UsacParameters) -> HomographyEstimator:
    """Return OpenCV's USAC_MAGSAC, with `parameters`, as an estimator of homographies."""
    require_type(parameters, UsacParameters, "parameters")
    _require_ranges(parameters)
    return partial(_by_magsac, parameters)


def _require_ranges(parameters: RansacParameters | UsacParameters) -> None:
    """Raise `ShapeError` for numbers that OpenCV would refuse in its own words, or take."""
    confidence = as_number(parameters.confidence, "confidence")
    iterations = as_integer(parameters.max_iterations, "max_iterations")
    if not (0 < confidence < 1 and 1 <= iterations < 2**31):
        raise ShapeError(
            f"confidence, max_iterations: {confidence}, {iterations}; need a number between 0 and 1, and 1 to 2^31 - 1"
        )


def _usac_proposal(
    model: HomographyModel,
    src: Points,
    dst: Points,
    usac: cv2.UsacParams,
    threshold_px: float,
    rng: np.random.Generator | int,
    min_inliers: int = 0,
) -> Proposal:
    """Return the answer of OpenCV's USAC as a hypothesis of a model; none where there is no answer.

    Parameters
    ----------
    model : of `src` and `dst`
    src, dst : (N, 2)
    usac : its options; threshold and seed are set here
    threshold_px : largest distance in dst of an inlier
    rng : source of the seed, or a seed
    min_inliers : minimum number of inliers of an answer
    """
    min_inliers = as_integer(min_inliers, "min_inliers")
    usac.threshold, usac.randomGeneratorState = (
        as_number(threshold_px, "threshold_px"),
        int(as_generator(rng).integers(2**31)),
    )
    none = Proposal(np.zeros((0, 3, 3)), usac.maxIterations)
    if len(src) <= model.sample_size:
        return none
    try:
        H, mask = cv2.findHomography(src, dst, usac)
    except cv2.error:
        return none
    if H is None or np.count_nonzero(mask) < min_inliers or not np.isfinite(H).all():
        return none
    return Proposal(model.normalised(H, mask.ravel() != 0), usac.maxIterations)


def _by_ransac(
    parameters: RansacParameters,
    symmetric: bool,
    usac_sampler: int | None,
    src: Points,
    dst: Points,
    threshold_px: float,
    rng: np.random.Generator | int,
    max_by_chance: float = 1e-3,
) -> RobustHomography:
    p = parameters
    model = HomographyModel(src, dst, symmetric)
    proposal = None
    if usac_sampler is not None and _HAS_USAC and len(src) <= _MOST_PROPOSED:
        usac = cv2.UsacParams()
        usac.confidence, usac.maxIterations, usac.sampler = p.confidence, p.max_iterations, usac_sampler
        usac.score, usac.loMethod = cv2.SCORE_METHOD_MSAC, cv2.LOCAL_OPTIM_GC
        proposal = _usac_proposal(model, src, dst, usac, threshold_px, rng, p.min_inliers)
    consensus = ransac(
        model,
        threshold_px,
        rng,
        sampler=p.sampler,
        score=p.score,
        confidence=p.confidence,
        max_iterations=p.max_iterations,
        min_inliers=p.min_inliers,
        max_by_chance=max_by_chance,
        unit=" px",
        proposal=proposal,
    )
    return _homography(model, consensus)


def _by_magsac(
    parameters: UsacParameters,
    src: Points,
    dst: Points,
    threshold_px: float,
    rng: np.random.Generator | int,
    max_by_chance: float = 1e-3,
) -> RobustHomography:
    model, usac = HomographyModel(src, dst), cv2.UsacParams()
    usac.confidence, usac.maxIterations = parameters.confidence, parameters.max_iterations
    usac.sampler, usac.score, usac.loMethod = cv2.SAMPLING_UNIFORM, cv2.SCORE_METHOD_MAGSAC, cv2.LOCAL_OPTIM_SIGMA
    consensus = accepted(
        model,
        _usac_proposal(model, src, dst, usac, threshold_px, rng),
        threshold_px,
        min_inliers=parameters.min_inliers,
        max_by_chance=max_by_chance,
        unit=" px",
    )
    return _homography(model, consensus)


def _homography(model: HomographyModel, consensus: Consensus) -> RobustHomography:
    return RobustHomography(model.denormalised(consensus.hypothesis), consensus.inliers, consensus.iterations)
