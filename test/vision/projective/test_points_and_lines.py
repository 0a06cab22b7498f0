# SPDX-License-Identifier: Apache-2.0
"""Identities of homogeneous points and lines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.projective.points_and_lines import (
    LINE_AT_INFINITY,
    cartesian,
    homogeneous,
    join,
    line_distances,
    meet,
    normalised_lines,
    normalised_points,
    points_at_infinity,
    transform_lines,
    transform_points,
)
from imgu_ros.vision.projective.transform import transform
from imgu_ros.vision.projective.transformations import affine, inverse, projective, rotation, scaling, translation

seeds = st.integers(0, 2**32 - 1)


def _points(rng: np.random.Generator, count: int = 5) -> np.ndarray:
    return rng.uniform(-1000, 1000, (count, 2))


def _homography(rng: np.random.Generator) -> np.ndarray:
    A = rng.normal(size=(2, 2)) + 3 * np.eye(2)
    return projective(A, rng.uniform(-100, 100, 2), rng.uniform(-1e-4, 1e-4, 2))


def test_the_examples_of_the_notes() -> None:
    assert_allclose(meet([[1, -1, 1]], [[1, -1, -1]]), [[np.sqrt(0.5), np.sqrt(0.5), 0]])  # 6.3.5: [2, 2, 0]
    assert_allclose(join([[0, 0]], [[1, 1]]), [[np.sqrt(0.5), -np.sqrt(0.5), 0]])


@given(seed=seeds)
def test_a_join_passes_through_its_points_and_a_meet_lies_on_its_lines(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = (_points(rng) for _ in range(3))
    assert_allclose(line_distances(a, join(a, b)), 0, atol=1e-9)
    assert_allclose(line_distances(b, join(a, b)), 0, atol=1e-9)
    # The lines through a common point meet in it.
    assert_allclose(cartesian(meet(join(a, b), join(a, c))), a, rtol=1e-6, atol=1e-6)


@given(seed=seeds)
def test_duality_points_and_lines_exchanged(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, others = rng.normal(size=(2, 5, 3))
    assert_allclose(normalised_lines(meet(rows, others)), join(rows, others), atol=1e-9)
    assert_allclose(normalised_points(join(rows, others)), meet(rows, others), rtol=1e-9, atol=1e-9)


@given(seed=seeds, factor=st.floats(1e-100, 1e100), sign=st.sampled_from([-1, 1]))
def test_homogeneous_scale_and_order_mean_nothing(seed: int, factor: float, sign: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 5, 3))
    assert_allclose(join(a, sign * factor * b), join(a, b), rtol=1e-12, atol=1e-12)
    assert_array_equal(join(b, a), join(a, b))
    assert_array_equal(meet(b, a), meet(a, b))


@given(seed=seeds)
def test_normal_forms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, lines = normalised_points(rng.normal(size=(5, 3))), normalised_lines(rng.normal(size=(5, 3)))
    assert_array_equal(points[:, 2], 1)
    assert_allclose(np.hypot(lines[:, 0], lines[:, 1]), 1)
    assert (lines[:, 0] > 0).all()
    xy = _points(rng)
    assert_array_equal(cartesian(homogeneous(xy)), xy)


@given(seed=seeds)
def test_parallel_lines_meet_on_the_line_at_infinity(seed: int) -> None:
    rng = np.random.default_rng(seed)
    direction = rng.integers(-20, 20, 2) * 2 + 1.0
    a, b = rng.integers(-1000, 1000, (2, 1, 2)).astype(float)
    b[0, 0] += 0.5  # no point of the first line, whose coordinates times odd numbers are whole
    found = meet(join(a, a + direction), join(b, b + direction))
    assert_array_equal(found[:, 2], 0)
    assert_allclose(found, points_at_infinity([direction]), atol=1e-15)
    assert_array_equal(found @ LINE_AT_INFINITY, 0)
    # Two points at infinity are joined by the line at infinity; it meets a line in its direction.
    assert_array_equal(join(found, points_at_infinity([direction[::-1] * (1, -1)])), [LINE_AT_INFINITY])
    assert_allclose(meet([LINE_AT_INFINITY], join(a, a + direction)), found, atol=1e-15)


@given(seed=seeds)
def test_lines_go_by_the_inverse_transpose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = _homography(rng)
    a, b = _points(rng), _points(rng)
    moved = transform_lines(H, join(a, b))
    # By the definition, by incidence, and as the join of the images.
    assert_allclose(moved, normalised_lines(join(a, b) @ np.linalg.inv(H)), rtol=1e-6, atol=1e-6)
    assert_allclose(line_distances(transform(H, a), moved), 0, atol=1e-6)
    assert_allclose(moved, join(transform(H, a), transform(H, b)), rtol=1e-6, atol=1e-6)
    assert_allclose(transform_lines(inverse(H), moved), join(a, b), rtol=1e-6, atol=1e-6)


@given(seed=seeds)
def test_meet_and_transformation_commute(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = _homography(rng)
    lines = join(_points(rng, 2), _points(rng, 2))
    direct = transform_points(H, meet(lines[:1], lines[1:]))
    around = meet(*(transform_lines(H, line[None]) for line in lines))
    assert_allclose(np.cross(direct[0] / np.linalg.norm(direct), around[0] / np.linalg.norm(around)), 0, atol=1e-6)


@given(seed=seeds)
def test_affine_maps_keep_the_line_at_infinity_and_others_do_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = affine(rng.normal(size=(2, 2)) + 3 * np.eye(2), _points(rng, 1)[0])
    assert_array_equal(transform_lines(A, [LINE_AT_INFINITY]), [LINE_AT_INFINITY])
    H = _homography(rng)
    vanishing = transform_lines(H, [LINE_AT_INFINITY])
    assert vanishing[0, :2].any()
    # The vanishing points of all directions lie on it.
    found = transform_points(H, points_at_infinity(rng.normal(size=(4, 2))))
    assert_allclose(vanishing[0] @ (found / np.linalg.norm(found, axis=1, keepdims=True)).T, 0, atol=1e-6)


def test_vectors_under_translation_scale_and_rotation() -> None:
    """Notes 6.3.6 to 6.3.8, 6.4.1."""
    vectors = points_at_infinity([[1, 0], [3, 4]])
    assert_allclose(transform_points(translation([7, -9]), vectors), vectors, atol=1e-15)
    assert_allclose(transform_points(scaling(5), vectors), vectors, atol=1e-15)
    assert_allclose(transform_points(rotation(0.3), vectors)[0], [np.cos(0.3), np.sin(0.3), 0], atol=1e-15)
    assert_allclose(transform_points(scaling(4, 3), vectors)[1], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-15)


@given(seed=seeds)
def test_distance_is_that_to_the_nearest_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = (_points(rng, 1)[0] for _ in range(3))
    along = (b - a) / np.hypot(*(b - a))
    foot = a + ((c - a) @ along) * along
    assert_allclose(line_distances([c], join([a], [b])), np.hypot(*(c - foot)), atol=1e-8)
    assert_allclose(line_distances([c, foot], join([a], [b])), [np.hypot(*(c - foot)), 0], atol=1e-8)


def test_lists_and_no_points() -> None:
    assert join(np.zeros((0, 2)), np.zeros((0, 2))).shape == (0, 3)
    assert join([(0, 0)], [(1, 0, 1)]).tolist() == [[0, 1, 0]]
    assert_array_equal(points_at_infinity([[-2, 0], [0, -3]]), [[1, 0, 0], [0, 1, 0]])
    assert_array_equal(normalised_lines([[0, 0, -5]]), [LINE_AT_INFINITY])
    assert_array_equal(normalised_points([[1e300, 0, 1e-300]]), [[1, 0, 0]])  # beyond floats
    with pytest.raises(ValueError, match="read-only"):
        LINE_AT_INFINITY[0] = 1


def test_what_has_no_answer() -> None:
    with pytest.raises(DegenerateConfiguration, match="coincide"):
        join([[1, 2]], [[2, 4, 2]])
    with pytest.raises(DegenerateConfiguration, match="coincide"):
        join([[0.1, 0.2]], [[0.1 * 3, 0.2 * 3, 3]])  # but for rounding
    with pytest.raises(DegenerateConfiguration, match="coincide"):
        meet([LINE_AT_INFINITY], [[0, 0, 7]])
    with pytest.raises(DegenerateConfiguration, match=r"\(0, 0, 0\)"):
        join([[0, 0, 0]], [[1, 2, 3]])
    with pytest.raises(DegenerateConfiguration, match="1 of 2 at infinity"):
        cartesian([[1, 2, 0], [1, 2, 1]])
    with pytest.raises(DegenerateConfiguration, match="line at infinity"):
        line_distances([[1, 2]], [LINE_AT_INFINITY])
    with pytest.raises(DegenerateConfiguration):
        points_at_infinity([[0, 0]])
    with pytest.raises(ShapeError, match="2 and 3 rows"):
        join(np.zeros((2, 2)), np.ones((3, 2)))
    with pytest.raises(DegenerateConfiguration, match="singular"):
        transform_lines(np.ones((3, 3)), [[1, 2, 3]])
    with pytest.raises(ShapeError, match="beyond floats"):
        line_distances([[1.7e308, 1.7e308]], [[1, 1, 0]])
