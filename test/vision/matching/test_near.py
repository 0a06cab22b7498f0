# SPDX-License-Identifier: Apache-2.0
"""Pairs of near points against every pair compared with every other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.matching.near import near_pairs

WHOLE = st.lists(st.tuples(st.integers(-6, 6), st.integers(-6, 6)), max_size=25)


def all_pairs(a: np.ndarray, b: np.ndarray, radius: float) -> list[list[int]]:
    apart = np.abs(a[:, None] - b).max(axis=2) if len(a) and len(b) else np.zeros((len(a), len(b)))
    return np.argwhere(apart <= radius).tolist()


@given(WHOLE, WHOLE, st.integers(0, 8), st.sampled_from([1.0, 0.1, 1e-200, 1e290]))
def test_pairs_are_those_of_exhaustive_comparison_in_order(a, b, radius, scale):
    # Whole numbers put many points at exactly the radius, and on the edges of cells.
    a_xy, b_xy = (np.array(points, float).reshape(-1, 2) * scale for points in (a, b))
    pairs = near_pairs(a_xy, b_xy, radius * scale)
    assert np.column_stack((pairs.a, pairs.b)).tolist() == all_pairs(a_xy, b_xy, radius * scale)


def test_many_points_in_several_goes_agree_with_exhaustive_comparison():
    rng = np.random.default_rng(1)
    a_xy, b_xy = rng.uniform(0, 20, (1500, 2)), rng.uniform(0, 20, (1200, 2))
    pairs = near_pairs(a_xy, b_xy, 9.0)
    assert len(pairs.a) > 2**18  # more candidates than are compared at once
    assert np.column_stack((pairs.a, pairs.b)).tolist() == all_pairs(a_xy, b_xy, 9.0)


def test_more_pairs_than_wanted_are_not_made():
    # All of them would take 20 GB.
    assert near_pairs(np.zeros((50_000, 2)), np.zeros((50_000, 2)), 1.0, most=10**6) is None
    assert len(near_pairs(np.zeros((30, 2)), np.zeros((30, 2)), 1.0, most=900).a) == 900


@pytest.mark.parametrize(
    ("a_xy", "radius"), [([[0, np.nan]], 1.0), ([[0, 1e301]], 1.0), ([0, 1], 1.0), ([[0, 0]], -1.0), ([[0, 0]], np.inf)]
)
def test_bad_input_is_refused(a_xy, radius):
    with pytest.raises(ShapeError, match="a_xy|radius_px"):
        near_pairs(a_xy, [[0.0, 0.0]], radius)
