# SPDX-License-Identifier: Apache-2.0
"""Applying homographies to points (IU 6.3, 6.4.5)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Floats, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.projective.homography import normalised_homography


def transform(H: ArrayLike, points: ArrayLike) -> Points:
    """Map points by a homography.

    Parameters
    ----------
    H : (3, 3)
    points : (N, 2)

    Returns
    -------
    (N, 2)

    Raises
    ------
    DegenerateConfiguration
        If a point is mapped to infinity, or so far that its coordinates are no floats.

    Examples
    --------
    >>> transform([[2, 0, 10], [0, 3, -4], [0, 0.01, 1]], [[0, 0], [1, 100]]).tolist()
    [[10.0, -4.0], [6.0, 148.0]]
    """
    H = as_matrix(H, (3, 3), "H")
    points = as_points(points)
    return _mapped(H, points)[0]


def local_jacobian(H: ArrayLike, points: ArrayLike) -> Floats:
    """Return the derivative of the mapped points by the points, (N, 2, 2): H's local affine part.

    Raises
    ------
    DegenerateConfiguration
        If a point is mapped to infinity, or the derivative there is beyond floats.

    Examples
    --------
    >>> local_jacobian([[1, 0, 0], [0, 1, 0], [0.01, 0, 1]], [[100, 0]]).round(6).tolist()
    [[[0.25, 0.0], [0.0, 0.5]]]
    """
    H = as_matrix(H, (3, 3), "H")
    points = as_points(points)
    xy, w = _mapped(H, points)
    with np.errstate(over="ignore", invalid="ignore"):
        jacobian: Floats = (H[None, :2, :2] - xy[:, :, None] * H[2, :2]) / w[:, None, None]
    if not math.isfinite(np.vdot(jacobian, jacobian)):
        raise DegenerateConfiguration("H: its derivative is beyond floats; need points off the vanishing line")
    return jacobian


def area_factor(H: ArrayLike, point: Sequence[float]) -> float:
    """Return by how much a homography enlarges areas at a point: |det| of the local Jacobian.

    Parameters
    ----------
    H : (3, 3)
    point : x, y

    Raises
    ------
    DegenerateConfiguration
        If the point is mapped to infinity.
    ShapeError
        If H or the point is not as said.

    Examples
    --------
    >>> area_factor([[2, 0, 0], [0, 3, 0], [0, 0, 1]], (5, 5))
    6.0
    """
    H = as_matrix(H, (3, 3), "H")
    x, y = as_matrix(point, (2,), "point").tolist()
    g, h, i = H[2].tolist()
    w = float(g * x + h * y + i)
    try:
        factor = abs(float(cv2.determinant(H)) / w**3)
    except (ZeroDivisionError, OverflowError):
        factor = math.inf
    if not math.isfinite(factor):
        raise DegenerateConfiguration("point: it is mapped to infinity by H; need one off the vanishing line")
    return factor


def inverse3(matrix: ArrayLike, name: str = "H") -> Matrix3:
    """Return the inverse of a (3, 3) matrix of numbers of moderate size, several times as fast as numpy.

    Parameters
    ----------
    matrix : (3, 3)
    name : what errors call it

    Raises
    ------
    DegenerateConfiguration
        If it is singular, or squares of its inverse are no floats.
    ShapeError
        If it is not (3, 3) of finite numbers.

    Examples
    --------
    >>> (inverse3([[2, 0, 0], [0, 4, 0], [1, 0, 1]]) @ [2, 4, 2]).tolist()
    [1.0, 1.0, 1.0]
    """
    regular, inverse = cv2.invert(as_matrix(matrix, (3, 3), name))
    if not regular or not math.isfinite(np.vdot(inverse, inverse)):
        raise DegenerateConfiguration(f"{name}: singular or nearly so; need a regular matrix")
    return np.asarray(inverse, np.float64)


def faces_camera(H: ArrayLike, points: ArrayLike) -> bool:
    """Whether a homography with det H > 0 maps all points with w > 0.

    Then it keeps the orientation of the plane about each of them and puts none behind the camera; a mirrored view,
    or one in which the vanishing line crosses the points, does not (HZ section 21.1).

    Raises
    ------
    DegenerateConfiguration
        If H is zero.

    Examples
    --------
    >>> H = [[1, 0, 0], [0, 1, 0], [0, 0.01, 1]]
    >>> faces_camera(H, [[0, 0], [0, 50]]), faces_camera(H, [[0, 0], [0, -200]])
    (True, False)
    """
    third = normalised_homography(H)[2]
    points = as_points(points)
    # Coordinates may be as large as floats are: an overflow keeps the sign.
    with np.errstate(over="ignore", invalid="ignore"):
        return bool((points @ third[:2] + third[2] > 0).all())


def _mapped(H: Matrix3, points: Points) -> tuple[Points, Floats]:
    """Return the mapped points, and the third homogeneous coordinate of each."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        mapped = points @ H[:, :2].T + H[:, 2]
        w = mapped[:, 2]
        xy = mapped[:, :2] / w[:, None]
    # Squares of what is no place in any picture may overflow: only then is every number looked at.
    if not math.isfinite(np.vdot(mapped, mapped) + np.vdot(xy, xy)) and not (
        np.isfinite(xy).all() and np.isfinite(w).all()
    ):
        raise DegenerateConfiguration("points: one is mapped to infinity by H; need points off the vanishing line")
    return xy, w
