# SPDX-License-Identifier: Apache-2.0
"""Poses from condensed homographies against true poses, against the fit to the points, and over draws of noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.vision.camera.homography_pose import poses_about_point, poses_of_homography
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.camera.pose import PlanarPoses
from imgu_ros.vision.camera.rotation import exp_so3, log_so3
from imgu_ros.vision.projective.homography import homography_normal_equations
from imgu_ros.vision.projective.plane_motion import PlaneMotion
from imgu_ros.vision.projective.transform import transform

K = np.array([[900.0, 0, 640.0], [0, 910.0, 350.0], [0, 0, 1]])
CAMERA = make_camera(K, (), "plumb_bob", 1280, 720)
#: Metres from the px of a picture of 400 x 300, y up.
METRES = np.array([[0.001, 0, -0.2], [0, -0.001, 0.15], [0, 0, 1]])
PX = np.random.default_rng(4).uniform((5, 5), (395, 295), (90, 2))


def pose_of(turn: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Camera before the plane: half a turn about x shows its front."""
    return exp_so3(turn) @ np.diag([1.0, -1.0, -1.0]), np.asarray(t, np.float64)


def homography_of(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    return K @ np.column_stack((R[:, :2], t)) @ METRES


def estimated(H: np.ndarray, noise: np.ndarray) -> PlanarPoses:
    """From displacements of the picture's points, looked for by the true homography."""
    motions = PlaneMotion(PX)
    motion = motions.fit(noise, np.ones(len(PX), bool))
    return poses_of_homography(homography_normal_equations(motions, noise, motion, H, np.eye(3)), K, METRES)


turns = st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.floats(-3.0, 3.0)).map(np.array)
places = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.15, 0.15), st.floats(0.6, 3.0)).map(np.array)


@given(turns, places)
def test_one_of_the_two_poses_about_a_point_is_the_true_one(turn: np.ndarray, t: np.ndarray) -> None:
    R, t = pose_of(turn, t)
    H = np.column_stack((R[:, :2], t))
    for point in ([0.0, 0.0], [0.05, -0.1]):
        both = poses_about_point(H, point)
        assert min(np.abs(pose.R - R).max() + np.abs(pose.t - t).max() for pose in both) < 1e-6
        assert_allclose([np.linalg.det(pose.R) for pose in both], [1, 1], atol=1e-9)
        for pose in both:  # the other one has the same value and derivative there
            other = np.column_stack((pose.R[:, :2], pose.t))
            near = np.array([point, np.add(point, [1e-4, 0]), np.add(point, [0, 1e-4])])
            assert_allclose(transform(other, near), transform(H, near), atol=2e-7)


@given(turns, places)
def test_exact_displacements_give_the_true_pose(turn: np.ndarray, t: np.ndarray) -> None:
    R, t = pose_of(turn, t)
    poses = estimated(homography_of(R, t), np.zeros((len(PX), 2)))
    assert_allclose(poses.solutions[0].R, R, atol=1e-6)
    assert_allclose(poses.solutions[0].t, t, atol=1e-6)


def test_it_agrees_with_the_fit_to_the_points() -> None:
    """Noise in the picture is noise in the plane where the plane is seen nearly straight on."""
    R, t = pose_of(np.array([0.05, 0.04, 0.7]), np.array([0.02, -0.01, 0.5]))
    H = homography_of(R, t)
    noise = np.random.default_rng(5).normal(0, 0.1, PX.shape)
    poses = estimated(H, noise)
    points = planar_poses(transform(METRES, PX), transform(H, PX - noise), CAMERA)
    ours, theirs = poses.solutions[0], points.solutions[0]
    sigma = np.sqrt(np.diag(theirs.covariance))
    error = np.concatenate((ours.t - theirs.t, log_so3(ours.R @ theirs.R.T)))
    assert np.abs(error / sigma).max() < 0.35
    assert_allclose(np.sqrt(np.diag(ours.covariance)), sigma, rtol=0.15)
    assert ours.rms_px == pytest.approx(theirs.rms_px, rel=0.1)


def test_normalised_squared_errors_are_chi_squared() -> None:
    rng = np.random.default_rng(6)
    squared = []
    for _ in range(150):
        R, t = pose_of(rng.uniform((-0.7, -0.7, -3), (0.7, 0.7, 3)), rng.uniform((-0.1, -0.1, 0.5), (0.1, 0.1, 1.0)))
        pose = estimated(homography_of(R, t), rng.normal(0, 0.1, PX.shape)).solutions[0]
        error = np.concatenate((t - pose.t, log_so3(R @ pose.R.T)))
        squared.append(error @ np.linalg.solve(pose.covariance, error))
    # 6 +- 0.28
    assert 5.1 < np.mean(squared) < 7.2


def test_a_plane_from_afar_is_ambiguous_and_a_near_oblique_one_is_not() -> None:
    rng = np.random.default_rng(7)
    far = homography_of(*pose_of(np.array([0.3, 0.0, 0.0]), np.array([0.0, 0.0, 20.0])))
    poses = estimated(far, rng.normal(0, 2.0, PX.shape))
    assert len(poses.solutions) == 2 and poses.ambiguity > 0.8
    near = homography_of(*pose_of(np.array([0.6, 0.0, 0.0]), np.array([0.0, 0.0, 0.6])))
    assert estimated(near, rng.normal(0, 0.1, PX.shape)).ambiguity < 0.2


def test_what_is_no_view_of_a_plane_is_refused() -> None:
    with pytest.raises(DegenerateConfiguration, match="edge-on"):
        poses_about_point(np.array([[1.0, 0, 0], [0, 0, 0], [0, 0, 1]]), [0, 0])
    with pytest.raises(DegenerateConfiguration, match="infinity"):
        poses_about_point(np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 0]]), [0, 0])
    with pytest.raises(DegenerateConfiguration):
        poses_about_point(np.zeros((3, 3)), [0, 0])
