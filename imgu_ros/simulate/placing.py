# SPDX-License-Identifier: Apache-2.0
"""Where the camera stands when something about the view is prescribed: the target's size, its tilt, what is cut off."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.geometry import image_from_template, rotation_about
from imgu_ros.simulate.path import CameraMotion, camera_from_scene_at
from imgu_ros.simulate.scene import Scene, size_of, template_matrix
from imgu_ros.simulate.truth import points_in_image
from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import RigidTransform

_OPTICAL = np.diag([1.0, -1.0, -1.0])
#: A target so near that it reaches beside the camera is tilted less: its nearest point keeps this share of the depth.
_NEAREST_DEPTH = 0.4
_GRID = 33
_LARGEST_TURN_RAD = math.radians(80)


@dataclass(frozen=True, slots=True)
class Placing:
    """What is prescribed; the rest is as in a `CameraMotion`.

    Attributes
    ----------
    motion : the path
    tilt_rad : angle between the target's normal and the line of sight to its centre, all the time; None: the motion's
    width_share : width that the target would have, seen upright, over the image's width; None: the motion's distances
    outside : share of the target's area that lies outside the image
    """

    motion: CameraMotion = field(default_factory=CameraMotion)
    tilt_rad: float | None = None
    width_share: float | None = None
    outside: float = 0.0


def camera_before_target(progress: float, placing: Placing, camera: Camera, scene: Scene, seed: int) -> RigidTransform:
    """Return where the camera is, `camera_from_scene`.

    Parameters
    ----------
    progress : 0 at the start of a sequence, 1 at its end; the path is smooth in it
    placing : what is prescribed
    camera, scene : what sees what; prescriptions hold for the scene's first target
    seed : chooses the phases of the motions

    Raises
    ------
    ShapeError
        If the prescription cannot be met.
    """
    motion = placing.motion
    if placing.outside:
        motion = replace(motion, drift=0.0)
    if placing.tilt_rad is None and placing.width_share is None:
        pose = camera_from_scene_at(progress, motion, camera, scene.radius_m, seed)
    else:
        pose = _prescribed(progress, placing, motion, camera, scene, seed)
    if placing.outside:
        direction = 2 * math.pi * (progress + float(np.random.default_rng([seed, 0x0D1E]).random()))
        pose = _turned_away(pose, direction, placing.outside, camera, scene)
    return pose


def outside_share(camera_from_scene: RigidTransform, camera: Camera, scene: Scene) -> float:
    """Return the share of the first target's area that the image does not show."""
    target = scene.targets[0]
    H = image_from_template(camera.K, camera_from_scene.after(scene.poses[0]), template_matrix(target))
    inside = points_in_image(H, _area_grid(target), (camera.width, camera.height), camera)
    return 1.0 - float(inside.mean())


def _prescribed(
    progress: float, placing: Placing, motion: CameraMotion, camera: Camera, scene: Scene, seed: int
) -> RigidTransform:
    rng = np.random.default_rng([seed, 0x91AC])
    tilt0, azimuth0, distance0, drift_x0, drift_y0, roll0 = rng.uniform(0, 2 * math.pi, 6)
    turn = 2 * math.pi * progress
    f = float(camera.K[0, 0])
    if placing.width_share is None:
        nearest = max(2 * f / (motion.fill * min(camera.width, camera.height)), 1.2) * scene.radius_m
        distance = nearest * motion.zoom ** ((1 - math.cos(turn + distance0)) / 2)
    else:
        distance = f * scene.targets[0].width_m / (placing.width_share * camera.width)
    if placing.tilt_rad is None:
        tilt = motion.tilt_rad * (1 - math.cos(2 * turn + tilt0)) / 2
        tilt = min(tilt, math.asin(min(1.0, (1 - _NEAREST_DEPTH) * distance / scene.radius_m)))
    else:
        tilt = placing.tilt_rad
    azimuth = azimuth0 + turn
    axis = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    roll = rotation_about(np.array([0.0, 0.0, 1.0]), roll0 + motion.turns * turn)
    aside = _turn(
        motion.drift * camera.width / f * math.sin(turn + drift_x0),
        motion.drift * camera.height / f * math.sin(2 * turn + drift_y0),
    )
    R = aside @ roll @ _OPTICAL @ rotation_about(axis, tilt).T
    return RigidTransform(R, aside @ np.array([0.0, 0.0, distance]))


def _turned_away(
    pose: RigidTransform, direction: float, outside: float, camera: Camera, scene: Scene
) -> RigidTransform:
    """Turn the camera until it misses the share of the target."""
    axis = np.array([-math.sin(direction), math.cos(direction), 0.0])

    def turned(angle: float) -> RigidTransform:
        R = rotation_about(axis, angle)
        return RigidTransform(R @ pose.R, R @ pose.t)

    low, high = 0.0, _LARGEST_TURN_RAD
    if outside_share(pose, camera, scene) > outside:
        raise ShapeError(f"outside: {outside:g}; need more than what is outside already")
    for _ in range(24):
        middle = (low + high) / 2
        t = turned(middle)
        visible_centre = (t.after(scene.poses[0])).t[2] > 0
        if visible_centre and outside_share(t, camera, scene) <= outside:
            low = middle
        else:
            high = middle
    return turned(low)


def _turn(x_rad: float, y_rad: float) -> Matrix3:
    return rotation_about(np.array([0.0, 1.0, 0.0]), x_rad) @ rotation_about(np.array([1.0, 0.0, 0.0]), -y_rad)


def _area_grid(target: TargetImage) -> Points:
    """Return the middles of equal parts of the target, (N, 2) template px."""
    width, height = size_of(target)
    share = (np.arange(_GRID) + 0.5) / _GRID
    x, y = np.meshgrid(share * width - 0.5, share * height - 0.5)
    return np.column_stack((x.ravel(), y.ravel()))
