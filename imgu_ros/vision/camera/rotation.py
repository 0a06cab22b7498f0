"""Rotations: the exponential map and quaternions (HZ appendix A4.3; notes 8.1.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from imgu_ros.types import Floats, Matrix3, as_matrix


def exp_so3(vector: ArrayLike) -> Matrix3:
    """Return the rotation by |vector| radians about the direction of `vector`, (3,)."""
    return np.asarray(Rotation.from_rotvec(as_matrix(vector, (3,), "vector")).as_matrix(), np.float64)


def log_so3(R: ArrayLike) -> Floats:
    """Return the rotation vector (3,) of R, of length 0 to pi."""
    return np.asarray(Rotation.from_matrix(as_matrix(R, (3, 3), "R")).as_rotvec(), np.float64)


def quaternion(R: ArrayLike) -> Floats:
    """Return R's unit quaternion (x, y, z, w) with w >= 0; at w = 0 the first other non-zero part is positive."""
    q = np.asarray(Rotation.from_matrix(as_matrix(R, (3, 3), "R")).as_quat(), np.float64)
    leading = q[[3, 0, 1, 2]]
    sign = leading[np.flatnonzero(leading != 0)[0]]
    return (q if sign > 0 else -q) + 0.0


def from_quaternion(q: ArrayLike) -> Matrix3:
    """Return the rotation of a quaternion (x, y, z, w), which is normalised first."""
    return np.asarray(Rotation.from_quat(as_matrix(q, (4,), "q")).as_matrix(), np.float64)
