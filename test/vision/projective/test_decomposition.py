# SPDX-License-Identifier: Apache-2.0
"""Homographies and affine maps taken apart and put together again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.vision.projective.decomposition import decompose_affine, decompose_homography
from imgu_ros.vision.projective.hierarchy import Transformation, classify
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.transformations import rotation, similarity

seeds = st.integers(0, 2**32 - 1)


def test_the_example_of_hartley_and_zisserman() -> None:
    """HZ example 2.18."""
    parts = decompose_homography(np.array([[1.707, 0.586, 1.0], [2.707, 8.242, 2.0], [1.0, 2.0, 1.0]]))
    assert_allclose(parts.similarity, similarity(2, np.pi / 4, (1, 2)), atol=1e-3)
    assert_allclose(parts.affine, [[0.5, 1, 0], [0, 2, 0], [0, 0, 1]], atol=1e-3)
    assert_array_equal(parts.projective, [[1, 0, 0], [0, 1, 0], [1, 2, 1]])


@given(seed=seeds, factor=st.sampled_from([1.0, -2.5, 1e-150, 1e150]))
def test_known_parts_are_found(seed: int, factor: float) -> None:
    rng = np.random.default_rng(seed)
    scale, angle, k, off = rng.uniform(0.1, 10), rng.uniform(-3, 3), rng.uniform(0.3, 3), rng.uniform(-2, 2)
    S = similarity(scale, angle, rng.uniform(-1000, 1000, 2))
    K = np.array([[k, off, 0], [0, 1 / k, 0], [0, 0, 1]])
    P = np.array([[1, 0, 0], [0, 1, 0], [*rng.uniform(-1e-3, 1e-3, 2), 1]])
    parts = decompose_homography(factor * (S @ K @ P))
    assert_allclose(parts.similarity, S, rtol=1e-9, atol=1e-9)
    assert_allclose(parts.affine, K, rtol=1e-9, atol=1e-9)
    assert_allclose(parts.projective, P, rtol=1e-9, atol=1e-15)
    assert parts.scale == pytest.approx(scale)
    assert parts.angle_rad == pytest.approx(angle)


@given(seed=seeds)
def test_the_parts_recompose(seed: int) -> None:
    H = np.random.default_rng(seed).normal(size=(3, 3))
    H = normalised_homography(H * np.sign(np.linalg.det(H)))
    H[2, 2] = abs(H[2, 2]) + 0.1
    if np.linalg.det(H) <= 1e-3:
        with pytest.raises(DegenerateConfiguration):
            decompose_homography(H if np.linalg.det(H) < 0 else np.ones((3, 3)))
        return
    parts = decompose_homography(H)
    assert_allclose(parts.recomposed(), normalised_homography(H), atol=1e-12)
    assert np.linalg.det(parts.affine) == pytest.approx(1)
    assert (np.diag(parts.affine) > 0).all()
    assert parts.affine[1, 0] == 0
    assert classify(parts.similarity) is Transformation.SIMILARITY


@pytest.mark.parametrize(
    ("H", "text"),
    [
        (np.array([[1.0, 0, 1], [0, 1, 0], [1, 0, 0]]), "h33 = 0"),
        (np.diag([1.0, -1, 1]), "mirrors"),
        (np.ones((3, 3)), "singular"),
        (np.array([[1e300, 0, 1e300], [0, 1, 0], [1e300, 0, 1e-300]]), "origin"),
    ],
)
def test_what_has_no_parts(H: np.ndarray, text: str) -> None:
    with pytest.raises(DegenerateConfiguration, match=text):
        decompose_homography(H)


@given(seed=seeds)
def test_affine_parts_recompose(seed: int) -> None:
    A = np.random.default_rng(seed).normal(size=(2, 2))
    parts = decompose_affine(A)
    assert_allclose(parts.recomposed(), A, atol=1e-12)
    assert parts.scales[0] >= abs(parts.scales[1]) > 0
    assert np.sign(parts.scales[1]) == np.sign(np.linalg.det(A))
    assert -np.pi / 2 < parts.axis_rad <= np.pi / 2


def test_affine_parts_by_hand() -> None:
    parts = decompose_affine(rotation(0.4)[:2, :2] @ np.diag([3.0, 2.0]))
    assert parts.angle_rad == pytest.approx(0.4)
    assert parts.axis_rad == pytest.approx(0, abs=1e-12)
    assert_allclose(parts.scales, [3, 2])
    same = decompose_affine(5 * rotation(-1.0)[:2, :2])
    assert (same.angle_rad, same.axis_rad) == (pytest.approx(-1.0), 0)
    with pytest.raises(DegenerateConfiguration):
        decompose_affine([[1, 2], [2, 4]])
