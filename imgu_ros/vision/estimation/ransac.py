# SPDX-License-Identifier: Apache-2.0
"""Random sample consensus for any model (notes 7.5; Fischler & Bolles 1981; HZ section 4.7).

Hypotheses are generated and scored in batches, and each promising one is refitted to its own inliers (LO-RANSAC,
Chum, Matas & Kittler 2003).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imgu_ros.arguments import as_integer, as_number, require_methods
from imgu_ros.errors import NoConsensus, ShapeError
from imgu_ros.types import Floats, Mask
from imgu_ros.vision.estimation.chance import Agreement, ChanceModel
from imgu_ros.vision.estimation.sampling import Sampler, draw_samples
from imgu_ros.vision.estimation.search import SEARCHES, RobustModel, Score

#: Probability that a wrong hypothesis agrees with a point, beta of PROSAC (Chum & Matas 2005, section 2.2).
_BY_CHANCE = 0.05
#: Number of inliers beyond those expected by chance from which an early stop is allowed. Measured:
#: benchmarks/thresholds.py, study prosac.
_SUPPORT = 8


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """The best hypothesis found.

    Attributes
    ----------
    hypothesis : as the model has it
    inliers : (N,) error within the threshold
    iterations : samples drawn
    """

    hypothesis: Floats
    inliers: Mask
    iterations: int


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
    max_iterations : most samples; with the biweight score most hypotheses: samples that give none are drawn again,
        up to ten times as many in all
    min_inliers : fewest inliers of an answer; at least sample_size + 1 are asked for
    max_by_chance : most hypotheses as good as the answer that wrong data may be expected to give, of a model that can
        tell (`ChanceModel`); inf: chance is not asked
    unit : of the threshold, for the message of NoConsensus

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
    require_methods(model, ("count", "sample_size", "generate", "squared_errors"), "model")
    threshold = as_number(threshold, "threshold")
    confidence = as_number(confidence, "confidence")
    max_iterations = as_integer(max_iterations, "max_iterations")
    min_inliers = as_integer(min_inliers, "min_inliers")
    max_by_chance = as_number(max_by_chance, "max_by_chance")
    if not (1e-150 < threshold < 1e150 and 0 < confidence < 1 and max_iterations >= 1 and max_by_chance > 0):
        raise ShapeError(
            f"threshold, confidence, max_iterations, max_by_chance: {threshold}, {confidence}, {max_iterations}, "
            f"{max_by_chance}; need > 0, between 0 and 1, >= 1, > 0"
        )
    limit = threshold**2
    shares = model.shares(threshold) if isinstance(model, ChanceModel) else np.ones(model.count)
    search = SEARCHES[Score(score)](model, limit, shares)
    most_drawn = max_iterations * search.draws_for_each
    needed = most_drawn
    drawn = scored = 0
    for samples in draw_samples(sampler, model.count, model.sample_size, rng, search.largest_batch):
        samples = samples[: most_drawn - drawn]
        drawn += len(samples)
        hypotheses = model.generate(samples)
        scored += len(hypotheses)
        if len(hypotheses) and search.improve(hypotheses):
            share = _inlier_share(search.errors <= limit, shares, model.sample_size, Sampler(sampler))
            needed = min(needed, iterations_needed(share, model.sample_size, confidence))
        if drawn >= min(needed, most_drawn) or scored >= max_iterations:
            break
    search.finish()
    inlier_mask = search.errors <= limit
    found = int(np.count_nonzero(inlier_mask))
    wanted = max(min_inliers, model.sample_size + 1)
    if search.best is None or found < wanted:
        raise NoConsensus(
            f"inliers: {found} of {model.count} within {threshold:g}{unit} after {drawn} samples; need {wanted}",
            inliers=found,
        )
    if isinstance(model, ChanceModel) and math.isfinite(max_by_chance):
        probability = model.agreement_probability(search.best, threshold)
        ratios = np.sqrt(search.errors) / threshold
        agreement = Agreement(shares, ratios, model.sample_size, model.codimension, probability)
        if not agreement.expected_by_chance(scored) <= max_by_chance:
            raise NoConsensus(
                _by_chance(agreement, found, scored, max_by_chance, f"{threshold:g}{unit}"), inliers=found
            )
    return Consensus(search.best, inlier_mask, drawn)


def _by_chance(agreement: Agreement, found: int, tested: int, expected: float, threshold: str) -> str:
    """Return the reason in the user's terms."""
    count = len(agreement.shares)
    alike = float(agreement.shares[agreement.ratios <= 1].sum())
    places = "" if found - alike < 0.5 else f", at {alike:.0f} different places"
    needed = agreement.needed(tested, expected)
    more = f"need {needed}" if needed <= count else "need a smaller threshold, or more that agree"
    return f"inliers: {found} of {count} within {threshold}{places}: as many agree by chance; {more}"


def iterations_needed(inlier_share: float, sample_size: int, confidence: float) -> int:
    """Return how many samples give one free of outliers with the wanted probability (notes 7.5; HZ equation 4.18).

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
