# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.keypoints.spreading import spread


def cells_of(xy, size, count):
    """The grid that the docstring describes: square cells, about half as many as wanted points."""
    side = math.sqrt(size[0] * size[1] / max(1, count // 2))
    return [(math.floor(x / side), math.floor(y / side)) for x, y in xy]


@given(st.integers(0, 2**32), st.integers(1, 120), st.integers(1, 60))
def test_turns_among_cells(seed, n, count):
    rng = np.random.default_rng(seed)
    size = (int(rng.integers(1, 300)), int(rng.integers(1, 300)))
    xy = rng.random((n, 2)) * (np.array(size) - 1)
    response = rng.permutation(n).astype(float)
    kept = spread(xy, response, size, count)
    assert len(kept) == min(n, count) == len(set(kept.tolist()))
    assert (np.diff(response[kept]) < 0).all()
    # The strongest half, then turns among the cells, one point at a time, strongest first within a turn.
    cells = cells_of(xy, size, count)
    seen, turn = {}, {}
    for index in np.argsort(-response):
        turn[int(index)] = seen.get(cells[index], 0)
        seen[cells[index]] = turn[int(index)] + 1
    half = set(np.argsort(-response)[: count // 2].tolist())
    expected = sorted(range(n), key=lambda i: (i not in half, turn[i], -response[i]))[:count]
    assert set(kept.tolist()) == set(expected)


def test_best_of_each_cell_comes_before_any_second():
    # A crowd of 100 strong points in one place, and 100 weak ones all over: of 100 wanted, half are the strongest,
    # the rest come one from each of the 50 or so cells.
    grid = np.array([[x, y] for y in range(5, 100, 10) for x in range(5, 100, 10)], float)
    crowd = np.array([[50.0 + i / 100, 50.0] for i in range(100)])
    response = np.r_[np.full(100, 9.0) + np.arange(100), np.ones(100)]
    kept = spread(np.vstack([crowd, grid]), response, (100, 100), 100)
    assert kept[0] == 99 and set(range(50, 100)) <= set(kept.tolist())
    cells = cells_of(grid, (100, 100), 100)
    weak = {cells[i - 100] for i in kept[kept >= 100]}
    assert weak >= set(cells) - set(cells_of(crowd, (100, 100), 100))


def test_order_of_equal_responses_is_the_reading_order():
    xy = np.array([[3.0, 1], [1, 1], [2, 0]])
    assert spread(xy, np.ones(3), (4, 4), 3).tolist() == [2, 1, 0]
    assert spread(xy[[2, 0, 1]], np.ones(3), (4, 4), 3).tolist() == [0, 2, 1]


def test_points_beyond_the_border_and_plain_lists():
    kept = spread([[-0.4, 5], [9.4, 3], [1e300, 2]], [1, 3, 2], (10, 10), 2)
    assert len(kept) == 2
    assert spread([[0, 0], [1, 1]], np.array([0, 200], np.uint8), (2, 2), 5).tolist() == [1, 0]
    assert spread(np.zeros((0, 2)), np.zeros(0), (5, 5), 3).shape == (0,)


@pytest.mark.parametrize(
    ("xy", "response", "size", "count"),
    [
        ([[0, 0]], [1, 2], (5, 5), 1),
        ([[0, 0]], [np.nan], (5, 5), 1),
        ([[np.nan, 0]], [1], (5, 5), 1),
        ([[0, 0, 0]], [1], (5, 5), 1),
        ([[0, 0]], [1], (0, 5), 1),
        ([[0, 0]], [1], (5, 5), 0),
    ],
)
def test_bad_input_is_refused(xy, response, size, count):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        spread(xy, response, size, count)
