# SPDX-License-Identifier: Apache-2.0
"""Where the camera is in the map, told by all targets seen whose places in it are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imgu_ros.result import Result
from imgu_ros.types import Floats
from imgu_ros.vision.camera.pose_fusion import FusedPose, fuse_poses, pose_seen_from
from imgu_ros.vision.camera.rigid import RigidTransform


def camera_in_map(
    result: Result, map_from_target: Sequence[RigidTransform], widths_m: Sequence[float]
) -> FusedPose | None:
    """Return `map_from_camera`, fused over the targets by their covariances; None when no target has a pose.

    Each target's own error is its alone (other pixels, other noise). The targets' places are taken as exact as long as
    that explains what is seen. When targets contradict each other, all are taken to be misplaced, their corners by the
    same deviation, as large as explains it.

    Parameters
    ----------
    result : a frame's
    map_from_target : of each target, in the order of `targets.images`
    widths_m : of each target with a pose

    Raises
    ------
    EstimationError
        If the targets' poses contradict each other so much that no pose lies between them.
    """
    posed = [target for target in result if target.pose is not None]
    poses = [
        pose_seen_from(map_from_target[target.number], target.pose.inverse())
        for target in posed
        if target.pose is not None
    ]
    slack = [
        _misplacement(map_from_target[target.number].t - pose.t, widths_m[target.number])
        for target, pose in zip(posed, poses, strict=True)
    ]
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
