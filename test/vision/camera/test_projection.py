# SPDX-License-Identifier: Apache-2.0
"""The projective camera: by hand, against the calibrated camera, and its own inverse, to 1e-12."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.camera.decomposition import decompose_projection, rq
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.projection import (
    camera_centre,
    camera_to_world,
    depths,
    project,
    projection_matrix,
    world_to_camera,
)

K = np.array([[900.0, 2.0, 641.5], [0, 880.0, 350.25], [0, 0, 1]])
seeds = st.integers(0, 10_000)


def placed(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return Rotation.random(random_state=seed).as_matrix(), rng.uniform(-2, 2, 3), rng.uniform(-1, 1, (20, 3))


def test_by_hand() -> None:
    # A camera 2 m in front of the origin, looking at it: z_camera = -z_world.
    R, t = np.diag([1.0, -1, -1]), np.array([0, 0, 2.0])
    P = projection_matrix([[100, 0, 50], [0, 100, 40], [0, 0, 1]], R, t)
    assert_allclose(P, [[100, 0, -50, 100], [0, -100, -40, 80], [0, 0, -1, 2]])
    assert_allclose(project(P, [[0.2, 0.1, 1.0]]), [[70, 30]])
    assert_allclose(camera_centre(P), [0, 0, 2])
    assert_allclose(depths(P, [[0.2, 0.1, 1.0], [0, 0, 3]]), [1, -1])


@given(seed=seeds)
def test_projection_is_that_of_the_calibrated_camera(seed: int) -> None:
    R, t, world = placed(seed)
    t = t + (0, 0, 5 + 2 * np.abs(world).max())
    in_camera = world_to_camera(R, t, world)
    expected = make_camera(K, (), "plumb_bob", 1280, 720).project(in_camera)
    assert_allclose(project(projection_matrix(K, R, t), world), expected, rtol=1e-12)
    assert_allclose(camera_to_world(R, t, in_camera), world, atol=1e-12)


@given(seed=seeds, scale=st.floats(1e-3, 1e3), sign=st.sampled_from([-1, 1]))
def test_centre_depth_and_parts(seed: int, scale: float, sign: int) -> None:
    R, t, world = placed(seed)
    P = sign * scale * projection_matrix(K, R, t)
    assert_allclose(camera_centre(P), -R.T @ t, atol=1e-12)
    assert_allclose(depths(P, world), world_to_camera(R, t, world)[:, 2], atol=1e-12)
    parts = decompose_projection(P)
    assert_allclose(parts.K, K, rtol=1e-12, atol=1e-10)
    assert_allclose(parts.pose.R, R, atol=1e-12)
    assert_allclose(parts.pose.t, t, atol=1e-12)


@given(seed=seeds)
def test_rq(seed: int) -> None:
    matrix = np.random.default_rng(seed).normal(size=(3, 3))
    upper, orthogonal = rq(matrix)
    assert_allclose(upper @ orthogonal, matrix, atol=1e-12)
    assert_allclose(orthogonal @ orthogonal.T, np.eye(3), atol=1e-12)
    assert (np.diag(upper) > 0).all()
    assert not np.tril(upper, -1).any()
    assert np.sign(np.linalg.det(orthogonal)) == np.sign(np.linalg.det(matrix))


def test_bad_input() -> None:
    at_infinity = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    for function in (camera_centre, decompose_projection):
        with pytest.raises(DegenerateConfiguration, match="singular"):
            function(at_infinity)
    with pytest.raises(DegenerateConfiguration, match="singular"):
        depths(at_infinity, [[0, 0, 1.0]])
    with pytest.raises(DegenerateConfiguration, match="singular"):
        rq(np.zeros((3, 3)))
    with pytest.raises(DegenerateConfiguration, match="principal plane"):
        project(projection_matrix(K, np.eye(3), np.zeros(3)), [[1.0, 2, 0]])
    with pytest.raises(ShapeError, match="need a rotation"):
        projection_matrix(K, np.diag([1.0, 1, -1]), np.zeros(3))
    with pytest.raises(ShapeError, match="fx > 0"):
        projection_matrix(K.T, np.eye(3), np.zeros(3))
