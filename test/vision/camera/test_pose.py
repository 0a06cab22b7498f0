# SPDX-License-Identifier: Apache-2.0
"""Poses: the inverse and its covariance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imgu_ros.vision.camera.pose import Pose


def random_pose(seed: int, sigma: float) -> Pose:
    generator = np.random.default_rng(seed)
    root = generator.normal(size=(6, 6)) * sigma
    return Pose(Rotation.random(random_state=seed).as_matrix(), generator.normal(size=3), root @ root.T, 0.3)


@pytest.mark.parametrize("seed", [0, 1])
def test_covariance_of_the_inverse_by_monte_carlo(seed):
    pose = random_pose(seed, 1e-3)
    inverse = pose.inverse()
    np.testing.assert_allclose(inverse.R @ pose.R, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(inverse.R @ pose.t + inverse.t, 0, atol=1e-12)

    count = 50_000
    error = np.random.default_rng(9).multivariate_normal(np.zeros(6), pose.covariance, count)
    # The truth, were the estimate wrong by `error`: R_true = Exp(d) R, t_true = t + e; then its inverse.
    R_true = Rotation.from_rotvec(error[:, 3:]) * Rotation.from_matrix(pose.R)
    R_inverse_true = R_true.inv()
    t_inverse_true = -R_inverse_true.apply(pose.t + error[:, :3])
    # The error of the estimated inverse, by the same convention about the new axes.
    rotation_error = (R_inverse_true * Rotation.from_matrix(inverse.R).inv()).as_rotvec()
    sampled = np.cov(np.column_stack((t_inverse_true - inverse.t, rotation_error)).T)
    # Four standard deviations of a correlation from 50 000 samples, and of a variance nearly three.
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    assert np.abs((inverse.covariance - sampled) / scale).max() < 0.018


def test_twice_inverted_is_the_same():
    pose = random_pose(4, 0.1)
    again = pose.inverse().inverse()
    np.testing.assert_allclose(again.R, pose.R, atol=1e-12)
    np.testing.assert_allclose(again.t, pose.t, atol=1e-12)
    np.testing.assert_allclose(again.covariance, pose.covariance, atol=1e-12)


def test_a_distant_camera_is_less_certain_sideways():
    """Only the tilt about the camera's x is uncertain: 2 m away, the camera's place is, along y."""
    covariance = np.zeros((6, 6))
    covariance[3, 3] = 0.01**2
    inverse = Pose(np.eye(3), np.array([0.0, 0.0, 2.0]), covariance, 0.0).inverse()
    np.testing.assert_allclose(np.diag(inverse.covariance), [0, 0.02**2, 0, 0.01**2, 0, 0], atol=1e-15)
