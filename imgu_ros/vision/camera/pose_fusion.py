"""Several estimates of one pose, each with its covariance, as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import DegenerateConfiguration, NotConverged, ShapeError, TooFewPoints
from imgu_ros.types import Floats, as_matrix
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import as_rotation, exp_so3, log_so3

_MOST_ITERATIONS = 50
#: In units of the result's standard deviations.
_TOLERANCE = 1e-6
#: The normal distribution's 99 % quantile.
_QUANTILE_99 = 2.3263


@dataclass(frozen=True, slots=True, eq=False)
class FusedPose:
    """One pose of several.

    Attributes
    ----------
    pose : the fused pose; its `rms_px` is the largest of the estimates'
    disagreement : squared distances of the estimates from it, in units of their covariances, over their number of
        degrees of freedom: about 1 when the covariances tell the truth, 0 for a single estimate
    """

    pose: Pose
    disagreement: float


def fuse_poses(poses: Sequence[Pose]) -> FusedPose:
    """Return the pose that fits independent estimates of it best, weighted by their covariances.

    It minimises the sum of squared residuals in units of the covariances, (t_i - t, Log(R_i R^T)), by Gauss-Newton from
    the most certain estimate (Barfoot, State Estimation for Robotics, 9.1.2, with position and rotation apart). The
    covariance is the inverse of the summed information. Where the estimates contradict each other more than chance
    allows (99 %), something that no covariance knows of is wrong with one of them: the covariance then grows with the
    disagreement (Birge 1932).

    Parameters
    ----------
    poses : at least one, all `dst_from_src` of the same two frames

    Returns
    -------
    The fused pose.

    Raises
    ------
    TooFewPoints
        If there are none.
    ShapeError
        If one is no rigid transform with a finite, symmetric (6, 6) covariance.
    DegenerateConfiguration
        If a covariance is not positive definite.
    NotConverged
        If the estimates are so far apart that no pose lies between them.
    """
    if not poses:
        raise TooFewPoints("poses: none; need at least one")
    informations = [_information(pose, f"poses[{i}]") for i, pose in enumerate(poses)]
    if len(poses) == 1:
        return FusedPose(poses[0], 0.0)
    start = min(poses, key=lambda pose: float(np.trace(pose.covariance[:3, :3])))
    R, t = start.R, start.t
    total = np.sum(informations, axis=0)
    covariance = _inverse(total)
    for _ in range(_MOST_ITERATIONS):
        residuals = [np.concatenate((pose.t - t, log_so3(pose.R @ R.T))) for pose in poses]
        step = covariance @ sum(W @ r for W, r in zip(informations, residuals, strict=True))
        R, t = exp_so3(step[3:]) @ R, t + step[:3]
        if float(step @ total @ step) < _TOLERANCE**2:
            break
    else:
        raise NotConverged(f"poses: no pose between {len(poses)} of them; need estimates of the same pose")
    freedom = 6 * (len(poses) - 1)
    squared = float(sum(r @ W @ r for W, r in zip(informations, residuals, strict=True)))
    if squared > _chi_squared_99(freedom):
        covariance = covariance * (squared / freedom)
    rms_px = max(pose.rms_px for pose in poses)
    return FusedPose(Pose(R, t, covariance, rms_px), squared / freedom)


def pose_seen_from(new_from_dst: RigidTransform, pose: Pose) -> Pose:
    """Return `new_from_src` for a pose `dst_from_src` and where its destination is, which is known exactly.

    Parameters
    ----------
    new_from_dst : of the destination in the new frame
    pose : `dst_from_src`; its covariance is turned into the new frame's axes

    Raises
    ------
    ShapeError
        If one of them is no rigid transform.
    """
    R = as_rotation(new_from_dst.R, "new_from_dst")
    moved = RigidTransform(R, as_matrix(new_from_dst.t, (3,), "new_from_dst.t")).after(
        RigidTransform(as_rotation(pose.R, "pose"), as_matrix(pose.t, (3,), "pose.t"))
    )
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R
    covariance = as_matrix(pose.covariance, (6, 6), "pose.covariance")
    return Pose(moved.R, moved.t, turn @ covariance @ turn.T, pose.rms_px)


def _information(pose: Pose, name: str) -> Floats:
    as_rotation(pose.R, name)
    as_matrix(pose.t, (3,), f"{name}.t")
    covariance = as_matrix(pose.covariance, (6, 6), f"{name}.covariance")
    if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-9 * float(np.abs(covariance).max())):
        raise ShapeError(f"{name}.covariance: not symmetric; need a covariance")
    if np.diag(covariance).min() <= 0:
        raise DegenerateConfiguration(f"{name}.covariance: a variance of 0 or less; need a positive definite matrix")
    try:
        return _inverse((covariance + covariance.T) / 2)
    except np.linalg.LinAlgError:
        raise DegenerateConfiguration(f"{name}.covariance: need a positive definite matrix") from None


def _inverse(matrix: Floats) -> Floats:
    """Return the inverse of a symmetric positive definite matrix; its units may differ by any factor."""
    scale = 1 / np.sqrt(np.diag(matrix))
    half = np.linalg.inv(np.linalg.cholesky(matrix * np.outer(scale, scale)))
    return np.asarray(half.T @ half * np.outer(scale, scale), np.float64)


def _chi_squared_99(freedom: int) -> float:
    """Return the 99 % quantile of the chi-squared distribution, to 1 % (Wilson and Hilferty 1931)."""
    part = 2 / (9 * freedom)
    return float(freedom * (1 - part + _QUANTILE_99 * np.sqrt(part)) ** 3)
