# SPDX-License-Identifier: Apache-2.0
"""The rough wall behind the targets: an endless plane with a repeating grey texture."""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np

from imgu_ros.simulate.optics import PlaneMap
from imgu_ros.simulate.texture import wall_texture
from imgu_ros.types import Image, Matrix3
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.scale_space.pyramid import PixelScaling

_SIDE_PX = 1024
#: The texture repeats after this many scene radii.
_PERIOD_RADII = 4.0
#: Mean reflectance by plane.
WALL_REFLECTANCE = {"r": 0.24, "g": 0.23, "b": 0.21, "y": 0.23}


class Wall:
    """Texture levels of the wall, each half the size of the one before."""

    def __init__(self, scene_radius_m: float) -> None:
        """Scale the texture to a scene of this radius."""
        self._texel_m = _PERIOD_RADII * scene_radius_m / _SIDE_PX
        self._levels = _levels()

    def image_from_wall(self, K: Matrix3, camera_from_scene: RigidTransform, wall_m: float) -> Matrix3:
        """Return the (3, 3) map from texels to ideal pixels, w > 0 in front of the camera; of N poses (N, 3, 3)."""
        R, t = camera_from_scene.R, camera_from_scene.t
        plane = np.stack((R[..., 0] * self._texel_m, -R[..., 1] * self._texel_m, t - wall_m * R[..., 2]), axis=-1)
        H: Matrix3 = K @ plane
        return H

    def level_for(self, step_px: float) -> int:
        """Return the level for single samples `step_px` texels apart."""
        wanted = math.ceil(math.log2(step_px / 1.2)) if 0 < step_px < math.inf else len(self._levels)
        return min(max(wanted, 0), len(self._levels) - 1)

    def level_from_wall(self, level: int) -> Matrix3:
        """Return the (3, 3) map from texels to the level's pixels."""
        return PixelScaling(2.0**level).reduced_from_full

    def roughness(self, level: int, m: PlaneMap) -> Image:
        """Return the wall's relative reflectance, (rows, columns) float32 around 1; beyond its horizon 1."""
        rough = cv2.remap(self._levels[level], m.u, m.v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        rough[~m.front] = 1.0
        return rough


@cache
def _levels() -> tuple[Image, ...]:
    """Return the texture at full size, a half, a fourth, ...; every wall is the same."""
    levels = [wall_texture(_SIDE_PX)]
    while levels[-1].shape[0] > 4:
        levels.append(cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    return tuple(levels)
