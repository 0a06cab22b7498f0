# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.matching import gallery as places
from imgu_ros.vision.matching.gallery import find_places


@given(st.integers(0, 2**32).map(np.random.default_rng), st.integers(0, 30), st.sampled_from([0, 2.5, 3.0]))
def test_against_loops(rng, count, radius):
    xy = rng.integers(0, 12, (count, 2)) / 1.0  # whole numbers: many exactly at the edge
    asked = rng.integers(0, count, 20 if count else 0)
    expected = [(k, j) for k, i in enumerate(asked) for j in range(count) if max(abs(xy[i] - xy[j])) <= radius]
    for most in (2**22, 0):  # kept, or compared anew
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(places, "_MOST_PAIRS", most)
            found = find_places(xy, radius)
        got = found.at(asked)
        assert list(zip(got.asked.tolist(), got.point.tolist(), strict=True)) == expected
        assert (found.near is None) == (most == 0 and count > 0)


@pytest.mark.parametrize(
    ("xy", "radius"),
    [(np.zeros((2, 3)), 1.0), ([[np.nan, 0]], 1.0), ([[1e301, 0]], 1.0), ([[0, 0]], -1), ([[0, 0]], np.nan)],
)
def test_bad_arguments_are_refused(xy, radius):
    with pytest.raises(ShapeError, match="need"):
        find_places(xy, radius)
