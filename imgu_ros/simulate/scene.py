# SPDX-License-Identifier: Apache-2.0
"""What stands before the camera: printed planes in front of a wall."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.geometry import rotation_about, target_from_template
from imgu_ros.types import Floats, Matrix3, as_image
from imgu_ros.vision.camera.rigid import RigidTransform

_LARGEST_LEAN_RAD = math.radians(12.0)
_GAP = 0.12


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Printed images, each at its pose; x right, y up, z towards the camera, origin amid the targets.

    Attributes
    ----------
    targets : the printed images
    poses : scene_from_target of each
    wall_m : distance of the wall behind the origin; it fills the plane z = -wall_m
    """

    targets: tuple[TargetImage, ...]
    poses: tuple[RigidTransform, ...]
    wall_m: float

    @property
    def radius_m(self) -> float:
        """Radius of a sphere about the origin that holds every target."""
        return max(
            float(np.linalg.norm(pose.t)) + radius_of(target)
            for target, pose in zip(self.targets, self.poses, strict=True)
        )


def arrange_scene(targets: Sequence[TargetImage], seed: int = 0) -> Scene:
    """Place the targets: one alone upright at the origin, several in a grid, each leaning its own way.

    Raises
    ------
    ShapeError
        If there is no target, two share a name, or one has no printed width or is not an 8-bit image.
    """
    if not targets:
        raise ShapeError("targets: none; need at least one")
    names = [t.name for t in targets]
    if len(set(names)) < len(names):
        raise ShapeError(f"targets: names {', '.join(names)}; need distinct names")
    for target in targets:
        as_image(target.pixels, f"target {target.name}", channels=(1, 3), dtypes=(np.uint8,), rescaled=False)
        if target.pixels.dtype != np.uint8:
            raise ShapeError(f"target {target.name}: data type {target.pixels.dtype}; need uint8")
        if not (math.isfinite(target.width_m) and target.width_m > 0):
            raise ShapeError(f"target {target.name}: width {target.width_m:g} m; need more than 0")
    if len(targets) == 1:
        return Scene(tuple(targets), (RigidTransform(np.eye(3), np.zeros(3)),), 0.02 * targets[0].width_m)
    rng = np.random.default_rng([seed, 0x5CE4])
    radius = max(radius_of(t) for t in targets)
    poses = tuple(_leaning(centre, rng) for centre in _grid(targets))
    return Scene(tuple(targets), poses, radius * math.sin(_LARGEST_LEAN_RAD) + 0.02 * radius)


def size_of(target: TargetImage) -> tuple[int, int]:
    """Return width, height of the template, px."""
    return target.pixels.shape[1], target.pixels.shape[0]


def radius_of(target: TargetImage) -> float:
    """Return the distance from the target's centre to a corner, m."""
    width, height = size_of(target)
    return target.sheet_width_m / 2 * math.hypot(1.0, height / width)


def template_matrix(target: TargetImage) -> Matrix3:
    """Return `target_from_template`, the (3, 3) map from template pixels to metres on the target."""
    return target_from_template(size_of(target), target.sheet_width_m)


def _grid(targets: Sequence[TargetImage]) -> Floats:
    """Return centres, (N, 3) m, row by row, such that no two targets touch and their mean is the origin."""
    columns = math.ceil(math.sqrt(len(targets)))
    pitch_x = (1 + _GAP) * max(t.sheet_width_m for t in targets)
    pitch_y = (1 + _GAP) * max(t.sheet_width_m * t.pixels.shape[0] / t.pixels.shape[1] for t in targets)
    # A target rolled by the largest angle needs this much more room.
    room = math.cos(_LARGEST_LEAN_RAD) + math.sin(_LARGEST_LEAN_RAD) * max(pitch_x / pitch_y, pitch_y / pitch_x)
    index = np.arange(len(targets))
    row, column = index // columns, index % columns
    # The last row is centred when it is not full.
    missing = np.where(row == row[-1], -len(targets) % columns, 0)
    centres = np.column_stack(((column + missing / 2) * pitch_x * room, -row * pitch_y * room, 0.0 * index))
    centres -= (centres.min(axis=0) + centres.max(axis=0)) / 2
    return centres


def _leaning(centre: Floats, rng: np.random.Generator) -> RigidTransform:
    azimuth, lean, roll = rng.uniform(0, 2 * math.pi), rng.uniform(0.3, 1.0), rng.uniform(-1.0, 1.0)
    axis = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    R = rotation_about(axis, lean * _LARGEST_LEAN_RAD) @ rotation_about(
        np.array([0.0, 0.0, 1.0]), roll * _LARGEST_LEAN_RAD
    )
    return RigidTransform(R, centre)
