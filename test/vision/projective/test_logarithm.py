# SPDX-License-Identifier: Apache-2.0
"""The logarithm of homographies: beside scipy's, and by what it is for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm, logm

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Matrix3
from imgu_ros.vision.projective.logarithm import exponential, logarithm


def similarity(degrees: float, scale: float, x: float, y: float) -> Matrix3:
    a = np.radians(degrees)
    c, s = scale * np.cos(a), scale * np.sin(a)
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(1e-6, 0.6))
def test_its_exponential_is_the_homography(seed: int, size: float) -> None:
    L = np.random.default_rng(seed).normal(0, size, (3, 3))
    L -= np.trace(L) / 3 * np.eye(3)
    if np.abs(np.linalg.eigvals(L).imag).max() < 3:
        assert_allclose(logarithm(expm(L)), L, atol=1e-9 * max(1.0, np.abs(expm(L)).max()))


@pytest.mark.parametrize("degrees", [1e-9, 0.01, 3.0, -18.0, 90.0, 170.0])
@pytest.mark.parametrize(("scale", "x", "y"), [(1, 0, 0), (1, 0.3, -2), (1.3, 5, 1), (0.4, 0, 1e-3)])
def test_as_by_another_method(degrees: float, scale: float, x: float, y: float) -> None:
    H = similarity(degrees, scale, x, y) + np.array([[0, 0, 0], [0, 0, 0], [0.01, -0.02, 0]])
    expected = logm(H / np.cbrt(np.linalg.det(H)))
    assert_allclose(logarithm(H), expected, atol=1e-8)
    assert_allclose(logarithm(-1e9 * -H), expected, atol=1e-8)


def test_a_shift_and_a_turn_by_hand() -> None:
    assert_allclose(logarithm(similarity(0, 1, 3, -7)), [[0, 0, 3], [0, 0, -7], [0, 0, 0]], atol=1e-12)
    a = np.radians(50)
    assert_allclose(logarithm(similarity(50, 1, 0, 0)), [[0, -a, 0], [a, 0, 0], [0, 0, 0]], atol=1e-12)


@given(degrees=st.floats(-170, 170), share=st.floats(-1, 1))
def test_a_share_of_a_turn(degrees: float, share: float) -> None:
    part = expm(share * logarithm(similarity(degrees, 1, 0, 0)))
    assert_allclose(part, similarity(share * degrees, 1, 0, 0), atol=1e-9)


@pytest.mark.parametrize(
    "H",
    [
        np.zeros((3, 3)),
        np.diag([1.0, -1, 1]),
        np.diag([-1.0, -1, 1]),
        np.ones((3, 3)),
        np.diag([1e-40, 1, 1]),
        np.diag([1e200, 1, 1]),
    ],
)
def test_none_of_a_mirror_half_a_turn_or_no_motion(H: Matrix3) -> None:
    with pytest.raises(DegenerateConfiguration, match="H: "):
        logarithm(H)


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(0, 8))
def test_the_exponential_as_by_another_method(seed: int, size: float) -> None:
    L = np.random.default_rng(seed).normal(0, 1, (3, 3)) * size
    expected = expm(L)
    assert_allclose(exponential(L), expected, atol=1e-10 * np.abs(expected).max())


def test_a_velocity_that_is_none() -> None:
    with pytest.raises(DegenerateConfiguration, match="L: "):
        exponential(np.full((3, 3), 1e3))
