# SPDX-License-Identifier: Apache-2.0
"""Whether a consensus is more than chance: how many equally good ones wrong data are expected to give.

An a-contrario test (Moisan & Stival 2004; Moisan, Moulon & Monasse 2012; Lowe 2004 counts alike). A sample of m data
always agrees with its own hypothesis. Each of the other n - m agrees by chance with a probability p, which a model
tells for the data at hand (`ChanceModel`). Of the hypotheses tested on wrong data,

    tested x P(Binomial(n - m, p) >= k - m)

are expected to find k of n data in agreement. Data at one place say one thing: n that lie within the
threshold of each other count as one. The test is repeated with half, a quarter, ... of the threshold, each time with
half the share of the false alarms: true data often agree much better than the threshold asks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, as_floats, require_finite

#: A fit to the agreeing data explores hypotheses near the one it starts from: each counts as this many. With `_WIDER`,
#: random pairs are accepted no more often than asked for, also in `benchmarks/robust_homography.py`. Measured:
#: benchmarks/thresholds.py, study chance.
_NEARBY = 3.0
#: And the threshold counts as this many times as wide. Measured: benchmarks/thresholds.py, study chance.
_WIDER = 2.0
#: Number of halvings of the threshold that are tried: down to 1e-7 of it.
_HALVINGS = 24
#: Number of wrong pairs within a radius from which their density is estimated, to 20 %.
_ENOUGH_PAIRS = 30
#: Number of mapped points that are compared with all others: bounds time and memory.
_MOST_MAPPED = 256
#: Number of doublings of the radius: up to 1e19 thresholds.
_DOUBLINGS = 64
#: Squares of larger numbers, summed, overflow.
_LARGEST = 1e100
#: More data than this are no matches of two images.
_MOST_TRIALS = 1_000_000


@runtime_checkable
class ChanceModel(Protocol):
    """A model for `ransac` that can tell how likely wrong data agree with a hypothesis."""

    @property
    def codimension(self) -> int:
        """Coordinates of an error: 2 for a distance between points of an image, 1 for one from a line."""

    def shares(self, threshold: float) -> Floats:
        """Return what each datum counts, (N,): 1 for one alone, 1/n for n that lie within the threshold.

        Lest a hypothesis that maps everything onto one place looks good where many lie there, and copies are counted.
        """

    def agreement_probability(self, hypothesis: Floats, threshold: float) -> float:
        """Return the probability that a wrong datum agrees with one hypothesis within the threshold."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """What agrees with one hypothesis.

    Attributes
    ----------
    shares : (N,) what each datum counts
    ratios : (N,) errors over the threshold
    sample_size : data that determine a hypothesis
    codimension : coordinates of an error
    probability : that a wrong datum agrees within the threshold
    """

    shares: Floats
    ratios: Floats
    sample_size: int
    codimension: int
    probability: float

    def expected_by_chance(self, tested: int) -> float:
        """Return how many hypotheses of so many tested agree as well with wrong data; well below 1: it is no chance."""
        fewest = math.inf
        for halvings in range(_HALVINGS):
            # Rounded down, save for the rounding of the sum itself.
            agreeing = math.floor(float(self.shares[self.ratios <= 0.5**halvings].sum()) + 1e-6)
            if agreeing <= self.sample_size:
                break
            fewest = min(fewest, 2.0 ** (halvings + 1) * self._tail(agreeing, halvings))
        return self._hypotheses(tested) * fewest

    def needed(self, tested: int, expected: float) -> int:
        """Return how many data must agree within the threshold for at most so many expected by chance; N + 1: never."""
        for agreeing in range(self.sample_size + 1, self._count + 1):
            if self._hypotheses(tested) * 2 * self._tail(agreeing, 0) <= expected:
                return agreeing
        return self._count + 1

    @property
    def _count(self) -> int:
        return math.ceil(float(self.shares.sum()) - 1e-6)

    def _hypotheses(self, tested: int) -> float:
        """Small sets have few samples, however often they are drawn."""
        return _NEARBY * min(tested, math.comb(max(self._count, self.sample_size), self.sample_size))

    def _tail(self, agreeing: int, halvings: int) -> float:
        probability = min(1.0, self.probability * (_WIDER * 0.5**halvings) ** self.codimension)
        return binomial_tail(self._count - self.sample_size, agreeing - self.sample_size, probability)


def binomial_tail(count: int, successes: int, probability: float) -> float:
    """Return the probability of at least so many successes in `count` trials that each succeed with `probability`.

    Raises
    ------
    ShapeError
        If the probability is not 0 to 1, or there are more than a million trials.

    Examples
    --------
    >>> round(binomial_tail(3, 2, 0.5), 12)
    0.5
    """
    count, successes = as_integer(count, "count"), as_integer(successes, "successes")
    probability = as_number(probability, "probability")
    if not 0 <= probability <= 1:
        raise ShapeError(f"probability: {probability!r}; need 0 to 1")
    if count > _MOST_TRIALS:
        raise ShapeError(f"count: {count}; need at most {_MOST_TRIALS}")
    if successes <= 0:
        return 1.0
    if successes > count or probability == 0:
        return 0.0
    if probability == 1:
        return 1.0
    odds = math.log(probability) - math.log1p(-probability)
    log_first = (
        math.lgamma(count + 1)
        - math.lgamma(successes + 1)
        - math.lgamma(count - successes + 1)
        + successes * odds
        + count * math.log1p(-probability)
    )
    k = np.arange(successes, count)
    logs = log_first + np.concatenate(([0.0], np.cumsum(np.log((count - k) / (k + 1)) + odds)))
    peak = float(logs.max())
    return min(1.0, math.exp(peak) * float(np.exp(logs - peak).sum()))


def pair_probability(mapped: Floats, measured: Floats, threshold: float) -> float:
    """Return the probability that a wrong pair lies within the threshold, as wrong pairs of these very points do.

    Where few of them do, their density in the smallest wider circle that holds some tells it.

    Parameters
    ----------
    mapped, measured : (N, D) each; row n of both is a pair, every other two rows a wrong one; D = 2, or 3 on a sphere
    threshold : largest distance

    Raises
    ------
    ShapeError
        If the arrays do not fit each other or hold numbers that are not finite or too large, or the threshold is not
        positive.

    Examples
    --------
    >>> square = np.array([[0, 0], [100, 0], [100, 100], [0, 100]], float)
    >>> 1e-5 < pair_probability(square, square, 1.0) < 1e-3  # pi / 100^2 within a factor
    True
    """
    threshold = as_number(threshold, "threshold")
    mapped, measured = _places(mapped, "mapped"), _places(measured, "measured")
    if mapped.shape != measured.shape or not 1 / _LARGEST < threshold < _LARGEST:
        raise ShapeError(
            f"mapped, measured, threshold: shapes {mapped.shape}, {measured.shape}, {threshold!r}; need equal ones, > 0"
        )
    count = len(measured)
    if count < 2:
        return 1.0
    # Every k-th in the order of their places: the same ones however the pairs are sorted.
    step = -(-count // _MOST_MAPPED)
    few = np.lexsort(mapped.T)[step // 2 :: step]
    with np.errstate(over="ignore", invalid="ignore"):
        squared = ((mapped[few, None] - measured[None]) ** 2).sum(axis=2) / threshold**2
    squared[np.arange(len(few)), few] = np.inf
    limits = 4.0 ** np.arange(_DOUBLINGS)
    within = np.searchsorted(np.sort(squared, axis=None), limits, side="right")
    pairs = len(few) * (count - 1)
    enough = int(np.argmax(within >= min(_ENOUGH_PAIRS, pairs)))
    # Beyond all circles only where some pairs are further than any image: then those that are near tell it.
    return float(max(within[enough], 1) / pairs / limits[enough])


def shares_of_places(points: Floats, size: float) -> Floats:
    """Return 1 / (number of points within `size` of each, itself included), (N,).

    Parameters
    ----------
    points : (N, D), D >= 1
    size : >= 0

    Raises
    ------
    ShapeError
        If the points have another shape, or a number is not finite or too large.

    Examples
    --------
    >>> shares_of_places(np.array([[0, 0], [1, 0], [9, 9]]), 2.0).tolist()
    [0.5, 0.5, 1.0]
    """
    size = as_number(size, "size")
    points = _places(points, "points")
    if not 0 <= size < _LARGEST:
        raise ShapeError(f"size: {size!r}; need >= 0")
    if len(points) < 2:
        return np.ones(len(points))
    # Sorted along the axis on which they spread most, each needs comparing with a few that follow only.
    low, high = np.percentile(points, (25, 75), axis=0)
    along = int(np.argmax(high - low))
    order = np.argsort(points[:, along], kind="stable")
    ordered = points[order]
    near = np.ones(len(points))
    for apart in range(1, len(points)):
        away = ordered[apart:] - ordered[:-apart]
        if away[:, along].min() > size:
            break
        close = np.einsum("nd,nd->n", away, away) <= size**2
        near[apart:] += close
        near[:-apart] += close
    shares = np.empty(len(points))
    shares[order] = 1 / near
    return shares


def _places(points: Floats, name: str) -> Floats:
    points = as_floats(points, name)
    if points.ndim != 2 or not points.shape[1]:
        raise ShapeError(f"{name}: shape {points.shape}; need (N, D)")
    points = require_finite(points, name)
    if not np.abs(points).max(initial=0) < _LARGEST:
        raise ShapeError(f"{name}: up to {np.abs(points).max():g}; need less than {_LARGEST:g}")
    return points
