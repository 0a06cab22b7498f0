# SPDX-License-Identifier: Apache-2.0
"""Planar poses: exact, ambiguous, degenerate, with an honest covariance."""

import contextlib

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from imgu_ros.errors import DegenerateConfiguration, EstimationError, TooFewPoints
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.planar_pose import planar_pose_starts, planar_poses
from imgu_ros.vision.camera.rotation import exp_so3, log_so3

K = np.array([[900.0, 0, 641.5], [0, 880.0, 350.25], [0, 0, 1]])
LENSES = {
    "plumb_bob": (-0.26, 0.09, 0.0008, -0.0005, -0.01),
    "rational_polynomial": (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01),
    "equidistant": (-0.03, 0.008, -0.004, 0.001),
}
PINHOLE = make_camera(K, (), "plumb_bob", 1280, 720)
#: The printed face is seen: target z towards the camera, target y up.
FACING = np.diag([1.0, -1.0, -1.0])


def view(tilt_deg: float, distance: float, turn_deg: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    R = exp_so3([0, 0, np.radians(turn_deg)]) @ exp_so3([np.radians(tilt_deg), 0, 0]) @ FACING
    return R, np.array([0.02, -0.03, distance])


def grid(side: float = 0.3, count: int = 9) -> np.ndarray:
    x = np.linspace(-side / 2, side / 2, count)
    return np.column_stack([g.ravel() for g in np.meshgrid(x, x)])


def seen(xy: np.ndarray, R: np.ndarray, t: np.ndarray, camera: Camera) -> np.ndarray:
    return camera.project(xy @ R[:, :2].T + t)


@pytest.mark.parametrize("model", LENSES)
@pytest.mark.parametrize("tilt", [5.0, 30.0, 60.0])
def test_exact_through_every_lens(model: str, tilt: float) -> None:
    camera = make_camera(K, LENSES[model], model, 1280, 720)
    R, t = view(tilt, 0.6)
    poses = planar_poses(grid(), seen(grid(), R, t, camera), camera)
    assert_allclose(poses.solutions[0].t, t, atol=1e-9)
    assert_allclose(poses.solutions[0].R, R, atol=1e-9)
    assert poses.ambiguity < 1e-6


def test_covariance_passes_a_chi_square_test() -> None:
    R, t = view(35, 0.7)
    squared = []
    for seed in range(200):
        pixels = seen(grid(), R, t, PINHOLE) + np.random.default_rng(seed).normal(0, 0.3, (81, 2))
        pose = planar_poses(grid(), pixels, PINHOLE).solutions[0]
        d = np.r_[t - pose.t, log_so3(R @ pose.R.T)]
        squared.append(d @ np.linalg.solve(pose.covariance, d))
    assert 5.3 < np.mean(squared) < 7.0  # 6.08 expected; standard error of the mean 0.25
    assert 0.90 < np.mean(np.array(squared) < 12.59) < 0.99


def test_far_and_frontal_is_ambiguous_near_and_tilted_is_not() -> None:
    def ambiguity(tilt: float, distance: float) -> float:
        R, t = view(tilt, distance)
        pixels = seen(grid(), R, t, PINHOLE) + np.random.default_rng(0).normal(0, 0.5, (81, 2))
        poses = planar_poses(grid(), pixels, PINHOLE)
        return poses.ambiguity if len(poses.solutions) > 1 else 0.0

    assert ambiguity(25, 12.0) > 0.9
    assert ambiguity(40, 0.6) < 0.3


def test_both_solutions_of_an_ambiguous_view_are_kept_and_one_is_right() -> None:
    R, t = view(25, 12.0)
    pixels = seen(grid(), R, t, PINHOLE) + np.random.default_rng(1).normal(0, 0.3, (81, 2))
    poses = planar_poses(grid(), pixels, PINHOLE)
    assert len(poses.solutions) == 2
    errors = [np.degrees(np.linalg.norm(log_so3(R @ p.R.T))) for p in poses.solutions]
    assert min(errors) < 8
    assert max(errors) > 25
    assert poses.solutions[0].rms_px <= poses.solutions[1].rms_px


@pytest.mark.parametrize("tilt", [10.0, 30.0, 60.0])
@pytest.mark.parametrize("distance", [0.5, 1.5, 5.0])
def test_a_second_solution_is_left_out_only_when_it_is_clearly_worse(tilt: float, distance: float) -> None:
    R, t = view(tilt, distance)
    pixels = seen(grid(), R, t, PINHOLE) + np.random.default_rng(2).normal(0, 0.1, (81, 2))
    poses = planar_poses(grid(), pixels, PINHOLE)

    def residuals(vector: np.ndarray) -> np.ndarray:
        points = grid() @ exp_so3(vector[:3])[:, :2].T + vector[3:]
        return (
            (points[:, :2] / points[:, 2:] * np.diag(K)[:2] + K[:2, 2] - pixels).ravel()
            if points[:, 2].min() > 0
            else behind
        )

    behind = np.full(162, 1e6)
    minima = []
    for start in planar_pose_starts(grid(), PINHOLE.undistort(pixels)[0]):
        found = least_squares(residuals, np.r_[log_so3(start.R), start.t], x_scale="jac", xtol=1e-14)
        minima.append(np.sqrt(2 * found.cost / 162))
    assert poses.solutions[0].rms_px == pytest.approx(min(minima), rel=1e-6)
    if len(poses.solutions) == 2:
        assert poses.ambiguity == pytest.approx(min(minima) / max(minima), rel=1e-4)
    elif max(minima) > min(minima) * (1 + 1e-6):  # another minimum than the first
        assert poses.ambiguity < 0.25
        assert min(minima) / max(minima) < 0.3


def test_degenerate_input() -> None:
    line = np.column_stack((np.linspace(-0.1, 0.1, 10), np.zeros(10)))
    R, t = view(30, 0.6)
    with pytest.raises(DegenerateConfiguration, match="plane_xy"):
        planar_poses(line, seen(line, R, t, PINHOLE), PINHOLE)
    with pytest.raises(TooFewPoints):
        planar_poses(grid()[:3], seen(grid()[:3], R, t, PINHOLE), PINHOLE)
    with pytest.raises(DegenerateConfiguration, match="pixels"):
        planar_poses(grid(), np.full((81, 2), 300.0), PINHOLE)
    absurd = make_camera([[900.0, 0, 1e12], [0, 900.0, 350.0], [0, 0, 1]], (), "plumb_bob", 1280, 720)
    for turn in range(0, 360, 15):
        with contextlib.suppress(EstimationError):  # OpenCV's start can be NaN
            planar_poses(grid(), seen(grid(), *view(30, 0.6, turn), PINHOLE), absurd)


@pytest.mark.parametrize("seed", range(20))
def test_random_pixels_give_an_error_or_a_pose_in_front(seed: int) -> None:
    rng = np.random.default_rng(seed)
    try:
        poses = planar_poses(grid(count=4), rng.uniform(0, 700, (16, 2)), PINHOLE)
    except EstimationError:
        return
    for pose in poses.solutions:
        assert pose.t[2] > 0
        assert np.isfinite(pose.covariance).all()
        assert_allclose(pose.R @ pose.R.T, np.eye(3), atol=1e-9)
