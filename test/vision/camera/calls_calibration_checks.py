# SPDX-License-Identifier: Apache-2.0
"""A valid call of the public functions of vision/camera about the calibration that poses are made with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.types import Floats, Points
from imgu_ros.vision.camera.calibration_evidence import CalibrationEvidence, weigh_calibration
from imgu_ros.vision.camera.calibration_test import CalibrationTest
from imgu_ros.vision.camera.camera_covariance import (
    as_covariance,
    factor_of,
    with_covariance,
)
from imgu_ros.vision.camera.camera_derivatives import ideal_by_camera, raw_by_camera
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rotation import exp_so3

Generator = np.random.Generator

PLANE = np.array([[x, y] for y in (-0.1, 0.0, 0.1) for x in (-0.15, -0.05, 0.05, 0.15)])


def camera() -> Camera:
    lens = make_camera([[500, 0, 320], [0, 490, 240], [0, 0, 1]], (-0.2, 0.05), "plumb_bob", 640, 480)
    return with_covariance(lens, np.diag([1.0, 1, 1, 1, 1e-4, 1e-4, 1e-6, 1e-6, 1e-4]))


def pose() -> Pose:
    return Pose(exp_so3([2.6, 0.3, 0.1]), np.array([0.05, -0.02, 0.6]), np.eye(6) * 1e-6, 0.1)


def seen(rng: Generator) -> Points:
    return camera().project(PLANE @ pose().R[:, :2].T + pose().t) + rng.normal(0, 0.1, PLANE.shape)


def test_of(pixels: Points) -> CalibrationTest:
    test = planar_poses(PLANE, pixels, camera()).calibration
    assert test is not None
    return test


def weighed(by_camera: Floats, residual: Floats, covariance: Floats) -> CalibrationEvidence:
    test = CalibrationTest(residual, covariance, by_camera, np.zeros((6, 9)))
    return weigh_calibration([test], camera())


CALLS: dict[Callable[..., object], Callable[[Generator], dict[str, object]]] = {
    weigh_calibration: lambda rng: {"tests": [test_of(seen(rng)) for _ in range(8)], "camera": camera()},
    weighed: lambda rng: {
        "by_camera": rng.normal(size=(2, 9)),
        "residual": rng.normal(size=2),
        "covariance": np.eye(2),
    },
    with_covariance: lambda rng: {"camera": camera(), "covariance": np.eye(9)},
    as_covariance: lambda rng: {"covariance": np.eye(4), "name": "covariance"},
    Pose.with_shared_error: lambda rng: {"self": pose(), "factor": rng.normal(size=(6, 3))},
    factor_of: lambda rng: {"covariance": np.eye(5)},
    raw_by_camera: lambda rng: {"camera": camera(), "points": PLANE @ pose().R[:, :2].T + pose().t},
    ideal_by_camera: lambda rng: {"camera": camera(), "ideal": seen(rng)},
}
