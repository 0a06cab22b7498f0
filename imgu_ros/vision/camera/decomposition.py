# SPDX-License-Identifier: Apache-2.0
"""A camera matrix taken apart: P = K [R | t] by RQ decomposition (IU 8.1.5; HZ section 6.2.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Matrix3, as_matrix
from imgu_ros.vision.camera.projection import finite_camera
from imgu_ros.vision.camera.rigid import RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class CameraParts:
    """The parts of P ~ K [R | t].

    Attributes
    ----------
    K : (3, 3) px, upper triangular, K[2, 2] = 1, focal lengths positive
    pose : camera_from_world
    """

    K: Matrix3
    pose: RigidTransform


def decompose_projection(P: ArrayLike) -> CameraParts:
    """Return K, R and t of a camera matrix, of any scale and sign.

    Parameters
    ----------
    P : (3, 4)

    Raises
    ------
    DegenerateConfiguration
        If the camera is at infinity.

    Examples
    --------
    >>> from imgu_ros.vision.camera import projection_matrix
    >>> K = [[100, 0, 50], [0, 90, 40], [0, 0, 1]]
    >>> parts = decompose_projection(-3 * projection_matrix(K, np.eye(3), [0, 1, 2]))
    >>> parts.K.round(9).tolist(), parts.pose.t.round(9).tolist()
    ([[100.0, 0.0, 50.0], [0.0, 90.0, 40.0], [0.0, 0.0, 1.0]], [0.0, 1.0, 2.0])
    """
    matrix = finite_camera(P)
    with np.errstate(over="ignore", invalid="ignore"):
        matrix = matrix / np.abs(matrix[:, :3]).max()
        if np.linalg.det(matrix[:, :3]) < 0:
            matrix = -matrix  # then R comes out with det R = +1
        K, R = rq(matrix[:, :3])
        t = np.linalg.solve(K, matrix[:, 3])
        K = K / K[2, 2]
    if not (np.isfinite(t).all() and np.isfinite(K).all()):
        raise DegenerateConfiguration("P: K or t overflow; need a camera with a finite centre")
    K[2] = (0.0, 0.0, 1.0)
    return CameraParts(K, RigidTransform(R, t))


def rq(matrix: ArrayLike) -> tuple[Matrix3, Matrix3]:
    """Split a regular (3, 3) matrix into an upper triangular one with a positive diagonal and an orthogonal one.

    Raises
    ------
    DegenerateConfiguration
        If the matrix is singular.
    """
    matrix = as_matrix(matrix, (3, 3), "matrix")
    scale = float(np.abs(matrix).max()) or 1.0
    # QR of the transposed rows from the last to the first, back in order, is RQ.
    q, r = np.linalg.qr((matrix / scale)[::-1].T)
    upper, orthogonal = r.T[::-1, ::-1], q.T[::-1]
    diagonal = np.diag(upper)
    if not np.abs(diagonal).min() > 0:
        raise DegenerateConfiguration("matrix: singular; need a regular one")
    signs = np.sign(diagonal)
    return np.asarray(np.triu(upper * signs) * scale, np.float64), np.asarray(signs[:, None] * orthogonal, np.float64)
