# SPDX-License-Identifier: Apache-2.0
"""The camera's path: smooth, through its whole range, with the target in view."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.geometry import image_from_template
from imgu_ros.simulate.path import CameraMotion, camera_from_scene_at
from imgu_ros.simulate.scene import arrange_scene, radius_of, template_matrix
from imgu_ros.simulate.sequence import default_camera
from imgu_ros.simulate.truth import points_in_image, target_grid
from imgu_ros.vision.camera.rigid import RigidTransform

CAMERA = default_camera(1280, 720)
TARGET = TargetImage("t", np.zeros((960, 1280, 3), np.uint8), 0.5)
RADIUS = arrange_scene([TARGET]).radius_m


def path(count: int, seed: int, motion: CameraMotion | None = None) -> list[RigidTransform]:
    return [camera_from_scene_at(p, motion or CameraMotion(), CAMERA, RADIUS, seed) for p in np.linspace(0, 1, count)]


def tilt_of(pose: RigidTransform) -> float:
    """Angle between the target's normal and the line from its centre to the camera."""
    centre = pose.inverse().t
    return math.acos(centre[2] / np.linalg.norm(centre))


@pytest.mark.parametrize("seed", range(6))
def test_ranges_are_covered(seed: int) -> None:
    poses = path(400, seed)
    distance = np.array([np.linalg.norm(p.t) for p in poses])
    tilt = np.degrees([tilt_of(p) for p in poses])
    assert distance.max() / distance.min() == pytest.approx(2.4, rel=0.002)
    assert tilt.max() == pytest.approx(35, abs=0.1)
    assert tilt.min() < 0.2
    for p in poses:
        np.testing.assert_allclose(p.R @ p.R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(p.R) == pytest.approx(1)


@pytest.mark.parametrize("seed", range(6))
def test_target_turns_once_and_stays_in_view(seed: int) -> None:
    directions, shares = [], []
    for pose in path(200, seed):
        H = image_from_template(CAMERA.K, pose, template_matrix(TARGET))
        middle, right = (H @ [x, 479.5, 1] for x in (639.5, 640.5))
        step = right[:2] / right[2] - middle[:2] / middle[2]
        directions.append(math.atan2(step[1], step[0]))
        shares.append(points_in_image(H, target_grid((1280, 960), 9), (1280, 720)).mean())
        assert middle[2] > 0
        assert np.abs(middle[:2] / middle[2] - (640, 360)).max() < 120
        assert np.linalg.norm(H) == pytest.approx(1)
        assert np.linalg.det(H) > 0
    turned = np.unwrap(directions)
    assert abs(turned[-1] - turned[0]) == pytest.approx(2 * math.pi, abs=1e-6)
    assert min(shares) > 0.6
    assert np.mean(np.array(shares) == 1) > 0.4


@pytest.mark.parametrize("seed", range(3))
def test_path_is_smooth(seed: int) -> None:
    # Halving the time step divides second differences by four, third differences by eight.
    def numbers(count: int) -> np.ndarray:
        return np.array([np.concatenate((p.R.ravel(), p.t)) for p in path(count, seed)])

    coarse, fine = numbers(201), numbers(401)
    for order, factor in ((1, 2), (2, 4), (3, 8)):
        ratio = np.abs(np.diff(coarse, order, axis=0)).max() / np.abs(np.diff(fine, order, axis=0)).max()
        assert ratio == pytest.approx(factor, rel=0.1)


def test_seed_chooses_the_path() -> None:
    a, again, b = path(3, 1), path(3, 1), path(3, 2)
    np.testing.assert_array_equal(a[1].R, again[1].R)
    assert np.abs(a[1].t - b[1].t).max() > 0.01


def test_still_camera() -> None:
    poses = path(5, 0, CameraMotion(turns=0, tilt_rad=0, zoom=1, drift=0))
    for pose in poses:
        np.testing.assert_allclose(pose.R, poses[0].R, atol=1e-12)
        np.testing.assert_allclose(pose.t, poses[0].t, atol=1e-12)


@pytest.mark.parametrize(
    "motion", [CameraMotion(zoom=0.5), CameraMotion(tilt_rad=2.0), CameraMotion(fill=0), CameraMotion(zoom=math.nan)]
)
def test_impossible_motion_is_refused(motion: CameraMotion) -> None:
    with pytest.raises(ShapeError, match="motion"):
        path(1, 0, motion)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 9])
def test_several_targets_do_not_touch(count: int) -> None:
    targets = [TargetImage(f"t{i}", np.zeros((60, 80 + 7 * i), np.uint8), 0.3 + 0.05 * (i % 3)) for i in range(count)]
    scene = arrange_scene(targets, seed=count)
    outlines = []
    for target, pose in zip(scene.targets, scene.poses, strict=True):
        height = target.width_m * target.pixels.shape[0] / target.pixels.shape[1]
        corners = np.array([(x, y, 0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) * (
            target.width_m / 2,
            height / 2,
            0,
        )
        world = corners @ pose.R.T + pose.t
        assert (world[:, 2] > -scene.wall_m).all()
        assert (np.linalg.norm(world, axis=1) <= scene.radius_m + 1e-9).all()
        assert radius_of(target) == pytest.approx(np.linalg.norm(corners[0]))
        outlines.append(world[:, :2])
    for i, a in enumerate(outlines):
        for b in outlines[:i]:
            assert separated(a, b)


def separated(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether a side of one convex polygon parts it from the other (separating axes)."""
    for polygon in (a, b):
        for edge in np.roll(polygon, -1, axis=0) - polygon:
            normal = np.array([-edge[1], edge[0]])
            if (a @ normal).max() < (b @ normal).min() or (b @ normal).max() < (a @ normal).min():
                return True
    return False


def test_scenes_that_cannot_be_are_refused() -> None:
    picture = np.zeros((60, 80), np.uint8)
    with pytest.raises(ShapeError, match="need at least one"):
        arrange_scene([])
    with pytest.raises(ShapeError, match="distinct"):
        arrange_scene([TargetImage("t", picture, 1.0), TargetImage("t", picture, 1.0)])
    with pytest.raises(ShapeError, match="width"):
        arrange_scene([TargetImage("t", picture, 0.0)])
    with pytest.raises(ShapeError, match="data type"):
        arrange_scene([TargetImage("t", picture.astype(np.uint16), 1.0)])
