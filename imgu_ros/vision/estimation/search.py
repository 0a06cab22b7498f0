# SPDX-License-Identifier: Apache-2.0
"""What a search of `ransac` minimises, and how it betters a hypothesis."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from imgu_ros.errors import EstimationError, NoConsensus
from imgu_ros.types import Choice, Floats, Indices, Mask
from imgu_ros.vision.estimation.chance import Agreement, ChanceModel

#: Most refits of a new best hypothesis to its own inliers. Measured: benchmarks/thresholds.py, study consensus.
_LOCAL_STEPS = 4
#: Width of the biweight, in thresholds: a threshold that is a little wrong then does little harm. Measured:
#: benchmarks/thresholds.py, study consensus.
_REACH = 8 / 3
#: Widths of the successive weighted fits, in that of the score: the errors of a minimal sample grow away from it.
#: Measured: benchmarks/thresholds.py, study consensus.
_ANNEALING = (2.0, 1.4, 1.0, 1.0, 1.0, 1.0)
#: Number of hypotheses of each batch that are refitted by weights. Measured: benchmarks/thresholds.py, study consensus.
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
        """Minimum number of points that determine the model."""

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


class _Search:
    """The best hypothesis so far; each datum's cost counts by its share of its place."""

    def __init__(self, model: RobustModel, limit: float, shares: Floats) -> None:
        self.model = model
        self.limit = limit
        self.shares = shares
        self.best: Floats | None = None
        self.errors = np.zeros(0)
        self.cost = math.inf

    def consensus(self, drawn: int) -> Consensus:
        """Return the best hypothesis, after so many samples."""
        assert self.best is not None
        return Consensus(self.best, self.errors <= self.limit, drawn)

    def failure(self, wanted: int, tested: int, max_by_chance: float, drawn: int, unit: str) -> NoConsensus | None:
        """Return why the best hypothesis is no answer; None when it is one.

        Parameters
        ----------
        wanted : inliers of an answer
        tested : hypotheses, of which wrong data may give `max_by_chance` as good ones; inf: chance is not asked
        drawn, unit : samples so far, and unit of the threshold, for the message
        """
        model, threshold = self.model, math.sqrt(self.limit)
        found = int(np.count_nonzero(self.errors <= self.limit))
        if self.best is None or found < wanted:
            return NoConsensus(
                f"inliers: {found} of {model.count} within {threshold:g}{unit} after {drawn} samples; need {wanted}",
                inliers=found,
            )
        if not isinstance(model, ChanceModel) or not math.isfinite(max_by_chance):
            return None
        probability = model.agreement_probability(self.best, threshold)
        ratios = np.sqrt(self.errors) / threshold
        agreement = Agreement(self.shares, ratios, model.sample_size, model.codimension, probability)
        if agreement.expected_by_chance(tested) <= max_by_chance:
            return None
        return NoConsensus(_by_chance(agreement, found, tested, max_by_chance, f"{threshold:g}{unit}"), inliers=found)

    def consider(self, hypotheses: Floats) -> bool:
        """Whether one of the hypotheses, as it is, is better than all before, by the truncated score."""
        errors = self.model.squared_errors(hypotheses)
        return self._take(hypotheses, errors, np.minimum(errors, self.limit) @ self.shares)

    def _take(self, hypotheses: Floats, errors: Floats, costs: Floats) -> bool:
        winner = int(np.argmin(costs))
        if not costs[winner] < self.cost:
            return False
        self.best, self.errors, self.cost = hypotheses[winner], errors[winner], float(costs[winner])
        return True


def _by_chance(agreement: Agreement, found: int, tested: int, expected: float, threshold: str) -> str:
    """Return the reason in the user's terms."""
    count = len(agreement.shares)
    alike = float(agreement.shares[agreement.ratios <= 1].sum())
    places = "" if found - alike < 0.5 else f", at {alike:.0f} different places"
    needed = agreement.needed(tested, expected)
    more = f"need {needed}" if needed <= count else "need a smaller threshold, or more that agree"
    return f"inliers: {found} of {count} within {threshold}{places}: as many agree by chance; {more}"


class _TruncatedSearch(_Search):
    """Each new best hypothesis is refitted to its inliers as long as the cost falls."""

    draws_for_each = 1
    largest_batch = 128

    def improve(self, hypotheses: Floats) -> bool:
        """Whether a hypothesis of the batch is better than all before."""
        if not self.consider(hypotheses):
            return False
        self._refit_to_inliers()
        return True

    def finish(self) -> None:
        """Fit the best hypothesis by weights that narrow down: what a poor sample gave takes in all that agrees."""
        if self.best is None or not isinstance(self.model, WeightedModel):
            return
        hypotheses, errors = self.best[None], self.errors[None]
        for share in _ANNEALING:
            reach = self.limit * (_REACH * share) ** 2
            hypotheses = self.model.refit_weighted(hypotheses, (1 - np.minimum(errors / reach, 1)) ** 2)
            if not len(hypotheses):
                return
            errors = self.model.squared_errors(hypotheses)
        if self.consider(hypotheses):
            self._refit_to_inliers()

    def _refit_to_inliers(self) -> None:
        for _ in range(_LOCAL_STEPS):
            assert self.best is not None
            try:
                candidate = self.model.refit(self.best, self.errors <= self.limit)
            except EstimationError:
                break
            if not self.consider(candidate[None]):
                break


class _BiweightSearch(_Search):
    """The most promising hypotheses of each batch are fitted by weights that narrow down."""

    draws_for_each = 10
    largest_batch = 2048

    def __init__(self, model: RobustModel, limit: float, shares: Floats) -> None:
        super().__init__(model, limit, shares)
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

    def finish(self) -> None:
        """Nothing is left to do: every batch's best were fitted by weight."""

    def _costs(self, errors: Floats) -> Floats:
        left = 1 - np.minimum(errors / self._reach, 1)
        return np.asarray((1 - left * left * left) @ self.shares, np.float64)

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


SEARCHES: dict[Score, Callable[[RobustModel, float, Floats], _TruncatedSearch | _BiweightSearch]] = {
    Score.TRUNCATED: _TruncatedSearch,
    Score.BIWEIGHT: _BiweightSearch,
}

#: What a score's search is.
Search = _TruncatedSearch | _BiweightSearch
