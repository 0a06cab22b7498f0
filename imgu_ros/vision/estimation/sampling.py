# SPDX-License-Identifier: Apache-2.0
"""Which points go into each minimal sample: uniform, or best first (PROSAC)."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from imgu_ros.arguments import as_generator, as_integer
from imgu_ros.errors import ShapeError, TooFewPoints
from imgu_ros.types import Choice, Indices


class Sampler(Choice):
    """Ways to draw minimal samples."""

    UNIFORM = "uniform"
    PROSAC = "prosac"


#: Samples in the first batch: an easy problem should not pay for a hard one's batches.
FIRST_BATCH = 16


def draw_samples(
    sampler: Sampler | str, count: int, sample_size: int, rng: np.random.Generator | int, largest_batch: int = 128
) -> Iterator[Indices]:
    """Draw samples of different points without end, in batches that double from FIRST_BATCH to the largest.

    Parameters
    ----------
    sampler : uniform, or prosac: the points are sorted best first, and samples come from a slowly growing
        set of the best (Chum & Matas 2005, equations 3 to 5; IU 7.6)
    count : number of points N
    sample_size : points in a sample m
    rng : source of the draws, or its seed
    largest_batch : maximum number of samples drawn at once

    Yields
    ------
    (B, m) indices

    Raises
    ------
    TooFewPoints
        If N < m.
    ShapeError
        If m < 1, or the sampler is unknown.

    Examples
    --------
    >>> samples = next(draw_samples("prosac", 100, 4, np.random.default_rng(0)))
    >>> sorted(samples[0].tolist())  # the best four first
    [0, 1, 2, 3]
    """
    count = as_integer(count, "count")
    sample_size = as_integer(sample_size, "sample_size")
    largest_batch = as_integer(largest_batch, "largest_batch")
    rng = as_generator(rng)
    if sample_size < 1 or largest_batch < 1:
        raise ShapeError(f"sample_size, largest_batch: {sample_size}, {largest_batch}; need at least 1")
    if count < sample_size:
        raise TooFewPoints(f"points: {count}; need at least {sample_size}")
    if Sampler(sampler) is Sampler.UNIFORM:
        return _uniform(count, sample_size, rng, largest_batch)
    return _prosac(count, sample_size, rng, largest_batch)


def _batches(largest: int) -> Iterator[int]:
    size = FIRST_BATCH
    while True:
        yield size
        size = min(2 * size, largest)


def _uniform(count: int, size: int, rng: np.random.Generator, largest: int) -> Iterator[Indices]:
    for batch in _batches(largest):
        yield _distinct(np.full(batch, count), size, rng)


def _prosac(count: int, size: int, rng: np.random.Generator, largest: int, horizon: int = 200_000) -> Iterator[Indices]:
    # T_n: expected number of the `horizon` uniform samples that come from the best n points only;
    # growth[n]: the number of draws after which the set grows beyond n.
    expected = float(horizon)
    for i in range(size):
        expected *= (size - i) / (count - i)
    grown = 1
    n = size
    drawn = 0
    for batch in _batches(largest):
        pools = np.empty(batch, np.intp)
        newest = np.zeros(batch, bool)
        for b in range(batch):
            drawn += 1
            while drawn > grown and n < count:
                following = expected * (n + 1) / (n + 1 - size)
                grown += max(1, math.ceil(following - expected))
                expected = following
                n += 1
            pools[b] = n
            # Until the whole set is reached the newest point is in every sample.
            newest[b] = drawn <= grown and n > size
        samples = _distinct(pools - newest, size, rng)
        samples[newest, -1] = pools[newest] - 1
        yield samples


def _distinct(pools: Indices, size: int, rng: np.random.Generator) -> Indices:
    """Draw `size` different integers below each pool's size; pools hold at least size - 1 besides the last column."""
    samples = np.empty((len(pools), size), np.intp)
    for column in range(size):
        # Draw from what is left, then step over the values already taken, in ascending order.
        left = np.maximum(pools - column, 1)
        value = (rng.random(len(pools)) * left).astype(np.intp)
        taken = np.sort(samples[:, :column], axis=1)
        for k in range(column):
            value += value >= taken[:, k]
        samples[:, column] = value
    return samples
