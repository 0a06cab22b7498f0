# SPDX-License-Identifier: Apache-2.0
"""Poses from points in space and rotations between views: exact, honest about noise, and with wrong correspondences."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, TooFewPoints
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.camera.pose_estimate import estimate_pose, fit_pose
from imgu_ros.vision.camera.rotation import exp_so3, log_so3
from imgu_ros.vision.camera.rotation_model import estimate_rotation

K = np.array([[900.0, 0, 641.5], [0, 880.0, 350.25], [0, 0, 1]])
CAMERAS = [
    make_camera(K, (-0.26, 0.09, 0.0008, -0.0005, -0.01), "plumb_bob", 1280, 720),
    make_camera(K, (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01), "rational_polynomial", 1280, 720),
    make_camera(K, (-0.03, 0.008, -0.004, 0.001), "equidistant", 1280, 720),
]
R, T = exp_so3([0.3, 0.2, -0.4]), np.array([0.1, 0, 4.0])
TURN = exp_so3([0.05, 0.2, 0.3])


def box(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (count, 3))


def some_bad(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    bad = np.zeros(len(pixels), bool)
    bad[rng.permutation(len(pixels))[: round(0.3 * len(pixels))]] = True
    pixels += rng.normal(0, 0.4, pixels.shape)
    pixels[bad] = rng.uniform((0, 0), (1280, 720), (np.count_nonzero(bad), 2))
    return bad


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: str(camera.model))
@pytest.mark.parametrize("count", [4, 5, 30])
def test_exact_through_every_lens(camera, count) -> None:
    pose = fit_pose(box(count), camera.project(box(count) @ R.T + T), camera)
    assert_allclose(pose.R, R, atol=1e-9)
    assert_allclose(pose.t, T, atol=1e-9)


def test_points_of_a_plane_have_the_better_planar_pose() -> None:
    flat = box(20) * (1, 1, 0)
    pixels = CAMERAS[0].project(flat @ R.T + T) + np.random.default_rng(0).normal(0, 0.3, (20, 2))
    pose, planar = fit_pose(flat, pixels, CAMERAS[0]), planar_poses(flat[:, :2], pixels, CAMERAS[0]).solutions[0]
    assert_allclose(pose.R, planar.R, atol=1e-6)
    assert_allclose(pose.covariance, planar.covariance, rtol=1e-3, atol=1e-12)


def test_covariance_passes_a_chi_square_test() -> None:
    points, rng = box(40), np.random.default_rng(1)
    pixels = CAMERAS[0].project(points @ R.T + T)
    squared = []
    for _ in range(200):
        pose = fit_pose(points, pixels + rng.normal(0, 0.4, pixels.shape), CAMERAS[0], noise_px=0.4)
        error = np.r_[T - pose.t, log_so3(R @ pose.R.T)]
        squared.append(error @ np.linalg.solve(pose.covariance, error))
    # Chi-square of 6 degrees of freedom: mean 6 (standard error 0.25), 95 % below 12.59.
    assert 5.2 < np.mean(squared) < 6.8
    assert 0.91 < np.mean(np.array(squared) < 12.59) < 0.99


@pytest.mark.parametrize("seed", range(3))
def test_pose_with_thirty_percent_of_outliers(seed: int) -> None:
    points, rng = box(60, seed), np.random.default_rng(seed)
    pixels = CAMERAS[0].project(points @ R.T + T)
    bad = some_bad(pixels, rng)
    estimate = estimate_pose(points, pixels, CAMERAS[0], rng)
    pose, inliers = estimate.pose, estimate.inliers
    assert estimate.iterations >= 16
    assert np.count_nonzero(inliers != ~bad) <= 1
    assert np.linalg.norm(pose.t - T) < 0.01
    assert np.linalg.norm(log_so3(pose.R @ R.T)) < 0.003


@pytest.mark.parametrize("seed", range(3))
def test_rotation_with_thirty_percent_of_outliers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    src = rng.uniform((100, 100), (1100, 620), (60, 2))
    rays = np.column_stack((CAMERAS[0].undistort(src)[0], np.ones(60)))
    turned = rays @ TURN.T
    dst = CAMERAS[1].project(turned)
    bad = some_bad(dst, rng)
    estimate = estimate_rotation(src, dst, CAMERAS[0], CAMERAS[1], rng)
    assert np.count_nonzero(estimate.inliers != ~bad) <= 1
    error = log_so3(TURN @ estimate.R.T)
    assert error @ np.linalg.solve(estimate.covariance, error) < 20
    assert np.linalg.norm(error) < 2e-3


def test_degenerate_and_hopeless() -> None:
    line = np.outer(np.linspace(-1, 1, 8), (1, 0.5, 0.2))
    with pytest.raises(DegenerateConfiguration, match="line"):
        fit_pose(line, CAMERAS[0].project(line @ R.T + T), CAMERAS[0])
    with pytest.raises(TooFewPoints):
        fit_pose(box(3), np.zeros((3, 2)), CAMERAS[0])
    rng = np.random.default_rng(0)
    with pytest.raises(NoConsensus):
        estimate_pose(box(30), rng.uniform(0, 700, (30, 2)), CAMERAS[0], rng, max_iterations=100)
    with pytest.raises(NoConsensus):
        estimate_rotation(
            rng.uniform(0, 700, (30, 2)), rng.uniform(0, 700, (30, 2)), CAMERAS[0], CAMERAS[0], rng, threshold_px=0.5
        )
