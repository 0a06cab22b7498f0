# SPDX-License-Identifier: Apache-2.0
"""Euler angles, against the matrices of the book and scipy, through gimbal lock."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from imgu_ros.errors import ShapeError
from imgu_ros.vision.camera.euler import EulerOrder, euler_angles, from_euler

angles = st.floats(-math.pi, math.pi)
tilts = st.one_of(
    st.floats(-math.pi / 2, math.pi / 2),
    st.sampled_from([math.pi / 2, -math.pi / 2, math.pi / 2 - 1e-9, 1e-7 - math.pi / 2]),
)


def elementary(x: float, y: float, z: float) -> list[np.ndarray]:
    cx, sx, cy, sy, cz, sz = math.cos(x), math.sin(x), math.cos(y), math.sin(y), math.cos(z), math.sin(z)
    return [
        np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]),
        np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]),
        np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]),
    ]


@given(x=angles, y=angles, z=angles)
def test_products_of_elementary_rotations(x: float, y: float, z: float) -> None:
    X, Y, Z = elementary(x, y, z)
    assert_allclose(from_euler([x, y, z], "xyz"), X @ Y @ Z, atol=1e-14)
    assert_allclose(from_euler([x, y, z], "zyx"), Z @ Y @ X, atol=1e-14)
    # scipy: small letters are fixed axes, so "xyz" there is roll, pitch, yaw.
    assert_allclose(from_euler([x, y, z], "zyx"), Rotation.from_euler("xyz", [x, y, z]).as_matrix(), atol=1e-14)


@pytest.mark.parametrize("order", EulerOrder)
@given(x=angles, y=tilts, z=angles)
def test_angles_give_the_rotation_back_even_in_gimbal_lock(order: EulerOrder, x: float, y: float, z: float) -> None:
    R = from_euler([x, y, z], order)
    found = euler_angles(R, order)
    assert_allclose(from_euler(found, order), R, atol=1e-14)
    assert abs(found[1]) <= math.pi / 2
    if abs(y) < 1.5:
        assert_allclose(np.exp(1j * found), np.exp(1j * np.array([x, y, z])), atol=1e-12)


@pytest.mark.parametrize("order", EulerOrder)
def test_in_gimbal_lock_the_angle_about_z_is_zero(order: EulerOrder) -> None:
    R = np.round(from_euler([0.3, math.pi / 2, 0.4], order), 15)
    R[np.abs(R) < 1e-14] = 0
    found = euler_angles(R, order)
    assert found[2] == 0
    assert found[1] == pytest.approx(math.pi / 2)
    assert found[0] == pytest.approx(0.7 if order is EulerOrder.XYZ else -0.1)


def test_bad_input() -> None:
    with pytest.raises(ShapeError, match="xyz, zyx"):
        from_euler([0, 0, 0], "zxz")
    with pytest.raises(ShapeError, match="need a rotation"):
        euler_angles(np.diag([1, 1, -1]), "xyz")
