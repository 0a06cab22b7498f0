# SPDX-License-Identifier: Apache-2.0
"""A valid call of the public functions of vision/camera about poses from homographies, for test_hostile.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.camera.homography_pose import poses_about_point, poses_of_homography
from imgu_ros.vision.camera.plane_view import plane_homography
from imgu_ros.vision.camera.pose import PlanarPoses
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.projective.homography import HomographyNormalEquations, homography_normal_equations
from imgu_ros.vision.projective.plane_motion import PlaneMotion

Generator = np.random.Generator

POINTS = np.array([[x + 3.0 * (y == 50), y] for y in (0.0, 50.0, 100.0) for x in (0.0, 40.0, 80.0, 120.0)])
PLANE = np.array([[0.002, 0, -0.12], [0, -0.002, 0.1], [0, 0, 1]])


def K() -> np.ndarray:
    return np.array([[500.0, 0, 320], [0, 490, 240], [0, 0, 1]])


def view() -> np.ndarray:
    """Pixels from metres on the plane."""
    return plane_homography(K(), exp_so3([2.6, 0.3, 0.1]), [0.05, -0.02, 0.6])


def condensed(displacements: Points, H: Matrix3) -> HomographyNormalEquations:
    motions = PlaneMotion(POINTS)
    return homography_normal_equations(
        motions, displacements, motions.fit(displacements, np.ones(12, bool)), H, np.eye(3)
    )


def noise(rng: Generator) -> Points:
    return rng.normal(0, 0.05, POINTS.shape)


def posed(displacements: Points, H: Matrix3) -> PlanarPoses:
    return poses_of_homography(condensed(displacements, H), K(), PLANE)


CALLS: dict[Callable[..., object], Callable[[Generator], dict[str, object]]] = {
    poses_of_homography: lambda rng: {
        "homography": condensed(noise(rng), view() @ PLANE),
        "K": K(),
        "plane_from_src": PLANE.copy(),
    },
    posed: lambda rng: {"displacements": noise(rng), "H": view() @ PLANE},
    poses_about_point: lambda rng: {
        "H": np.linalg.solve(K(), view()) + rng.normal(0, 0.001, (3, 3)),
        "point": rng.uniform(-0.1, 0.1, 2),
    },
}
