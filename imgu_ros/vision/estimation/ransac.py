"""Random sample consensus for any model (notes 7.5; Fischler & Bolles 1981; HZ section 4.7).

Hypotheses are generated and scored in batches, and each promising one is refitted to its own inliers (LO-RANSAC,
Chum, Matas & Kittler 2003).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from imgu_ros.arguments import as_integer, as_number, require_methods
from imgu_ros.errors import EstimationError, NoConsensus, ShapeError
from imgu_ros.types import Choice, Floats, Indices, Mask
from imgu_ros.vision.estimation.sampling import Sampler, draw_samples

_LOCAL_STEPS = 4
#: The biweight reaches this many thresholds far: a threshold that is a little wrong then does little harm.
_REACH = 8 / 3
#: Reaches of the successive weighted fits, in those of the score: a sample's errors magnify away from it.
_ANNEALING = (2.0, 1.4, 1.0, 1.0, 1.0, 1.0)
#: Probability that a wrong hypothesis agrees with a point, and inliers beyond chance that make a stop early.
_BY_CHANCE = 0.05
_SUPPORT = 8
#: Hypotheses of each batch that are fitted by weight.
_PROMISING = 2


class Score(Choice):
    """What a point adds to the cost of a hypothesis, by its error."""

    TRUNCATED = "truncated"  #: squared error up to the threshold's, MSAC (Torr & Zisserman 2000)
    BIWEIGHT = "biweight"  #: Tukey's loss, 8/3 thresholds wide: as if the threshold were averaged over, slower


class RobustModel(Protocol):
    """What `ransac` needs to know of a model; hypotheses are rows of a (B, ...) array."""

    @property
    def count(self) -> int:
        """Number of points N."""

    @property
    def sample_size(self) -> int:
        """Fewest points that determine the model."""

    def generate(self, samples: Indices) -> Floats:
        """Return the hypotheses, (B', ...), of samples (B, m); degenerate samples give none, so B' may differ."""

    def squared_errors(self, hypotheses: Floats) -> Floats:
        """Return the squared error (B, N) of every point under each hypothesis; inf where undefined."""

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        """Return one hypothesis fitted to the inliers; raises EstimationError when they do not determine it."""


@runtime_checkable
class WeightedModel(RobustModel, Protocol):
    """A model that can also be fitted by weight, many at once: what the biweight score makes best use of."""

    def refit_weighted(self, hypotheses: Floats, weights: Floats) -> Floats:
        """Return the hypotheses (B', ...) fitted with weights (B, N) of the squared errors; undetermined give none."""


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
    unit : of the threshold, for the message of NoConsensus

    Raises
    ------
    TooFewPoints
        If there are fewer points than a sample needs.
    NoConsensus
        If no hypothesis reaches the wanted number of inliers.
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
    if not (1e-150 < threshold < 1e150 and 0 < confidence < 1 and max_iterations >= 1):
        raise ShapeError(
            f"threshold, confidence, max_iterations: {threshold}, {confidence}, {max_iterations}; "
            "need > 0, between 0 and 1, >= 1"
        )
    limit = threshold**2
    search = _SEARCHES[Score(score)](model, limit)
    most_drawn = max_iterations * search.draws_for_each
    needed = most_drawn
    drawn = scored = 0
    for samples in draw_samples(sampler, model.count, model.sample_size, rng, search.largest_batch):
        samples = samples[: most_drawn - drawn]
        drawn += len(samples)
        hypotheses = model.generate(samples)
        scored += len(hypotheses)
        if len(hypotheses) and search.improve(hypotheses):
            share = _inlier_share(search.errors <= limit, model.sample_size, Sampler(sampler))
            needed = min(needed, iterations_needed(share, model.sample_size, confidence))
        if drawn >= min(needed, most_drawn) or scored >= max_iterations:
            break
    inlier_mask = search.errors <= limit
    found = int(np.count_nonzero(inlier_mask))
    wanted = max(min_inliers, model.sample_size + 1)
    if search.best is None or found < wanted:
        raise NoConsensus(
            f"inliers: {found} of {model.count} within {threshold:g}{unit} after {drawn} samples; need {wanted}",
            inliers=found,
        )
    return Consensus(search.best, inlier_mask, drawn)


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


def _inlier_share(inliers: Mask, sample_size: int, sampler: Sampler) -> float:
    """Return the share of inliers; for PROSAC the highest among the best n points, for any n with more than chance.

    Samples come from the best points, so that it is their share that counts (Chum & Matas 2005, section 2.2).
    """
    if sampler is Sampler.UNIFORM:
        return float(inliers.mean())
    found = np.cumsum(inliers)
    n = np.arange(1, len(inliers) + 1)
    by_chance = _BY_CHANCE * n
    sure = found >= sample_size + by_chance + 3 * np.sqrt(by_chance) + _SUPPORT
    sure[-1] = True
    return float((found[sure] / n[sure]).max())


class _Search:
    """The best hypothesis so far."""

    def __init__(self, model: RobustModel, limit: float) -> None:
        self.model = model
        self.limit = limit
        self.best: Floats | None = None
        self.errors = np.zeros(0)
        self.cost = math.inf

    def _take(self, hypotheses: Floats, errors: Floats, costs: Floats) -> bool:
        winner = int(np.argmin(costs))
        if not costs[winner] < self.cost:
            return False
        self.best, self.errors, self.cost = hypotheses[winner], errors[winner], float(costs[winner])
        return True


class _TruncatedSearch(_Search):
    """Each new best hypothesis is refitted to its inliers as long as the cost falls."""

    draws_for_each = 1
    largest_batch = 128

    def improve(self, hypotheses: Floats) -> bool:
        """Whether a hypothesis of the batch is better than all before."""
        if not self._consider(hypotheses):
            return False
        for _ in range(_LOCAL_STEPS):
            assert self.best is not None
            try:
                candidate = self.model.refit(self.best, self.errors <= self.limit)
            except EstimationError:
                break
            if not self._consider(candidate[None]):
                break
        return True

    def _consider(self, hypotheses: Floats) -> bool:
        errors = self.model.squared_errors(hypotheses)
        return self._take(hypotheses, errors, np.minimum(errors, self.limit).sum(axis=1))


class _BiweightSearch(_Search):
    """The most promising hypotheses of each batch are fitted by weights that narrow down."""

    draws_for_each = 10
    largest_batch = 2048

    def __init__(self, model: RobustModel, limit: float) -> None:
        super().__init__(model, limit)
        self._reach = limit * _REACH**2

    def improve(self, hypotheses: Floats) -> bool:
        """Whether a hypothesis of the batch is better than all before."""
        errors = self.model.squared_errors(hypotheses)
        costs = self._costs(errors)
        promising = np.argsort(costs, kind="stable")[:_PROMISING]
        hypotheses, errors = hypotheses[promising], errors[promising]
        better = self._take(hypotheses, errors, costs[promising])
        for share in _ANNEALING:
            hypotheses = self._refitted(hypotheses, (1 - np.minimum(errors / (self._reach * share**2), 1)) ** 2)
            if not len(hypotheses):
                break
            errors = self.model.squared_errors(hypotheses)
            better |= self._take(hypotheses, errors, self._costs(errors))
        return better

    def _costs(self, errors: Floats) -> Floats:
        left = 1 - np.minimum(errors / self._reach, 1)
        return np.asarray((1 - left * left * left).sum(axis=1), np.float64)

    def _refitted(self, hypotheses: Floats, weights: Floats) -> Floats:
        if isinstance(self.model, WeightedModel):
            return self.model.refit_weighted(hypotheses, weights)
        fitted = []
        for hypothesis, inliers in zip(hypotheses, weights > 0.25, strict=True):
            try:
                fitted.append(self.model.refit(hypothesis, inliers))
            except EstimationError:
                continue
        return np.array(fitted)


_SEARCHES: dict[Score, Callable[[RobustModel, float], _TruncatedSearch | _BiweightSearch]] = {
    Score.TRUNCATED: _TruncatedSearch,
    Score.BIWEIGHT: _BiweightSearch,
}
