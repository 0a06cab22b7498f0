# SPDX-License-Identifier: Apache-2.0
"""Minimal samples: distinct, uniform, and PROSAC's order."""

import itertools

import numpy as np
import pytest

from imgu_ros.errors import TooFewPoints
from imgu_ros.vision.estimation.sampling import draw_samples


@pytest.mark.parametrize("sampler", ["uniform", "prosac"])
@pytest.mark.parametrize("count", [4, 5, 50])
def test_points_of_a_sample_differ(sampler: str, count: int) -> None:
    draws = draw_samples(sampler, count, 4, np.random.default_rng(0))
    for samples in itertools.islice(draws, 20):
        assert samples.shape[1] == 4
        assert samples.min() >= 0
        assert samples.max() < count
        assert all(len(set(row)) == 4 for row in samples.tolist())


def test_uniform_samples_are_uniform() -> None:
    samples = np.concatenate(list(itertools.islice(draw_samples("uniform", 6, 3, np.random.default_rng(1)), 200)))
    samples = samples[:20_000]
    counts = np.bincount(np.sort(samples, axis=1) @ [36, 6, 1])
    counts = counts[counts > 0]
    assert len(counts) == 20  # all subsets of 3 of 6
    assert abs(counts - 1000).max() < 5 * np.sqrt(1000)


def test_prosac_starts_with_the_best_and_grows_to_all() -> None:
    draws = draw_samples("prosac", 100, 4, np.random.default_rng(2))
    samples = np.concatenate(list(itertools.islice(draws, 30)))[:3000]
    assert sorted(samples[0].tolist()) == [0, 1, 2, 3]
    largest = [max(s) for s in samples]
    # The newest point is in each sample: the set of the best grows monotonically, one point after the other.
    assert np.all(np.diff(np.maximum.accumulate(largest)) <= 1)
    assert max(largest[:50]) < 30
    assert max(largest) > 30


def test_prosac_becomes_uniform_in_the_end() -> None:
    draws = draw_samples("prosac", 8, 4, np.random.default_rng(3))
    samples = np.concatenate([next(draws) for _ in range(3200)])[-100_000:]
    share = np.bincount(samples.ravel(), minlength=8) / len(samples)
    assert np.abs(share - 0.5).max() < 0.02


def test_too_few_points() -> None:
    with pytest.raises(TooFewPoints, match="3"):
        draw_samples("uniform", 3, 4, np.random.default_rng(0))
