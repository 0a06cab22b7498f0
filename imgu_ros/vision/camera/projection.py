# SPDX-License-Identifier: Apache-2.0
"""The projective camera P = K [R | t]: projection, centre, depths (IU 8.1.1-8.1.4; HZ chapter 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, Points, as_matrix, as_rows
from imgu_ros.vision.camera.rotation import as_rotation

#: Reciprocal condition below which the left 3x3 of P is singular: a camera at infinity.
_FINITE = 1e-14


def projection_matrix(K: ArrayLike, R: ArrayLike, t: ArrayLike) -> Floats:
    """Return P = K [R | t], (3, 4), with x ~ P X and a positive third coordinate for points in front.

    Parameters
    ----------
    K : (3, 3) px, upper triangular, K[2, 2] = 1, focal lengths positive
    R, t : (3, 3) and (3,) m, camera_from_world

    Raises
    ------
    ShapeError
        If K is no intrinsic matrix, R no rotation, or t not three finite numbers.

    Examples
    --------
    >>> projection_matrix([[100, 0, 50], [0, 100, 40], [0, 0, 1]], np.eye(3), [0, 0, 2]).tolist()
    [[100.0, 0.0, 50.0, 100.0], [0.0, 100.0, 40.0, 80.0], [0.0, 0.0, 1.0, 2.0]]
    """
    matrix = as_intrinsic_matrix(K)
    R, t = as_rotation(R), as_matrix(t, (3,), "t")
    with np.errstate(over="ignore", invalid="ignore"):
        P = matrix @ np.column_stack((R, t))
    return _finite(P, "K, t")


def project(P: ArrayLike, world: ArrayLike) -> Points:
    """Project points by a camera matrix.

    Parameters
    ----------
    P : (3, 4), of any scale
    world : (N, 3)

    Returns
    -------
    (N, 2) px; of points behind the camera too (see `depths`)

    Raises
    ------
    DegenerateConfiguration
        If a point lies in the camera's principal plane: its picture is at infinity.

    Examples
    --------
    >>> P = projection_matrix([[100, 0, 50], [0, 100, 40], [0, 0, 1]], np.eye(3), [0, 0, 2])
    >>> project(P, [[0.2, -0.2, 0.0]]).tolist()
    [[60.0, 30.0]]
    """
    homogeneous = _mapped(as_matrix(P, (3, 4), "P"), as_rows(world, 3, "world"))
    if not homogeneous[:, 2].all():
        raise DegenerateConfiguration("world: a point in the camera's principal plane; need points off it")
    with np.errstate(over="ignore"):
        return _finite(homogeneous[:, :2] / homogeneous[:, 2:], "world")


def camera_centre(P: ArrayLike) -> Floats:
    """Return the camera's centre in the world, (3,): the null vector of P; -R^T t for P = K [R | t].

    Raises
    ------
    DegenerateConfiguration
        If the left 3x3 of P is singular: the centre is at infinity.

    Examples
    --------
    >>> R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    >>> camera_centre(projection_matrix(np.eye(3), R, [1, 2, 3])).round(12).tolist()  # -R^T t
    [-2.0, 1.0, -3.0]
    """
    P = finite_camera(P)
    with np.errstate(over="ignore", invalid="ignore"):
        return _finite(-np.linalg.solve(P[:, :3], P[:, 3]), "P")


def depths(P: ArrayLike, world: ArrayLike) -> Floats:
    """Return each point's distance from the principal plane, (N,), positive in front (HZ equation 6.15).

    With `world`, (N, 3), in metres it is in metres when P = c K [R | t] with K[2, 2] = 1, whatever c is.

    Raises
    ------
    DegenerateConfiguration
        If the camera is at infinity.
    """
    P = finite_camera(P)
    mapped = _mapped(P, as_rows(world, 3, "world"))
    sign = 1.0 if np.linalg.det(P[:, :3] / np.abs(P[:, :3]).max()) > 0 else -1.0
    return _finite(sign * mapped[:, 2] / np.linalg.norm(P[2, :3]), "world")


def world_to_camera(R: ArrayLike, t: ArrayLike, world: ArrayLike) -> Floats:
    """Return points of the world in the camera's frame, R X + t, (N, 3).

    Parameters
    ----------
    R, t : (3, 3) and (3,) m, camera_from_world
    world : (N, 3) m
    """
    R, t = as_rotation(R), as_matrix(t, (3,), "t")
    with np.errstate(over="ignore", invalid="ignore"):
        return _finite(as_rows(world, 3, "world") @ R.T + t, "world, t")


def camera_to_world(R: ArrayLike, t: ArrayLike, points: ArrayLike) -> Floats:
    """Return points of the camera's frame in the world, R^T (X - t), (N, 3); the inverse of `world_to_camera`."""
    R, t = as_rotation(R), as_matrix(t, (3,), "t")
    with np.errstate(over="ignore", invalid="ignore"):
        return _finite((as_rows(points, 3, "points") - t) @ R, "points, t")


def finite_camera(P: ArrayLike) -> Floats:
    """Return P as a float64 matrix (3, 4) when its left 3x3 is regular.

    Raises
    ------
    DegenerateConfiguration
        If it is singular: a camera at infinity, or no camera.
    """
    P = as_matrix(P, (3, 4), "P")
    singular = np.linalg.svd(P[:, :3] / (np.abs(P[:, :3]).max() or 1.0), compute_uv=False)
    if not singular[2] > _FINITE * singular[0]:
        raise DegenerateConfiguration("P: the left 3x3 is singular; need a camera with a finite centre")
    return P


def as_intrinsic_matrix(K: ArrayLike, name: str = "K") -> Floats:
    """Return K as float64 when it is upper triangular with K[2, 2] = 1 and positive focal lengths.

    Raises
    ------
    ShapeError
        Otherwise; it calls K by `name`.
    """
    matrix = as_matrix(K, (3, 3), name)
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and matrix[1, 0] == 0 and np.array_equal(matrix[2], (0, 0, 1))):
        raise ShapeError(f"{name}: {matrix.tolist()}; need [[fx > 0, s, cx], [0, fy > 0, cy], [0, 0, 1]]")
    return matrix


def _mapped(P: Floats, world: Floats) -> Floats:
    with np.errstate(over="ignore", invalid="ignore"):
        return _finite(world @ P[:, :3].T + P[:, 3], "world, P")


def _finite(values: Floats, name: str) -> Floats:
    if not np.isfinite(values).all():
        raise ShapeError(f"{name}: overflow; need numbers of the size of a scene")
    return np.asarray(values, np.float64)
