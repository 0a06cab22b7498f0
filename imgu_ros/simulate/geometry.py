# SPDX-License-Identifier: Apache-2.0
"""The homographies between template, printed plane and image that follow from a pose, exact to rounding."""

from __future__ import annotations

import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.rigid import RigidTransform


def image_from_template(K: Matrix3, camera_from_target: RigidTransform, target_from_template: Matrix3) -> Matrix3:
    """Return H_image_template of a printed plane: unit Frobenius norm, w > 0 at the target's centre.

    A point of the target's plane z = 0 projects by K [r1 r2 t] (IU 8.1.5). Of many poses, R (N, 3, 3) and t (N, 3),
    it is (N, 3, 3).

    Raises
    ------
    ShapeError
        If the target's centre is not in front of the camera.
    """
    R, t = camera_from_target.R, camera_from_target.t
    if not (t[..., 2] > 0).all():
        raise ShapeError(f"target: its centre is at z {t[..., 2].min():g} m; need z > 0 (in front of the camera)")
    plane = np.stack((R[..., 0], R[..., 1], t), axis=-1)
    H: Matrix3 = K @ plane @ target_from_template
    # w at the centre is the depth of the target's origin, positive by the check above.
    return H / (np.linalg.norm(H) if H.ndim == 2 else np.linalg.norm(H, axis=(1, 2), keepdims=True))


def target_from_template(size: tuple[int, int], width_m: float) -> Matrix3:
    """Return the matrix from template pixels to metres on the target.

    Parameters
    ----------
    size : width, height of the template, px
    width_m : printed width, outer edge to outer edge
    """
    width, height = size
    s = width_m / width
    return np.array([[s, 0.0, -s * (width - 1) / 2], [0.0, -s, s * (height - 1) / 2], [0.0, 0.0, 1.0]])


def rotation_about(axis: Floats, angle_rad: float) -> Matrix3:
    """Return the rotation by `angle_rad` about `axis`, (3,), of any length but 0 (Rodrigues' formula)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Matrix3 = np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * (cross @ cross)
    return rotation
