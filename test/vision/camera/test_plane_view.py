# SPDX-License-Identifier: Apache-2.0
"""A plane's homography and a rotation's, against projected points, and back to the pose and the rotation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.camera.plane_view import plane_homography, pose_from_plane_homography
from imgu_ros.vision.camera.projection import project, projection_matrix
from imgu_ros.vision.camera.rotation import exp_so3, log_so3
from imgu_ros.vision.camera.rotation_view import rotation_from_homography, rotation_homography
from imgu_ros.vision.projective.dlt import homography_dlt
from imgu_ros.vision.projective.transform import transform

K = np.array([[900.0, 2.0, 641.5], [0, 880.0, 350.25], [0, 0, 1]])
K2 = np.array([[500.0, 0, 320.0], [0, 510.0, 240.0], [0, 0, 1]])
seeds = st.integers(0, 10_000)


def view(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    R = exp_so3(rng.uniform(-0.9, 0.9, 3)) @ np.diag([1.0, -1, -1]) @ exp_so3([0, 0, rng.uniform(-3, 3)])
    return R, np.r_[rng.uniform(-0.3, 0.3, 2), rng.uniform(0.5, 5)]


@given(seed=seeds)
def test_plane_homography_projects_as_the_camera_does(seed: int) -> None:
    R, t = view(seed)
    xy = np.random.default_rng(seed).uniform(-0.2, 0.2, (10, 2))
    H = plane_homography(K, R, t)
    assert np.linalg.norm(H) == pytest.approx(1)
    assert (xy @ H[2, :2] + H[2, 2] > 0).all()
    world = np.column_stack((xy, np.zeros(10)))
    assert_allclose(transform(H, xy), project(projection_matrix(K, R, t), world), rtol=1e-11)


@given(seed=seeds, scale=st.floats(1e-3, 1e3), sign=st.sampled_from([-1, 1]))
def test_pose_comes_back_whatever_the_scale(seed: int, scale: float, sign: int) -> None:
    R, t = view(seed)
    pose = pose_from_plane_homography(K, sign * scale * plane_homography(K, R, t))
    assert_allclose(pose.R, R, atol=1e-12)
    assert_allclose(pose.t, t, atol=1e-12)


def test_pose_of_a_measured_homography_is_near() -> None:
    R, t = view(7)
    xy = np.random.default_rng(0).uniform(-0.2, 0.2, (60, 2))
    seen = transform(plane_homography(K, R, t), xy) + np.random.default_rng(1).normal(0, 0.3, (60, 2))
    pose = pose_from_plane_homography(K, homography_dlt(xy, seen))
    assert_allclose(pose.R @ pose.R.T, np.eye(3), atol=1e-12)
    assert np.linalg.norm(log_so3(pose.R @ R.T)) < 0.02
    assert np.linalg.norm(pose.t - t) < 0.02 * t[2]


def test_no_view_of_a_plane() -> None:
    with pytest.raises(DegenerateConfiguration, match="centre"):
        plane_homography(K, np.eye(3), [1.0, 2, 0])
    with pytest.raises(ShapeError, match="overflow"):
        plane_homography(np.diag([1e300, 1e300, 1]), np.eye(3), [1e300, 0, 1e300])
    with pytest.raises(DegenerateConfiguration, match="regular"):
        pose_from_plane_homography(K, np.zeros((3, 3)))
    edge_on = K @ np.array([[1.0, 1, 0], [0, 0, 0], [0, 0, 1]])
    with pytest.raises(DegenerateConfiguration, match="edge on"):
        pose_from_plane_homography(K, edge_on)


@given(seed=seeds)
def test_rotation_homography_maps_pictures_of_the_same_rays(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = exp_so3(rng.uniform(-0.3, 0.3, 3))
    rays = np.column_stack((rng.uniform(-0.4, 0.4, (12, 2)), np.ones(12))) * rng.uniform(0.5, 9, (12, 1))
    x1 = project(projection_matrix(K, np.eye(3), np.zeros(3)), rays)
    x2 = project(projection_matrix(K2, R, np.zeros(3)), rays)
    H = rotation_homography(R, K, K2)
    assert np.linalg.det(H) > 0
    assert_allclose(transform(H, x1), x2, rtol=1e-10, atol=1e-9)
    assert_allclose(rotation_from_homography(-3 * H, K, K2), R, atol=1e-12)
    # The notes' last line of 8.1.5 reads it backwards.
    assert_allclose(transform(K @ R.T @ np.linalg.inv(K2), x2), x1, rtol=1e-9, atol=1e-9)


def test_a_homography_of_a_moving_camera_is_no_rotation() -> None:
    R, t = view(3)
    with pytest.raises(DegenerateConfiguration, match="singular values"):
        rotation_from_homography(plane_homography(K, R, t), K)
    with pytest.raises(DegenerateConfiguration, match="singular"):
        rotation_from_homography(np.ones((3, 3)), K)
