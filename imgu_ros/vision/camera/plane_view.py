# SPDX-License-Identifier: Apache-2.0
"""A plane seen by a camera: H = K [r1 r2 t], and back to the pose (IU 8.1.5; Zhang 2000, section 2.2)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Matrix3, as_matrix
from imgu_ros.vision.camera.projection import as_intrinsic_matrix
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import as_rotation, nearest_rotation

#: Shortest of K^-1 H's first two columns as a share of the longest: below, the plane is seen edge on or not at all.
_SHORTEST = 1e-9


def plane_homography(K: ArrayLike, R: ArrayLike, t: ArrayLike) -> Matrix3:
    """Return H_image_plane of the plane z = 0 of the world, (x, y) -> px, without distortion.

    Parameters
    ----------
    K : (3, 3) px
    R, t : (3, 3) and (3,) m, camera_from_plane

    Returns
    -------
    (3, 3) of unit Frobenius norm, with a positive third coordinate for points in front of the camera

    Raises
    ------
    ShapeError
        If K is no intrinsic matrix, R no rotation, or t not three finite numbers.
    DegenerateConfiguration
        If the plane goes through the camera's centre.

    Examples
    --------
    >>> H = plane_homography([[100, 0, 50], [0, 100, 40], [0, 0, 1]], np.eye(3), [0, 0, 2])
    >>> (H / H[2, 2]).round(6).tolist()
    [[50.0, 0.0, 50.0], [0.0, 50.0, 40.0], [0.0, 0.0, 1.0]]
    """
    K, R, t = as_intrinsic_matrix(K), as_rotation(R), as_matrix(t, (3,), "t")
    length = float(np.linalg.norm(t / (np.abs(t).max() or 1.0))) * float(np.abs(t).max())
    if not abs(float(R[:, 2] @ (t / (length or 1.0)))) > 1e-15 or not length > 0:
        raise DegenerateConfiguration("t: the plane goes through the camera's centre; need a plane that is seen")
    with np.errstate(over="ignore", invalid="ignore"):
        H = K @ np.column_stack((R[:, :2], t))
        H = H / np.abs(H).max()
    if not np.isfinite(H).all():
        raise ShapeError("K, t: overflow; need numbers of the size of a picture and a scene")
    return np.asarray(H / np.linalg.norm(H), np.float64)


def pose_from_plane_homography(K: ArrayLike, H: ArrayLike) -> RigidTransform:
    """Return camera_from_plane of H_image_plane, of any scale and sign: the inverse of `plane_homography`.

    K^-1 H = c [r1 r2 t]; c from the mean length of the first two columns, its sign from the plane's origin being in
    front of the camera, R the rotation nearest to [r1 r2 r1 x r2]. Exact for an exact H; for a measured one it is a
    start for `planar_poses`, which refines it and says how sure it is.

    Raises
    ------
    DegenerateConfiguration
        If H is no view of a plane whose origin is in front of the camera.
    """
    K, H = as_intrinsic_matrix(K), as_matrix(H, (3, 3), "H")
    with np.errstate(over="ignore", invalid="ignore"):
        M = np.linalg.solve(K, H / (np.abs(H).max() or 1.0))
        lengths = np.hypot(np.hypot(M[0, :2], M[1, :2]), M[2, :2])
        scale = float(lengths.mean())
        if not (lengths.min() > _SHORTEST * lengths.max() and math.isfinite(scale) and M[2, 2] != 0):
            raise DegenerateConfiguration("H: no view of a plane in front of the camera; need a regular homography")
        M = M / math.copysign(scale, M[2, 2])
        third = np.cross(M[:, 0], M[:, 1])
        if not (np.isfinite(M).all() and np.linalg.norm(third) > _SHORTEST):
            raise DegenerateConfiguration("H: singular; need a homography of a plane that is not seen edge on")
    try:
        R = nearest_rotation(np.column_stack((M[:, :2], third)))
    except ShapeError:
        raise DegenerateConfiguration("H: its columns do not determine a rotation; need a view of a plane") from None
    return RigidTransform(R, M[:, 2].copy())
