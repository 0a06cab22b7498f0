# SPDX-License-Identifier: Apache-2.0
"""The cross ratio of points and of lines."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.projective.cross_ratio import cross_ratio, cross_ratio_of_lines
from imgu_ros.vision.projective.points_and_lines import (
    join,
    meet,
    points_at_infinity,
    transform_lines,
    transform_points,
)
from imgu_ros.vision.projective.transform import transform
from imgu_ros.vision.projective.transformations import projective

seeds = st.integers(0, 2**32 - 1)


def _positions(rng: np.random.Generator) -> np.ndarray:
    """Four different positions on a line, in any order."""
    return np.asarray(rng.permutation(10)[:4] + rng.uniform(0, 0.5, 4))


def _by_definition(s: np.ndarray) -> float:
    a, b, c, d = s
    return (c - a) * (d - b) / ((c - b) * (d - a))  # type: ignore[no-any-return]


def _homography(rng: np.random.Generator) -> np.ndarray:
    """A camera's view of a plane of about 1000 px."""
    A = rng.normal(size=(2, 2)) + 3 * np.eye(2)
    return projective(A, rng.uniform(-100, 100, 2), rng.uniform(-4e-4, 4e-4, 2))


def _points(rng: np.random.Generator, s: np.ndarray) -> np.ndarray:
    start, direction = rng.uniform(0, 1000, 2), rng.normal(size=2)
    return np.asarray(start + 20 * s[:, None] * direction)


@given(seed=seeds)
def test_of_points_by_the_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = _positions(rng)
    assert cross_ratio(_points(rng, s)) == pytest.approx(_by_definition(s), rel=1e-9)


@given(seed=seeds)
def test_invariant_under_homographies(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = _points(rng, _positions(rng))
    assert cross_ratio(transform(_homography(rng), points)) == pytest.approx(cross_ratio(points), rel=1e-9)


@given(seed=seeds)
def test_of_lines_is_that_of_the_points_on_any_crossing_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = _positions(rng)
    points, through = _points(rng, s), rng.uniform(0, 1000, (1, 2))
    lines = join(points, through)
    assert cross_ratio_of_lines(lines) == pytest.approx(_by_definition(s), rel=1e-7)
    crossing = join(rng.uniform(0, 1000, (1, 2)), rng.uniform(0, 1000, (1, 2)))
    assert cross_ratio(meet(lines, crossing)) == pytest.approx(_by_definition(s), rel=1e-6)
    moved = transform_lines(_homography(rng), lines)
    assert cross_ratio_of_lines(moved) == pytest.approx(_by_definition(s), rel=1e-6)


@given(seed=seeds)
def test_of_parallel_lines(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s, angle = _positions(rng), rng.uniform(0, 3)
    lines = [[np.cos(angle), np.sin(angle), -500 - 20 * x] for x in s]
    assert cross_ratio_of_lines(lines) == pytest.approx(_by_definition(s), rel=1e-9)


@given(seed=seeds)
def test_the_24_orders_give_six_values(seed: int) -> None:
    """Coxeter: x, 1/x, 1 - x, 1/(1 - x), x/(x - 1), (x - 1)/x."""
    rng = np.random.default_rng(seed)
    points = _points(rng, _positions(rng))
    x = cross_ratio(points)
    six = np.array([x, 1 / x, 1 - x, 1 / (1 - x), x / (x - 1), (x - 1) / x])
    for order in itertools.permutations(range(4)):
        assert np.min(np.abs(six / cross_ratio(points[list(order)]) - 1)) < 1e-6


def test_a_point_at_infinity_leaves_a_simple_ratio() -> None:
    a, b, c = [1, 2], [4, 2], [9, 2]
    rows = np.array([[*a, 1], [*b, 1], [*c, 1], points_at_infinity([[1, 0]])[0]])
    assert cross_ratio(rows) == pytest.approx(8 / 5)  # AC / BC
    assert cross_ratio(transform_points(_homography(np.random.default_rng(0)), rows)) == pytest.approx(8 / 5)
    at_infinity = points_at_infinity([[1, 0], [1, 1], [0, 1], [-1, 1]])
    assert np.isfinite(cross_ratio(at_infinity))


def test_harmonic_and_coincident_points() -> None:
    assert cross_ratio([[0, 0], [6, 0], [2, 0], [-6, 0]]) == pytest.approx(-1)
    assert cross_ratio([[1, 0], [2, 0], [1, 0], [4, 0]]) == pytest.approx(0, abs=1e-15)  # A = C
    assert cross_ratio([[1, 0], [1, 0], [3, 0], [4, 0]]) == pytest.approx(1)  # A = B


def test_noise_is_let_pass_by_the_tolerance() -> None:
    points = np.array([[0, 0.3], [100, -0.2], [200, 0.1], [400, 0]])
    with pytest.raises(DegenerateConfiguration, match="off a common line"):
        cross_ratio(points)
    assert cross_ratio(points, tolerance=0.01) == pytest.approx(1.5, rel=1e-4)


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0], [1, 0], [1, 0], [2, 0]],  # B = C
        [[0, 0], [1, 0], [2, 0], [0, 0]],  # A = D
        [[1, 0], [1, 0], [1, 0], [2, 0]],
        [[5, 5], [5, 5], [5, 5], [5, 5]],
        [[0, 0], [1, 0], [0, 1], [1, 1]],
    ],
)
def test_what_has_no_cross_ratio(points: list[list[float]]) -> None:
    with pytest.raises(DegenerateConfiguration):
        cross_ratio(points)
    with pytest.raises(DegenerateConfiguration):
        cross_ratio_of_lines([[x, y, 1] for x, y in points])


def test_bad_arguments() -> None:
    with pytest.raises(ShapeError, match=r"need \(4, 2\) or \(4, 3\)"):
        cross_ratio([[0, 0], [1, 1], [2, 2]])
    with pytest.raises(ShapeError, match=r"need \(4, 3\)"):
        cross_ratio_of_lines([[0, 0, 1]])
    with pytest.raises(ShapeError, match="tolerance"):
        cross_ratio([[0, 0], [1, 1], [2, 2], [3, 3]], tolerance=2)
    with pytest.raises(ShapeError, match="beyond floats"):
        cross_ratio([[1.7e308, 0], [1.6e308, 0], [1.5e308, 0], [1.2e308, 0]])
