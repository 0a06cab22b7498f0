# SPDX-License-Identifier: Apache-2.0
"""Euler angles, with their order by name (IU 8.1.5)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.types import Choice, Floats, Matrix3, as_matrix
from imgu_ros.vision.camera.rotation import as_rotation, exp_so3

#: cos of the middle angle below which the outer two axes coincide: only the sum of their angles is known.
_LOCK = 1e-12


class EulerOrder(Choice):
    """Which product of rotations about the axes the angles stand for.

    The elementary rotations are the usual, right-handed ones; the R_y of IU 8.1.5 is printed transposed.
    """

    XYZ = "xyz"  #: R = R_x R_y R_z, as in IU 8.1.5
    ZYX = "zyx"  #: R = R_z R_y R_x: ROS's roll, pitch and yaw about fixed axes (REP 103)


def from_euler(angles: ArrayLike, order: EulerOrder | str) -> Matrix3:
    """Return the rotation of three angles.

    Parameters
    ----------
    angles : (3,) rad, about x, y and z, in this order whatever `order` is
    order : of the product

    Raises
    ------
    ShapeError
        If the angles are not three finite numbers, or the order is unknown.

    Examples
    --------
    >>> from_euler([0.1, -0.4, 2.0], "zyx").round(3).tolist()
    [[-0.383, -0.889, 0.252], [0.838, -0.449, -0.311], [0.389, 0.092, 0.916]]
    """
    order = EulerOrder(order)
    x, y, z = (exp_so3(axis * angle) for axis, angle in zip(np.eye(3), as_matrix(angles, (3,), "angles"), strict=True))
    return x @ y @ z if order is EulerOrder.XYZ else z @ y @ x


def euler_angles(R: ArrayLike, order: EulerOrder | str) -> Floats:
    """Return the angles of a rotation; the inverse of `from_euler`.

    The angle about y lies in [-pi/2, pi/2], the others in [-pi, pi]. In gimbal lock (y at either end) only their sum
    or difference is determined; the one about z is then 0.

    Returns
    -------
    (3,) rad, about x, y and z

    Raises
    ------
    ShapeError
        If R is not a rotation, or the order is unknown.

    Examples
    --------
    >>> euler_angles(from_euler([0.1, -0.4, 2.0], "xyz"), "xyz").round(6).tolist()
    [0.1, -0.4, 2.0]
    """
    R = as_rotation(R)
    if EulerOrder(order) is EulerOrder.ZYX:
        # (R_z R_y R_x)^T = R_x^T R_y^T R_z^T: the other order, all angles negated.
        return -euler_angles(R.T, EulerOrder.XYZ) + 0.0
    cosine = math.hypot(R[0, 0], R[0, 1])
    y = math.atan2(R[0, 2], cosine)
    z = math.atan2(-R[0, 1], R[0, 0]) if cosine > _LOCK else 0.0
    # x from what is left after z is undone: exact near the lock too, where z itself is mostly rounding.
    left = R @ exp_so3([0.0, 0.0, -z])
    return np.array([math.atan2(left[2, 1], left[1, 1]), y, z]) + 0.0
