"""Where the camera is in the map, told by all targets seen whose places in it are known."""

from __future__ import annotations

from collections.abc import Sequence

from imgu_ros.perception.result import Result
from imgu_ros.vision.camera.pose_fusion import FusedPose, fuse_poses, pose_seen_from
from imgu_ros.vision.camera.rigid import RigidTransform


def camera_in_map(result: Result, map_from_target: Sequence[RigidTransform]) -> FusedPose | None:
    """Return `map_from_camera`, fused over the targets by their covariances; None when no target has a pose.

    Each target's own error is its alone (other pixels, other noise); the targets' places are taken as exact. Where they
    are not, the targets disagree, and the covariance says so (`fuse_poses`).

    Parameters
    ----------
    result : a frame's
    map_from_target : of each target, in the order of `targets.images`

    Raises
    ------
    EstimationError
        If the targets' poses contradict each other so much that no pose lies between them.
    """
    poses = [
        pose_seen_from(map_from_target[target.index], target.pose.inverse())
        for target in result.targets
        if target.pose is not None
    ]
    return fuse_poses(poses) if poses else None
