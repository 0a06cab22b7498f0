# SPDX-License-Identifier: Apache-2.0
"""The two poses that a plane's homography allows about one point: infinitesimal plane-based pose estimation.

Collins & Bartoli, Infinitesimal plane-based pose estimation, IJCV 2014, section 3.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Floats, as_matrix
from imgu_ros.vision.camera.rigid import RigidTransform

#: Rounding may make a square a little negative.
_ROUNDING = 1e-9


def poses_about_point(H: ArrayLike, point: ArrayLike) -> tuple[RigidTransform, RigidTransform]:
    """Return the two poses camera_from_plane that have a homography's value and derivative at a point.

    Of an exact homography one of them is its pose; how unlike they are says how much perspective there is.

    Parameters
    ----------
    H : (3, 3) ideal normalised coordinates x / z, y / z from metres on the plane z = 0
    point : (2,) metres on the plane

    Raises
    ------
    DegenerateConfiguration
        If H is singular at the point, or maps it to infinity.

    Examples
    --------
    A plane one metre ahead, seen straight on; about a point off the axis it could also be tilted the other way:

    >>> first, second = poses_about_point(np.eye(3), [0.0, 0.0])
    >>> (first.t.round(9) + 0.0).tolist(), bool(np.allclose(first.R, np.eye(3)) and np.allclose(second.R, np.eye(3)))
    ([0.0, 0.0, 1.0], True)
    """
    H, point = as_matrix(H, (3, 3), "H"), as_matrix(point, (2,), "point")
    x0, y0 = point.tolist()
    scale = float(np.abs(H).max())
    (h00, h01, h02), (h10, h11, h12), (h20, h21, h22) = (H / scale if scale > 0 else H).tolist()
    w = h20 * x0 + h21 * y0 + h22
    if not abs(w) > _ROUNDING * (abs(h20 * x0) + abs(h21 * y0) + abs(h22)):
        raise DegenerateConfiguration("H: it maps the point to infinity; need a point off the vanishing line")
    p, q = (h00 * x0 + h01 * y0 + h02) / w, (h10 * x0 + h11 * y0 + h12) / w
    # The derivative of the homography at the point.
    j00, j01 = (h00 - p * h20) / w, (h01 - p * h21) / w
    j10, j11 = (h10 - q * h20) / w, (h11 - q * h21) / w
    to_view = _turned_to(p, q)
    # B = [I | -v] R_v restricted to the first two columns; A = B^-1 J is the upper left of R, over the depth.
    b00, b01 = to_view[0][0] - p * to_view[2][0], to_view[0][1] - p * to_view[2][1]
    b10, b11 = to_view[1][0] - q * to_view[2][0], to_view[1][1] - q * to_view[2][1]
    det = b00 * b11 - b01 * b10
    a00, a01 = (b11 * j00 - b01 * j10) / det, (b11 * j01 - b01 * j11) / det
    a10, a11 = (b00 * j10 - b10 * j00) / det, (b00 * j11 - b10 * j01) / det
    # Its larger singular value is that of a rotation's part with one column of length 1: the inverse depth.
    s00, s01, s11 = a00 * a00 + a01 * a01, a00 * a10 + a01 * a11, a10 * a10 + a11 * a11
    inverse_depth = math.sqrt(0.5 * (s00 + s11 + math.hypot(s00 - s11, 2 * s01)))
    if not (inverse_depth > 0 and math.isfinite(inverse_depth) and abs(a00 * a11 - a01 * a10) > 0):
        raise DegenerateConfiguration("H: singular at the point; need a plane that is not seen edge-on")
    r00, r01, r10, r11 = (a / inverse_depth for a in (a00, a01, a10, a11))
    # Columns of length 1 and at right angles: the third row up to its sign.
    r20 = math.sqrt(max(0.0, 1 - r00 * r00 - r10 * r10))
    r21 = math.copysign(math.sqrt(max(0.0, 1 - r01 * r01 - r11 * r11)), -(r00 * r01 + r10 * r11))
    depth = 1 / inverse_depth
    at_point = np.array([p * depth, q * depth, depth])
    view = np.array(to_view)
    first, second = (
        _pose(view, (r00, r10, sign * r20), (r01, r11, sign * r21), at_point, x0, y0) for sign in (1.0, -1.0)
    )
    return first, second


def _pose(
    view: Floats,
    r1: tuple[float, float, float],
    r2: tuple[float, float, float],
    at_point: Floats,
    x0: float,
    y0: float,
) -> RigidTransform:
    (a, b, c), (d, e, f) = r1, r2
    R = view @ np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])
    # Where the third row is nearly 0, its root has half the digits: a step of Newton's method to the nearest rotation.
    R = R @ (1.5 * np.eye(3) - 0.5 * (R.T @ R))
    return RigidTransform(R, at_point - x0 * R[:, 0] - y0 * R[:, 1])


def _turned_to(p: float, q: float) -> list[list[float]]:
    """Return the rotation that turns the optical axis to the direction (p, q, 1) by the shortest way."""
    length = math.sqrt(p * p + q * q + 1)
    x, y, z = p / length, q / length, 1 / length
    k = 1 / (1 + z)
    return [[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]]
