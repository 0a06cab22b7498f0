# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms, against 4x4 matrices and against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imgu_ros.errors import ShapeError
from imgu_ros.vision.camera.rigid import RigidTransform, rigid_transform, rigid_transforms

HALF = np.sqrt(0.5)

transforms = st.integers(0, 2**32 - 1).map(
    lambda seed: RigidTransform(
        Rotation.random(random_state=seed).as_matrix(), np.random.default_rng(seed).normal(size=3)
    )
)


def as_4x4(transform: RigidTransform) -> np.ndarray:
    return np.block([[transform.R, transform.t[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


@given(transforms, transforms)
def test_composition_and_inverse_are_those_of_4x4_matrices(second: RigidTransform, first: RigidTransform) -> None:
    np.testing.assert_allclose(as_4x4(second.after(first)), as_4x4(second) @ as_4x4(first), atol=1e-12)
    np.testing.assert_allclose(as_4x4(second.inverse()), np.linalg.inv(as_4x4(second)), atol=1e-12)


@given(transforms)
def test_numbers_round_trip(transform: RigidTransform) -> None:
    numbers = transform.numbers()
    assert numbers.shape == (7,)
    assert numbers[6] >= 0
    again = rigid_transform(numbers)
    np.testing.assert_array_equal(again.t, transform.t)
    np.testing.assert_allclose(again.R, transform.R, atol=1e-14)


def test_numbers_by_hand() -> None:
    quarter_turn = RigidTransform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2, 3]))
    np.testing.assert_allclose(quarter_turn.numbers(), [1, 2, 3, 0, 0, HALF, HALF], atol=1e-15)
    moved = quarter_turn.after(RigidTransform(np.eye(3), np.array([1.0, 0, 0])))
    np.testing.assert_allclose(moved.t, [1, 3, 3], atol=1e-15)


def test_list_of_numbers_is_a_list_of_transforms() -> None:
    first, second = rigid_transforms([1, 2, 3, 0, 0, HALF, HALF, 0, 0, 0, 0, 0, 0, -2.0])
    np.testing.assert_allclose(first.R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    np.testing.assert_array_equal(first.t, [1, 2, 3])
    np.testing.assert_array_equal(second.R, np.eye(3))
    assert rigid_transforms([]) == ()


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ([1.0] * 6, r"targets.poses: 6 numbers; need seven"),
        ([0.0, 0, 0, 0, 0, 0, 1] + [0.0] * 7, r"targets.poses\[1\]: quaternion \[0.0, 0.0, 0.0, 0.0\]"),
        ([np.nan] * 7, r"targets.poses\[0\]: 7 values are not finite"),
    ],
)
def test_bad_numbers_are_refused(numbers: list[float], message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        rigid_transforms(numbers, "targets.poses")


@pytest.mark.parametrize("numbers", [[], [1.0] * 8, [[1.0] * 7], ["a"] * 7])
def test_anything_but_seven_numbers_is_refused(numbers: object) -> None:
    with pytest.raises(ShapeError, match="pose"):
        rigid_transform(numbers, "pose")
