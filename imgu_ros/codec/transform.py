"""Rigid transforms as messages need them: inverse with covariance, and the parameters' seven numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import ParameterError
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rotation import from_quaternion


@dataclass(frozen=True, slots=True, eq=False)
class RigidTransform:
    """`dst_from_src`: x_dst = R x_src + t.

    Attributes
    ----------
    R : (3, 3) rotation
    t : (3,) m
    """

    R: Matrix3
    t: Floats

    def after(self, first: RigidTransform) -> RigidTransform:
        """Return the transform that applies `first`, then this one."""
        return RigidTransform(self.R @ first.R, self.R @ first.t + self.t)

    def inverse(self) -> RigidTransform:
        """Return `src_from_dst`."""
        return RigidTransform(self.R.T, -self.R.T @ self.t)


def inverse_pose(pose: Pose) -> Pose:
    """Return `src_from_dst` of a pose `dst_from_src`, its covariance about the new destination's axes.

    With R_true = Exp(d) R and t_true = t + e, the true inverse is, to first order in d and e,

        R_true^T = Exp(-R^T d) R^T
        -R_true^T t_true = -R^T t - R^T e - R^T [t]x d

    so that the errors (e, d) of the pose become J (e, d), J = -[[R^T, R^T [t]x], [0, R^T]]: but for the sign, the
    adjoint of the inverse (Barfoot, State Estimation for Robotics, 7.1.4) with translation first, as ROS orders it.
    """
    R_inverse = pose.R.T
    x, y, z = pose.t
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = -R_inverse
    J[:3, 3:] = -R_inverse @ cross
    return Pose(R_inverse, -R_inverse @ pose.t, J @ pose.covariance @ J.T, pose.rms_px)


def transforms_from_numbers(numbers: Sequence[float], name: str) -> tuple[RigidTransform, ...]:
    """Read transforms from a flat list, seven numbers each: x y z (m), qx qy qz qw (brought to unit length).

    Raises
    ------
    ParameterError
        If their count is no multiple of seven, a number is not finite, or a quaternion is zero.
    """
    values = np.asarray(numbers, dtype=np.float64)
    if values.size % 7 or not np.isfinite(values).all():
        raise ParameterError(f"{name}: {list(numbers)}; need finite numbers, seven a transform: x y z qx qy qz qw")
    rows = values.reshape(-1, 7)
    return tuple(RigidTransform(_rotation(row[3:], f"{name}[{i}]"), row[:3].copy()) for i, row in enumerate(rows))


def _rotation(quaternion: Floats, name: str) -> Matrix3:
    if np.linalg.norm(quaternion) < 1e-6:
        raise ParameterError(f"{name}: quaternion {quaternion.tolist()}; need one of unit length")
    return from_quaternion(quaternion)
