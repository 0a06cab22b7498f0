# SPDX-License-Identifier: Apache-2.0
"""Random sample consensus for any model (IU 7.5; Fischler & Bolles 1981; HZ section 4.7).

Hypotheses are generated and scored in batches, and each promising one is refitted to its own inliers (LO-RANSAC,
Chum, Matas & Kittler 2003).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imgu_ros.arguments import as_integer, as_number, require_methods, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Mask
from imgu_ros.vision.estimation.chance import ChanceModel
from imgu_ros.vision.estimation.sampling import Sampler, draw_samples
from imgu_ros.vision.estimation.search import SEARCHES, Consensus, RobustModel, Score, Search

#: Probability that a wrong hypothesis agrees with a point, beta of PROSAC (Chum & Matas 2005, section 2.2).
_BY_CHANCE = 0.05
#: Number of inliers beyond those expected by chance from which an early stop is allowed. Measured:
#: benchmarks/thresholds.py, study prosac.
_SUPPORT = 8
#: Hypotheses as good as a proposal that wrong data are expected to give: below it, no sample is drawn beside it.
_PROPOSED_BY_CHANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """Hypotheses that another search found.

    Attributes
    ----------
    hypotheses : (B, ...) as the model has them; possibly none
    samples : that were drawn for them, at most
    """

    hypotheses: Floats
    samples: int


def ransac(
    model: RobustModel,
    threshold: float,
    rng: np.random.Generator | int,
    *,
    sampler: Sampler | str = Sampler.UNIFORM,
    score: Score | str = Score.TRUNCATED,
    confidence: float = 0.9999,
    max_iterations: int = 2000,
    min_inliers: int = 0,
    max_by_chance: float = 1e-3,
    unit: str = "",
    proposal: Proposal | None = None,
) -> Consensus:
    """Find the hypothesis with the smallest robust error.

    Parameters
    ----------
    model : see `RobustModel`
    threshold : largest error of an inlier, in the unit of the model's errors
    rng : source of the draws, or its seed
    sampler : uniform, or prosac when the points are sorted best first
    score : what is minimised
    confidence : stop when a better sample than the best would have been drawn with this probability
    max_iterations : maximum number of samples; with the biweight score, of hypotheses: samples that give none are drawn
        again, up to ten times as many in all
    min_inliers : minimum number of inliers of an answer, raised to sample_size + 1
    max_by_chance : most hypotheses as good as the answer that wrong data may be expected to give, of a model that can
        tell (`ChanceModel`); inf: chance is not asked
    unit : of the threshold, for the message of NoConsensus
    proposal : hypotheses to begin with. When the best of them, fitted to what agrees with it, is more than chance
        (1e-3, or `max_by_chance` where that is less), it is the answer, and no sample is drawn

    Raises
    ------
    TooFewPoints
        If there are fewer points than a sample needs.
    NoConsensus
        If no hypothesis reaches the wanted number of inliers, or wrong data would agree as well by chance.
    ShapeError
        If an option is out of range.

    Examples
    --------
    >>> from imgu_ros.vision.estimation import LineModel
    >>> points = np.array([[3, 0], [3, 5], [3, 1], [8, 8], [3, 9], [0, 6], [3, 7]])
    >>> ransac(LineModel(points), 0.1, np.random.default_rng(0)).inliers.tolist()
    [True, True, True, False, True, False, True]
    """
    confidence = as_number(confidence, "confidence")
    max_iterations = as_integer(max_iterations, "max_iterations")
    min_inliers = as_integer(min_inliers, "min_inliers")
    max_by_chance = as_number(max_by_chance, "max_by_chance")
    search = _search(model, threshold, Score(score))
    if not (0 < confidence < 1 and max_iterations >= 1 and max_by_chance > 0):
        raise ShapeError(
            f"confidence, max_iterations, max_by_chance: {confidence}, {max_iterations}, {max_by_chance}; need "
            "between 0 and 1, >= 1, > 0"
        )
    wanted = max(min_inliers, model.sample_size + 1)
    most_drawn = needed = max_iterations * search.draws_for_each

    def enough() -> int:
        """Return the number of samples after which one better than the best hypothesis would have been drawn."""
        share = _inlier_share(search.errors <= search.limit, search.shares, model.sample_size, Sampler(sampler))
        return min(needed, iterations_needed(share, model.sample_size, confidence))

    proposed = drawn = scored = 0
    if proposal is not None:
        require_type(proposal, Proposal, "proposal")
        proposed = proposal.samples
        if len(proposal.hypotheses) and search.improve(proposal.hypotheses):
            if search.failure(wanted, proposed, min(max_by_chance, _PROPOSED_BY_CHANCE), 0, unit) is None:
                return search.consensus(0)
            needed = enough()
    for samples in draw_samples(sampler, model.count, model.sample_size, rng, search.largest_batch):
        samples = samples[: most_drawn - drawn]
        drawn += len(samples)
        hypotheses = model.generate(samples)
        scored += len(hypotheses)
        if len(hypotheses) and search.improve(hypotheses):
            needed = enough()
        if drawn >= min(needed, most_drawn) or scored >= max_iterations:
            break
    search.finish()
    failure = search.failure(wanted, proposed + scored, max_by_chance, drawn, unit)
    if failure is not None:
        raise failure
    return search.consensus(drawn)


def accepted(
    model: RobustModel,
    proposal: Proposal,
    threshold: float,
    *,
    min_inliers: int = 0,
    max_by_chance: float = 1e-3,
    unit: str = "",
) -> Consensus:
    """Return the best of proposed hypotheses, as it is, when `ransac` would accept it as its answer.

    Parameters
    ----------
    model, threshold, min_inliers, max_by_chance, unit : as in `ransac`, which raises the same errors
    proposal : the hypotheses
    """
    require_type(proposal, Proposal, "proposal")
    search = _search(model, threshold, Score.TRUNCATED)
    if len(proposal.hypotheses):
        search.consider(proposal.hypotheses)
    wanted = max(as_integer(min_inliers, "min_inliers"), model.sample_size + 1)
    max_by_chance = as_number(max_by_chance, "max_by_chance")
    if not max_by_chance > 0:
        raise ShapeError(f"max_by_chance: {max_by_chance}; need a number above 0")
    failure = search.failure(wanted, proposal.samples, max_by_chance, 0, unit)
    if failure is not None:
        raise failure
    return search.consensus(0)


def _search(model: RobustModel, threshold: float, score: Score) -> Search:
    """Return a search without a hypothesis yet."""
    require_methods(model, ("count", "sample_size", "generate", "squared_errors"), "model")
    threshold = as_number(threshold, "threshold")
    if not 1e-150 < threshold < 1e150:
        raise ShapeError(f"threshold: {threshold}; need > 0")
    shares = model.shares(threshold) if isinstance(model, ChanceModel) else np.ones(model.count)
    return SEARCHES[score](model, threshold**2, shares)


def iterations_needed(inlier_share: float, sample_size: int, confidence: float) -> int:
    """Return how many samples give one free of outliers with the wanted probability (IU 7.5; HZ equation 4.18).

    K = log(1 - p) / log(1 - r^m), r `inlier_share`, m `sample_size`, p `confidence`; 1 when all points are inliers,
    and 2^62 when none is.

    Raises
    ------
    ShapeError
        If the share is not 0 to 1, the sample empty, or the confidence not between 0 and 1.

    Examples
    --------
    >>> iterations_needed(0.5, 4, 0.99)  # HZ table 4.3
    72
    """
    inlier_share = as_number(inlier_share, "inlier_share")
    sample_size = as_integer(sample_size, "sample_size")
    confidence = as_number(confidence, "confidence")
    if not (0 <= inlier_share <= 1 and sample_size >= 1 and 0 < confidence < 1):
        raise ShapeError(
            f"inlier_share, sample_size, confidence: {inlier_share}, {sample_size}, {confidence}; "
            "need 0 to 1, >= 1, between 0 and 1"
        )
    good = inlier_share**sample_size
    if good >= 1:
        return 1
    if good < 1e-15:
        return 2**62
    return max(1, math.ceil(math.log(1 - confidence) / math.log1p(-good)))


def _inlier_share(inliers: Mask, shares: Floats, sample_size: int, sampler: Sampler) -> float:
    """Return the share of inliers; for PROSAC the highest among the best n points, for any n with more than chance.

    Samples come from the best points, so that it is their share that counts (Chum & Matas 2005, section 2.2). Many that
    are at one place do not make the search stop before it has seen the others.
    """
    if sampler is Sampler.UNIFORM:
        return min(float(inliers.mean()), float(shares[inliers].sum() / shares.sum()))
    found = np.cumsum(inliers)
    n = np.arange(1, len(inliers) + 1)
    by_chance = _BY_CHANCE * n
    sure = found >= sample_size + by_chance + 3 * np.sqrt(by_chance) + _SUPPORT
    sure[-1] = True
    return float((found[sure] / n[sure]).max())
