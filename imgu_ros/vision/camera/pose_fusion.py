# SPDX-License-Identifier: Apache-2.0
"""Several estimates of one pose, each with its covariance, as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.arguments import as_sequence, require_type
from imgu_ros.errors import DegenerateConfiguration, NotConverged, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Matrix3, as_matrix
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import as_rotation, exp_so3, log_so3

#: Most iterations: bounds the time where estimates contradict each other.
_MOST_ITERATIONS = 50
#: In units of the result's standard deviations.
_TOLERANCE = 1e-6
#: Of the squared distances with slack from what they should be, relative.
_CLOSE_ENOUGH = 0.05
#: The normal distribution's 99 % quantile.
_QUANTILE_99 = 2.3263


@dataclass(frozen=True, slots=True, eq=False)
class FusedPose:
    """One pose of several.

    Attributes
    ----------
    pose : the fused pose; its `rms_px` is the largest of the estimates'
    disagreement : squared distances of the estimates from the pose that fits them best, in units of their own
        covariances, over the number of degrees of freedom: about 1 when these tell the truth, 0 for a single estimate
    """

    pose: Pose
    disagreement: float


def fuse_poses(poses: Sequence[Pose], slack: Sequence[Floats] | None = None) -> FusedPose:
    """Return the pose that fits independent estimates of it best, weighted by their covariances.

    It minimises the sum of squared residuals in units of the covariances, (t_i - t, Log(R_i R^T)), by Gauss-Newton from
    the most certain estimate (Barfoot, State Estimation for Robotics, 9.1.2, with position and rotation apart). The
    covariance is the inverse of the summed information where the errors are independent. An error that the estimates
    share (`Pose.shared`: the camera's calibration) does not become smaller by their number: the result has it as the
    weights pass it on.

    Where the estimates contradict each other more than chance allows (99 %), something that no covariance knows of is
    wrong with them. With `slack`, which says what that can be up to a factor, each covariance gets as much of its own
    as explains the contradiction (Paule and Mandel 1982), and the fit is made anew; without, the covariance of the
    result grows with the disagreement (Birge 1932).

    Parameters
    ----------
    poses : at least one, all `dst_from_src` of the same two frames; what they share, all of them share
    slack : for each estimate a covariance (6, 6), known up to a common factor

    Returns
    -------
    The fused pose.

    Raises
    ------
    TooFewPoints
        If there are none.
    ShapeError
        If one is no rigid transform with a finite, symmetric (6, 6) covariance, there is not one slack for each, or
        only some share an error.
    DegenerateConfiguration
        If a covariance is not positive definite.
    NotConverged
        If the estimates are so far apart that no pose lies between them.
    """
    poses = as_sequence(poses, "poses")
    slack = None if slack is None else as_sequence(slack, "slack")
    for index, pose in enumerate(poses):
        require_type(pose, Pose, f"poses[{index}]")
    if not poses:
        raise TooFewPoints("poses: none; need at least one")
    if slack is not None and len(slack) != len(poses):
        raise ShapeError(f"slack: {len(slack)}; need {len(poses)}, one for each pose")
    covariances = [_checked(pose.covariance, f"poses[{i}].covariance") for i, pose in enumerate(poses)]
    checked = [
        Pose(
            as_rotation(pose.R, f"poses[{i}]"),
            as_matrix(pose.t, (3,), f"poses[{i}].t"),
            covariances[i],
            pose.rms_px,
            pose.shared,
        )
        for i, pose in enumerate(poses)
    ]
    if len({None if pose.shared is None else np.shape(pose.shared) for pose in poses}) > 1:
        raise ShapeError("poses: of shared errors some have more than others; need the same of all")
    if len(poses) == 1:
        return FusedPose(poses[0], 0.0)
    fit = _fit(checked, covariances)
    freedom = 6 * (len(poses) - 1)
    disagreement = fit.squared / freedom
    covariance = fit.covariance
    if fit.squared > _chi_squared_99(freedom):
        if slack is None:
            covariance = covariance * disagreement
        else:
            extra = [_checked(one, f"slack[{i}]") for i, one in enumerate(slack)]
            fit = _loosened(checked, covariances, extra, freedom)
            covariance = fit.covariance
    shared = _shared(checked, fit.gains)
    if shared is not None:
        # The fit took it for independent: what it made smaller by the number of poses is put back.
        passed = sum(
            gain @ (pose.shared @ pose.shared.T) @ gain.T
            for gain, pose in zip(fit.gains, checked, strict=True)
            if pose.shared is not None
        )
        covariance = covariance - passed + shared @ shared.T
        covariance = (covariance + covariance.T) / 2
    return FusedPose(Pose(fit.R, fit.t, covariance, max(pose.rms_px for pose in poses), shared), disagreement)


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
    require_type(new_from_dst, RigidTransform, "new_from_dst")
    require_type(pose, Pose, "pose")
    R = as_rotation(new_from_dst.R, "new_from_dst")
    moved = RigidTransform(R, as_matrix(new_from_dst.t, (3,), "new_from_dst.t")).after(
        RigidTransform(as_rotation(pose.R, "pose"), as_matrix(pose.t, (3,), "pose.t"))
    )
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R
    covariance = as_matrix(pose.covariance, (6, 6), "pose.covariance")
    shared = None if pose.shared is None else turn @ pose.shared
    return Pose(moved.R, moved.t, turn @ covariance @ turn.T, pose.rms_px, shared)


def pose_after(pose: Pose, src_from_new: RigidTransform) -> Pose:
    """Return `dst_from_new` for a pose `dst_from_src` and a motion of its source, which is known exactly.

    Parameters
    ----------
    pose : `dst_from_src`; the turn's error carries the new origin about the old one
    src_from_new : of the new source in the old one

    Raises
    ------
    ShapeError
        If one of them is no rigid transform.
    """
    require_type(src_from_new, RigidTransform, "src_from_new")
    require_type(pose, Pose, "pose")
    R = as_rotation(src_from_new.R, "src_from_new")
    motion = RigidTransform(R, as_matrix(src_from_new.t, (3,), "src_from_new.t"))
    return pose_seen_from(motion.inverse(), pose.inverse()).inverse()


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """The best pose for some covariances, its own covariance, and the squared distances of the estimates from it.

    `gains` says how each estimate's error is passed on.
    """

    R: Matrix3
    t: Floats
    covariance: Floats
    squared: float
    gains: tuple[Floats, ...]


def _shared(poses: Sequence[Pose], gains: Sequence[Floats]) -> Floats | None:
    """Return the factor of the error that the result shares with all poses by the same camera."""
    passed = [gain @ pose.shared for gain, pose in zip(gains, poses, strict=True) if pose.shared is not None]
    return np.sum(passed, axis=0) if passed else None


def _fit(poses: Sequence[Pose], covariances: Sequence[Floats]) -> _Fit:
    informations = [_inverse(covariance) for covariance in covariances]
    total = np.sum(informations, axis=0)
    inverse = _inverse(total)
    start = min(range(len(poses)), key=lambda i: float(np.trace(covariances[i][:3, :3])))
    R, t = poses[start].R, poses[start].t
    for _ in range(_MOST_ITERATIONS):
        residuals = [np.concatenate((pose.t - t, log_so3(pose.R @ R.T))) for pose in poses]
        step = inverse @ sum(W @ r for W, r in zip(informations, residuals, strict=True))
        R, t = exp_so3(step[3:]) @ R, t + step[:3]
        if float(step @ total @ step) < _TOLERANCE**2:
            squared = float(sum(r @ W @ r for W, r in zip(informations, residuals, strict=True)))
            return _Fit(R, t, inverse, squared, tuple(inverse @ W for W in informations))
    raise NotConverged(f"poses: no pose between {len(poses)} of them; need estimates of the same pose")


def _loosened(poses: Sequence[Pose], covariances: Sequence[Floats], slack: Sequence[Floats], freedom: int) -> _Fit:
    """Return the fit with as much slack as makes the squared distances what they should be on average."""
    # Where the slack outweighs the covariances, the squared distances are in inverse proportion to it: begin there.
    factor = _fit(poses, slack).squared / freedom
    for _ in range(_MOST_ITERATIONS):
        fit = _fit(poses, [own + factor * extra for own, extra in zip(covariances, slack, strict=True)])
        ratio = fit.squared / freedom
        if abs(ratio - 1) < _CLOSE_ENOUGH:
            return fit
        factor *= ratio
    raise NotConverged(f"poses: no slack explains how far apart {len(poses)} of them are; need estimates of one pose")


def _checked(covariance: Floats, name: str) -> Floats:
    """Return a covariance that has an inverse."""
    covariance = as_matrix(covariance, (6, 6), name)
    if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-9 * float(np.abs(covariance).max())):
        raise ShapeError(f"{name}: not symmetric; need a covariance")
    covariance = (covariance + covariance.T) / 2
    try:
        _inverse(covariance)
    except np.linalg.LinAlgError:
        raise DegenerateConfiguration(f"{name}: need a positive definite matrix") from None
    return covariance


def _inverse(matrix: Floats) -> Floats:
    """Return the inverse of a symmetric positive definite matrix; its units may differ by any factor."""
    variances = np.diag(matrix)
    if variances.min() <= 0:
        raise np.linalg.LinAlgError("a variance of 0 or less")
    scale = 1 / np.sqrt(variances)
    half = np.linalg.inv(np.linalg.cholesky(matrix * np.outer(scale, scale)))
    return np.asarray(half.T @ half * np.outer(scale, scale), np.float64)


def _chi_squared_99(freedom: int) -> float:
    """Return the 99 % quantile of the chi-squared distribution, to 1 % (Wilson and Hilferty 1931)."""
    part = 2 / (9 * freedom)
    return float(freedom * (1 - part + _QUANTILE_99 * np.sqrt(part)) ** 3)
