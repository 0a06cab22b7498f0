# SPDX-License-Identifier: Apache-2.0
"""A smooth camera path around a scene: a full roll, tilt, approach and retreat."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.simulate.geometry import rotation_about
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import RigidTransform

_OPTICAL = np.diag([1.0, -1.0, -1.0])  # camera axes right, down, forward from scene axes right, up, towards
_MOST = 1e6


@dataclass(frozen=True, slots=True)
class CameraMotion:
    """How far the camera goes in one sequence.

    Attributes
    ----------
    turns : in-plane turns over the sequence
    tilt_rad : largest angle between the scene's normal and the line of sight to its origin; below pi / 2
    zoom : largest over smallest distance, >= 1
    fill : diameter of the scene over the image's shorter side, from the nearest point
    drift : how far the scene's origin strays from the image's centre, in image widths and heights
    """

    turns: float = 1.0
    tilt_rad: float = math.radians(35.0)
    zoom: float = 2.4
    fill: float = 1.3
    drift: float = 0.06


def camera_from_scene_at(
    progress: float, motion: CameraMotion, camera: Camera, scene_radius_m: float, seed: int = 0
) -> RigidTransform:
    """Return where the camera is, `camera_from_scene`.

    Parameters
    ----------
    progress : 0 at the start of the sequence, 1 at its end; every derivative of the path is continuous in it
    motion : ranges
    camera : for the image size and focal length
    scene_radius_m : radius of a sphere around the scene's origin that holds it
    seed : chooses the phases: where in its range each motion starts

    Raises
    ------
    ShapeError
        If the motion is not one that keeps the scene in front of the camera.
    """
    possible = 1 <= motion.zoom <= _MOST and 0 <= motion.tilt_rad < math.pi / 2 and 0 < motion.fill <= _MOST
    if not (possible and abs(motion.turns) <= _MOST):
        got = f"zoom {motion.zoom:g}, tilt {math.degrees(motion.tilt_rad):g} deg, fill {motion.fill:g}, "
        need = f"zoom 1 to {_MOST:g}, tilt from 0 to below 90 deg, fill above 0, turns of at most {_MOST:g}"
        raise ShapeError(f"motion: {got}turns {motion.turns:g}; need {need}")
    rng = np.random.default_rng([seed, 0xCA3E])
    tilt0, azimuth0, distance0, drift_x0, drift_y0, roll0 = rng.uniform(0, 2 * math.pi, 6)
    turn = 2 * math.pi * progress
    # Two swings of tilt and one of distance in a sequence, each covering its whole range whatever its phase.
    tilt = motion.tilt_rad * (1 - math.cos(2 * turn + tilt0)) / 2
    azimuth = azimuth0 + turn
    nearest = max(2 * float(camera.K[0, 0]) / (motion.fill * min(camera.width, camera.height)), 1.2) * scene_radius_m
    distance = nearest * motion.zoom ** ((1 - math.cos(turn + distance0)) / 2)
    roll = roll0 + motion.turns * turn
    axis = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    looking_at_origin = rotation_about(np.array([0.0, 0.0, 1.0]), roll) @ _OPTICAL @ rotation_about(axis, tilt).T
    stray = np.array(
        [
            motion.drift * camera.width / camera.K[0, 0] * math.sin(turn + drift_x0),
            motion.drift * camera.height / camera.K[1, 1] * math.sin(2 * turn + drift_y0),
        ]
    )
    aside = rotation_about(np.array([0.0, 1.0, 0.0]), math.atan(stray[0])) @ rotation_about(
        np.array([1.0, 0.0, 0.0]), -math.atan(stray[1])
    )
    return RigidTransform(aside @ looking_at_origin, aside @ np.array([0.0, 0.0, distance]))
