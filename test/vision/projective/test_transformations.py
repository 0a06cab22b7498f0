# SPDX-License-Identifier: Apache-2.0
"""Building, composing and inverting transformations of the plane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.projective.transform import transform
from imgu_ros.vision.projective.transformations import (
    affine,
    cofactors,
    compose,
    euclidean,
    inverse,
    projective,
    require_regular,
    rotation,
    scaling,
    shear_x,
    shear_y,
    similarity,
    translation,
)

POINTS = np.array([[0.0, 0], [1, 0], [0, 1], [3, -2]])
seeds = st.integers(0, 2**32 - 1)


def _any(rng: np.random.Generator) -> np.ndarray:
    A = rng.normal(size=(2, 2)) + 2 * np.eye(2)
    return projective(A, rng.uniform(-50, 50, 2), rng.uniform(-0.1, 0.1, 2))


@pytest.mark.parametrize(
    ("H", "expected"),
    [
        (translation([5, -2]), [[5, -2], [6, -2], [5, -1], [8, -4]]),
        (rotation(np.pi / 2), [[0, 0], [0, 1], [-1, 0], [2, 3]]),  # x goes towards y
        (rotation(np.pi, about=(1, 1)), [[2, 2], [1, 2], [2, 1], [-1, 4]]),
        (euclidean(np.pi / 2, (10, 20)), [[10, 20], [10, 21], [9, 20], [12, 23]]),
        (similarity(2, np.pi / 2, (10, 20)), [[10, 20], [10, 22], [8, 20], [14, 26]]),
        (scaling(3), [[0, 0], [3, 0], [0, 3], [9, -6]]),
        (scaling(3, -0.5), [[0, 0], [3, 0], [0, -0.5], [9, 1]]),
        (shear_x(2), [[0, 0], [1, 0], [2, 1], [-1, -2]]),
        (shear_y(2), [[0, 0], [1, 2], [0, 1], [3, 4]]),
        (affine([[1, 2], [3, 4]], (5, 6)), [[5, 6], [6, 9], [7, 10], [4, 7]]),
        (projective([[1, 2], [3, 4]], (5, 6), (1, 0)), [[5, 6], [3, 4.5], [7, 10], [1, 1.75]]),
    ],
)
def test_by_hand(H: np.ndarray, expected: list[list[float]]) -> None:
    assert_allclose(transform(H, POINTS), expected, atol=1e-12)


@given(seed=seeds)
def test_composition_applies_in_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second, third = (_any(rng) for _ in range(3))
    points = rng.uniform(-1, 1, (6, 2))
    expected = transform(third, transform(second, transform(first, points)))
    assert_allclose(transform(compose(first, second, third), points), expected, rtol=1e-7, atol=1e-7)
    assert_allclose(compose(compose(first, second), third), compose(first, compose(second, third)), atol=1e-9)


@given(seed=seeds)
def test_the_inverse_undoes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = _any(rng)
    points = rng.uniform(-1, 1, (6, 2))
    assert_allclose(transform(inverse(H), transform(H, points)), points, atol=1e-9)
    # Whether its last row is exactly that of an affine matrix, which fixes the scale, is a matter of rounding.
    both = compose(H, inverse(H))
    assert_allclose(both / both[2, 2], np.eye(3), atol=1e-9)
    assert_allclose(inverse(inverse(H)), H, atol=1e-10)


def test_what_is_affine_stays_exactly_affine() -> None:
    both = compose(similarity(1e-3, 0.3, (1e6, -7)), 5 * shear_x(0.2), -scaling(3, 7))
    for H in (both, inverse(both), compose(both, inverse(both))):
        assert_array_equal(H[2], [0, 0, 1])
    assert_array_equal(compose(), np.eye(3))


def test_others_have_unit_norm_and_a_positive_determinant() -> None:
    H = projective(-2 * np.eye(2), (1, 2), (0.1, 0))
    for M in (H, inverse(H), compose(H, H)):
        assert np.linalg.norm(M) == pytest.approx(1)
        assert np.linalg.det(M) > 0


@given(angle=st.floats(-10, 10), x=st.floats(-1e3, 1e3), y=st.floats(-1e3, 1e3))
def test_identities_of_the_notes(angle: float, x: float, y: float) -> None:
    t = np.array([x, y])
    R = rotation(angle)[:2, :2]
    assert_allclose(inverse(rotation(angle)), rotation(-angle), atol=1e-15)
    assert_allclose(inverse(rotation(angle))[:2, :2], R.T, atol=1e-15)
    assert_allclose(inverse(translation(t)), translation(-t), atol=1e-15)
    assert_allclose(compose(rotation(angle), translation(t)), euclidean(angle, t), atol=1e-15)
    # R (x + t) = R x + R t, which is another one.
    assert_allclose(compose(translation(t), rotation(angle)), euclidean(angle, R @ t), atol=1e-9)
    assert_allclose(inverse(scaling(4)), scaling(0.25))
    # About a point: move it to the origin, turn, move back.
    assert_allclose(
        rotation(angle, about=t), compose(translation(-t), rotation(angle), translation(t)), rtol=1e-9, atol=1e-9
    )


@given(seed=seeds)
def test_cofactors_are_the_inverse_transposed(seed: int) -> None:
    H = np.random.default_rng(seed).normal(size=(3, 3))
    expected = np.linalg.det(H) * np.linalg.inv(H).T
    got = cofactors(H)
    assert_allclose(got / np.linalg.norm(got), expected / np.linalg.norm(expected), atol=1e-9)


def test_cofactors_of_low_rank() -> None:
    assert_array_equal(cofactors(np.zeros((3, 3))), np.zeros((3, 3)))
    assert_array_equal(cofactors(np.ones((3, 3))), np.zeros((3, 3)))


@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_regular_in_any_units(scale: float) -> None:
    require_regular(scale * translation([1e15, -1e15]), 3, "H")
    require_regular(scale * np.diag([1e-12, 1e12, 1.0]), 3, "H")
    with pytest.raises(DegenerateConfiguration, match="H: singular"):
        require_regular(scale * np.array([[1.0, 2, 3], [4, 5, 6], [7, 8, 9]]), 3, "H")
    with pytest.raises(DegenerateConfiguration, match="row or column is zero"):
        require_regular(scale * np.diag([1.0, 0, 1]), 3, "H")


def test_what_is_no_transformation() -> None:
    with pytest.raises(ShapeError, match="scale: 0"):
        similarity(0, 1, (0, 0))
    with pytest.raises(ShapeError, match="scale: -2"):
        similarity(-2, 1, (0, 0))
    with pytest.raises(ShapeError, match="angle_rad"):
        rotation(np.nan)
    with pytest.raises(DegenerateConfiguration):
        scaling(1, 0)
    with pytest.raises(DegenerateConfiguration):
        affine([[1, 2], [2, 4]], (0, 0))
    with pytest.raises(DegenerateConfiguration):
        projective([[1, 0], [0, 1]], (1, 0), (1, 0))
    with pytest.raises(DegenerateConfiguration):
        inverse(np.ones((3, 3)))
    with pytest.raises(DegenerateConfiguration, match=r"transformations\[1\]"):
        compose(np.eye(3), np.ones((3, 3)))
