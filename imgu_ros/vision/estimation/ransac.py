"""Random sample consensus for any model (notes 7.5; Fischler & Bolles 1981; HZ section 4.7).

Hypotheses are generated and scored in batches. The score is the truncated sum of squares (MSAC, Torr & Zisserman
2000), and each new best hypothesis is refitted to its own inliers (LO-RANSAC, Chum, Matas & Kittler 2003).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imgu_ros.errors import EstimationError, NoConsensus, ShapeError
from imgu_ros.types import Floats, Indices, Mask
from imgu_ros.vision.estimation.sampling import Sampler, draw_samples

_LOCAL_STEPS = 4


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
    rng: np.random.Generator,
    *,
    sampler: Sampler | str = Sampler.UNIFORM,
    confidence: float = 0.9999,
    max_iterations: int = 2000,
    min_inliers: int = 0,
    unit: str = "",
) -> Consensus:
    """Find the hypothesis with the smallest truncated squared error.

    Parameters
    ----------
    model : see `RobustModel`
    threshold : largest error of an inlier, in the unit of the model's errors
    rng : source of the draws
    sampler : uniform, or prosac when the points are sorted best first
    confidence : stop when a better sample than the best would have been drawn with this probability
    max_iterations : most samples
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
    """
    if not (threshold > 0 and 0 < confidence < 1 and max_iterations >= 1):
        raise ShapeError(
            f"threshold, confidence, max_iterations: {threshold}, {confidence}, {max_iterations}; "
            "need > 0, between 0 and 1, >= 1"
        )
    limit = threshold**2
    best: Floats | None = None
    best_errors = np.zeros(0)
    best_cost = math.inf
    needed = max_iterations
    drawn = 0
    for samples in draw_samples(sampler, model.count, model.sample_size, rng):
        samples = samples[: max_iterations - drawn]
        drawn += len(samples)
        hypotheses = model.generate(samples)
        if len(hypotheses):
            errors = model.squared_errors(hypotheses)
            costs = np.minimum(errors, limit).sum(axis=1)
            winner = int(np.argmin(costs))
            if costs[winner] < best_cost:
                best, best_errors, best_cost = hypotheses[winner], errors[winner], float(costs[winner])
                best, best_errors, best_cost = _polished(model, best, best_errors, best_cost, limit)
                inliers = int(np.count_nonzero(best_errors <= limit))
                needed = min(needed, iterations_needed(inliers / model.count, model.sample_size, confidence))
        if drawn >= min(needed, max_iterations):
            break
    inlier_mask = best_errors <= limit
    found = int(np.count_nonzero(inlier_mask))
    wanted = max(min_inliers, model.sample_size + 1)
    if best is None or found < wanted:
        raise NoConsensus(
            f"inliers: {found} of {model.count} within {threshold:g}{unit} after {drawn} samples; need {wanted}"
        )
    return Consensus(best, inlier_mask, drawn)


def iterations_needed(inlier_share: float, sample_size: int, confidence: float) -> int:
    """Return how many samples give one free of outliers with the wanted probability (HZ equation 4.18).

    K = log(1 - p) / log(1 - r^m); 1 when all points are inliers, and 2^62 when none is.
    """
    good = inlier_share**sample_size
    if good >= 1:
        return 1
    if good < 1e-15:
        return 2**62
    return max(1, math.ceil(math.log(1 - confidence) / math.log1p(-good)))


def _polished(
    model: RobustModel, best: Floats, errors: Floats, cost: float, limit: float
) -> tuple[Floats, Floats, float]:
    """Refit to the inliers as long as the cost falls."""
    for _ in range(_LOCAL_STEPS):
        try:
            candidate = model.refit(best, errors <= limit)
        except EstimationError:
            break
        new_errors = model.squared_errors(candidate[None])[0]
        new_cost = float(np.minimum(new_errors, limit).sum())
        if not new_cost < cost:
            break
        best, errors, cost = candidate, new_errors, new_cost
    return best, errors, cost
