# SPDX-License-Identifier: Apache-2.0
"""Where the camera is in the map, told by all targets seen whose places in it are known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.result import Result
from imgu_ros.types import Floats
from imgu_ros.vision.camera.pose_fusion import FusedPose, fuse_poses, pose_seen_from
from imgu_ros.vision.camera.rigid import RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class MapPlace:
    """Where a reference is in the map, and its printed width, m."""

    map_from_reference: RigidTransform
    width_m: float


def map_places(names: Iterable[str], poses: Sequence[RigidTransform], widths_m: Sequence[float]) -> dict[str, MapPlace]:
    """Return the places of references by their names; of those that have both a pose and a width."""
    return {name: MapPlace(pose, width) for name, pose, width in zip(names, poses, widths_m, strict=False)}


def camera_in_map(result: Result, places: Mapping[str, MapPlace]) -> FusedPose | None:
    """Return `map_from_camera`, fused over the references by their covariances; None when none has a pose.

    The error of each reference's pose is its own (other pixels, other noise). Their places are taken as exact as long
    as that explains the poses. When references contradict each other, all are taken to be misplaced, their corners by
    the same standard deviation, as large as explains it.

    Parameters
    ----------
    result : of a frame
    places : of the references, by name

    Raises
    ------
    EstimationError
        If the poses contradict each other so much that no pose lies between them.
    """
    poses, slack = [], []
    for found in result:
        if found.pose is not None and found.name in places:
            place = places[found.name]
            pose = pose_seen_from(place.map_from_reference, found.pose.inverse())
            poses.append(pose)
            slack.append(_misplacement(place.map_from_reference.t - pose.t, place.width_m))
    return fuse_poses(poses, slack) if poses else None


def _misplacement(from_camera: Floats, width_m: float) -> Floats:
    """Return the covariance (6, 6) of the camera's pose when a target's corners are misplaced by one metre.

    Four corners half a width from the centre give the centre's place to 1/2 m and its turn to 1 / `width_m` rad.

    Parameters
    ----------
    from_camera : (3,) m, the target's place less the camera's, in the map
    """
    x, y, z = from_camera
    # The target's turn carries the camera around the target: by turn x (camera - target).
    J = np.eye(6)
    J[:3, 3:] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    return np.asarray(J @ np.diag([0.25] * 3 + [width_m**-2] * 3) @ J.T, np.float64)
