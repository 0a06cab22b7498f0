# SPDX-License-Identifier: Apache-2.0
"""Rotations, against the definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm

from imgu_ros.errors import ShapeError
from imgu_ros.vision.camera.rotation import (
    as_rotation,
    exp_so3,
    from_quaternion,
    log_so3,
    nearest_rotation,
    quaternion,
)

vectors = st.tuples(*[st.floats(-1.8, 1.8)] * 3).map(np.array)


@given(vectors)
def test_exponential_and_logarithm(v: np.ndarray) -> None:
    skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    assert_allclose(exp_so3(v), expm(skew), atol=1e-12)
    if np.linalg.norm(v) < 3.1:
        assert_allclose(log_so3(exp_so3(v)), v, atol=1e-9)


@given(vectors)
def test_quaternion_is_canonical_and_round_trips(v: np.ndarray) -> None:
    q = quaternion(exp_so3(v))
    assert q[3] >= 0
    assert np.linalg.norm(q) == pytest.approx(1)
    assert_allclose(from_quaternion(q), exp_so3(v), atol=1e-12)


def test_half_turns_have_one_quaternion() -> None:
    assert_allclose(quaternion(np.diag([1.0, -1, -1])), [1, 0, 0, 0], atol=1e-15)
    assert_allclose(quaternion(np.diag([-1.0, -1, 1])), [0, 0, 1, 0], atol=1e-15)
    assert_allclose(quaternion(exp_so3([0, 0, np.pi / 2])), [0, 0, np.sqrt(0.5), np.sqrt(0.5)])


@pytest.mark.parametrize("length", [0.0, 1e-300, 1e-160, 1e-17, 1e-12, 1e-8, 1e-5, 1e-3])
def test_small_rotations_keep_every_digit(length: float) -> None:
    v = length * np.array([0.48, -0.6, 0.64])
    assert_allclose(log_so3(exp_so3(v)), v, rtol=1e-12, atol=1e-16)
    # To second order Exp(v) = I + [v] + [v]^2 / 2.
    if length <= 1e-5:
        skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        assert_allclose(exp_so3(v), np.eye(3) + skew + skew @ skew / 2, atol=1e-15)


@pytest.mark.parametrize("short", [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3])
@given(seed=st.integers(0, 1000))
def test_rotations_by_nearly_half_a_turn_keep_their_axis(short: float, seed: int) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    v = axis / np.linalg.norm(axis) * (np.pi - short)
    found = log_so3(exp_so3(v))
    # At half a turn itself both signs are right.
    assert min(np.abs(found - v).max(), np.abs(found + v).max() if short < 1e-14 else np.inf) < 1e-14 * 100
    assert np.linalg.norm(found) <= np.pi + 1e-15


@given(vectors, vectors)
def test_exponential_of_the_adjoint(v: np.ndarray, w: np.ndarray) -> None:
    R = exp_so3(v)
    assert_allclose(R @ exp_so3(w) @ R.T, exp_so3(R @ w), atol=1e-13)


@given(vectors, st.integers(0, 1000))
def test_nearest_rotation_of_a_stretched_one_is_itself(v: np.ndarray, seed: int) -> None:
    root = np.random.default_rng(seed).normal(size=(3, 3)) * 0.3
    stretch = np.eye(3) + root @ root.T  # polar decomposition: R S, S symmetric and positive, has R as its nearest
    assert_allclose(nearest_rotation(exp_so3(v) @ stretch), exp_so3(v), atol=1e-12)


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1, -1]), 2 * np.eye(3), np.zeros((3, 3)), np.eye(3) + 1e-3])
def test_no_rotation(matrix: np.ndarray) -> None:
    for function in (log_so3, quaternion, as_rotation):
        with pytest.raises(ShapeError, match="need a rotation"):
            function(matrix)
    with pytest.raises(ShapeError, match="all zero"):
        from_quaternion(np.zeros(4))
    with pytest.raises(ShapeError, match="near a rotation"):
        nearest_rotation(np.diag([1.0, 0, 0]))
    with pytest.raises(ShapeError, match="radians"):
        exp_so3([1e9, 0, 0])
