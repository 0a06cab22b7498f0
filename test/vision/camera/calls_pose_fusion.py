# SPDX-License-Identifier: Apache-2.0
"""Valid calls of the fusion of poses, for the hostile test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.pose_fusion import fuse_poses, pose_after, pose_seen_from
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3

Generator = np.random.Generator


def pose(rng: Generator) -> Pose:
    root = rng.normal(size=(6, 6)) * 0.01
    return Pose(exp_so3(rng.normal(0, 0.01, 3)), rng.normal(0, 0.01, 3), root @ root.T + 1e-4 * np.eye(6), 0.2)


def fused(R: np.ndarray, t: np.ndarray, covariance: np.ndarray) -> Pose:
    return fuse_poses([Pose(R, t, covariance, 0.2), Pose(np.eye(3), np.zeros(3), 0.01 * np.eye(6), 0.1)]).pose


def seen(R: np.ndarray, t: np.ndarray, covariance: np.ndarray) -> Pose:
    return pose_seen_from(RigidTransform(R, t), Pose(R, t, covariance, 0.2))


def parts(rng: Generator) -> dict[str, Any]:
    one = pose(rng)
    return {"R": one.R, "t": one.t, "covariance": one.covariance}


CALLS: dict[Callable[..., Any], Callable[[Generator], dict[str, Any]]] = {
    fuse_poses: lambda rng: {"poses": [pose(rng), pose(rng)], "slack": [np.eye(6), np.eye(6)]},
    pose_seen_from: lambda rng: {"new_from_dst": RigidTransform(exp_so3([0.1, 0, 0]), np.ones(3)), "pose": pose(rng)},
    pose_after: lambda rng: {"pose": pose(rng), "src_from_new": RigidTransform(exp_so3([0.1, 0, 0]), np.ones(3))},
    fused: parts,
    seen: parts,
}
