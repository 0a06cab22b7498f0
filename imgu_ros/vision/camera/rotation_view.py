# SPDX-License-Identifier: Apache-2.0
"""Two views from one place: the rotation homography x2 ~ K R K^-1 x1, and back to R (IU 8.1.5; HZ section 8.4).

The last line of IU 8.1.5 has x1 ~ K R^T K^-1 x2, which is the same homography read backwards.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Matrix3, as_matrix
from imgu_ros.vision.camera.projection import as_intrinsic_matrix
from imgu_ros.vision.camera.rotation import as_rotation, nearest_rotation

#: Largest deviation of the singular values of K^-1 H K from 1 that noise may cause.
_TOLERANCE = 0.1


def rotation_homography(R: ArrayLike, K_src: ArrayLike, K_dst: ArrayLike | None = None) -> Matrix3:
    """Return H_dst_src between two views that differ by a rotation about the camera's centre.

    Parameters
    ----------
    R : (3, 3) dst_from_src: a direction d in the first camera's frame is R d in the second's
    K_src, K_dst : (3, 3) px, of the two views; K_dst None: the same camera

    Returns
    -------
    (3, 3) of unit Frobenius norm, det H > 0

    Raises
    ------
    ShapeError
        If R is no rotation, or K no intrinsic matrix.

    Examples
    --------
    >>> H = rotation_homography(np.diag([-1.0, -1.0, 1.0]), [[100, 0, 50], [0, 100, 40], [0, 0, 1]])
    >>> (H / H[2, 2]).round(6).tolist()  # half a turn about the axis
    [[-1.0, 0.0, 100.0], [0.0, -1.0, 80.0], [0.0, 0.0, 1.0]]
    """
    R, K_src = as_rotation(R), as_intrinsic_matrix(K_src, "K_src")
    K_dst = K_src if K_dst is None else as_intrinsic_matrix(K_dst, "K_dst")
    with np.errstate(over="ignore", invalid="ignore"):
        H = K_dst @ R @ np.linalg.inv(K_src)
        H = H / np.abs(H).max()
    if not np.isfinite(H).all():
        raise ShapeError("K_src, K_dst: overflow; need focal lengths of the size of a picture")
    return np.asarray(H / np.linalg.norm(H), np.float64)


def rotation_from_homography(H: ArrayLike, K_src: ArrayLike, K_dst: ArrayLike | None = None) -> Matrix3:
    """Return R of a rotation homography H_dst_src, of any scale and sign: the inverse of `rotation_homography`.

    Raises
    ------
    DegenerateConfiguration
        If K_dst^-1 H K_src is far from a rotation: the camera moved, or the calibration is another.
    """
    H, K_src = as_matrix(H, (3, 3), "H"), as_intrinsic_matrix(K_src, "K_src")
    K_dst = K_src if K_dst is None else as_intrinsic_matrix(K_dst, "K_dst")
    with np.errstate(over="ignore", invalid="ignore"):
        A = np.linalg.solve(K_dst, H / (np.abs(H).max() or 1.0)) @ K_src
        determinant = float(np.linalg.det(A))
        A = A / np.cbrt(determinant) if determinant else A * np.inf
    if not np.isfinite(A).all():
        raise DegenerateConfiguration("H: singular; need the homography of a rotating camera")
    singular = np.linalg.svd(A, compute_uv=False)
    if not np.abs(singular - 1).max() < _TOLERANCE:
        raise DegenerateConfiguration(
            f"H: K^-1 H K has singular values {singular.round(3).tolist()}; need 1 within {_TOLERANCE} (rotation)"
        )
    return nearest_rotation(A)
