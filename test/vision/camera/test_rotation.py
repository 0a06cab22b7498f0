"""Rotations, against the definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm

from imgu_ros.vision.camera.rotation import exp_so3, from_quaternion, log_so3, quaternion

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
