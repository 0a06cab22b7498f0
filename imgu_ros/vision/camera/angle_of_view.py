# SPDX-License-Identifier: Apache-2.0
"""Focal length and angle of view of a pinhole (IU 1.1.1, 1.1.3, 8.1.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Matrix3
from imgu_ros.vision.camera.projection import as_intrinsic_matrix


@dataclass(frozen=True, slots=True, eq=False)
class AngleOfView:
    """Angles of view between the outer edges of the picture, rad, less than pi; the diagonal from corner to corner."""

    horizontal: float
    vertical: float
    diagonal: float


def intrinsic_matrix(width: int, height: int, angle_of_view_rad: float) -> Matrix3:
    """Return K of a pinhole with square pixels whose axis goes through the picture's centre.

    f = (width / 2) / tan(angle / 2), in px.

    Parameters
    ----------
    width, height : px
    angle_of_view_rad : horizontal, between the left edge of the first and the right edge of the last column

    Raises
    ------
    ShapeError
        If the size is not positive, or the angle not between 0 and pi.

    Examples
    --------
    >>> intrinsic_matrix(640, 480, np.pi / 2).round(6).tolist()
    [[320.0, 0.0, 319.5], [0.0, 320.0, 239.5], [0.0, 0.0, 1.0]]
    """
    width = as_integer(width, "width")
    height = as_integer(height, "height")
    angle_of_view_rad = as_number(angle_of_view_rad, "angle_of_view_rad")
    if not 0 < angle_of_view_rad < math.pi:
        raise ShapeError(f"angle_of_view_rad: {angle_of_view_rad}; need between 0 and pi")
    return _centred(width, height, width / 2 / math.tan(angle_of_view_rad / 2))


def intrinsic_matrix_of_lens(width: int, height: int, focal_length_m: float, pixel_m: float) -> Matrix3:
    """Return K of a lens before a sensor: f = focal length / pixel pitch, in px (IU 8.1.3).

    Parameters
    ----------
    width, height : px
    focal_length_m : of the lens, focused at infinity
    pixel_m : distance of two pixels' centres

    Raises
    ------
    ShapeError
        If a number is not positive and finite.

    Examples
    --------
    >>> intrinsic_matrix_of_lens(640, 480, 4e-3, 5e-6)[0].round(6).tolist()
    [800.0, 0.0, 319.5]
    """
    width = as_integer(width, "width")
    height = as_integer(height, "height")
    focal_length_m = as_number(focal_length_m, "focal_length_m")
    pixel_m = as_number(pixel_m, "pixel_m")
    if not (0 < focal_length_m < math.inf and 0 < pixel_m < math.inf):
        raise ShapeError(f"focal_length_m, pixel_m: {focal_length_m}, {pixel_m}; need positive lengths")
    return _centred(width, height, focal_length_m / pixel_m)


def angle_of_view(K: ArrayLike, width: int, height: int) -> AngleOfView:
    """Return the angles of view of a pinhole; its axis need not go through the picture's centre.

    Parameters
    ----------
    K : (3, 3) px, fx and fy positive
    width, height : px

    Raises
    ------
    ShapeError
        If K is no intrinsic matrix or the size is not positive.

    Examples
    --------
    >>> view = angle_of_view([[320, 0, 319.5], [0, 320, 239.5], [0, 0, 1]], 640, 480)
    >>> round(float(np.rad2deg(view.horizontal)), 3), round(float(np.rad2deg(view.vertical)), 3)
    (90.0, 73.74)
    """
    width = as_integer(width, "width")
    height = as_integer(height, "height")
    K = as_intrinsic_matrix(K)
    _require_size(width, height)
    left, right = -0.5, width - 0.5
    top, bottom = -0.5, height - 0.5
    cx, cy = K[:2, 2]
    return AngleOfView(
        _between(K, (left, cy), (right, cy)), _between(K, (cx, top), (cx, bottom)),
        _between(K, (left, top), (right, bottom)),
    )  # fmt: skip


def _between(K: Matrix3, a: tuple[float, float], b: tuple[float, float]) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        rays = np.linalg.solve(K, np.array([(*a, 1.0), (*b, 1.0)]).T).T
        rays = rays / np.abs(rays).max(axis=1, keepdims=True)
        angle = float(np.arctan2(np.linalg.norm(np.cross(rays[0], rays[1])), rays[0] @ rays[1]))
    if not math.isfinite(angle):
        raise ShapeError(f"K: {K.tolist()}; need focal lengths and a principal point of the size of a picture")
    return angle


def _centred(width: int, height: int, focal_px: float) -> Matrix3:
    _require_size(width, height)
    if not 0 < focal_px < math.inf:
        raise ShapeError(f"focal length: {focal_px} px; need a positive, finite one")
    return np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1.0]])


def _require_size(width: int, height: int) -> None:
    if not (0 < width < math.inf and 0 < height < math.inf):
        raise ShapeError(f"size: {width} x {height}; need positive width and height")
