# SPDX-License-Identifier: Apache-2.0
"""How pixels move with the camera's numbers: focal lengths, principal point, distortion coefficients (IU 1.1.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Points, as_points, as_rows
from imgu_ros.vision.camera.distortion import distort_with_derivatives
from imgu_ros.vision.camera.intrinsics import Camera


def raw_by_camera(camera: Camera, points: ArrayLike) -> Floats:
    """Return the derivative of the raw pixels of points by (fx, fy, cx, cy, distortion...), (N, 2, 4 + D).

    Parameters
    ----------
    camera : D is the number of its distortion coefficients
    points : (N, 3) m in the camera's frame, z > 0

    Raises
    ------
    ShapeError
        If a point is not in front of the camera, or so far off its axis that the lens model is not finite.

    Examples
    --------
    >>> from imgu_ros.vision.camera.intrinsics import make_camera
    >>> camera = make_camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], (), "plumb_bob", 640, 480)
    >>> raw_by_camera(camera, [[0.2, -0.1, 1.0]])[0, :, :4].tolist()
    [[0.2, 0.0, 1.0, 0.0], [0.0, -0.1, 0.0, 1.0]]
    """
    require_type(camera, Camera, "camera")
    points = as_rows(points, 3, "points")
    if len(points) and not points[:, 2].min() > 0:
        raise ShapeError(f"points: smallest z {points[:, 2].min():g}; need z > 0 (in front of the camera)")
    with np.errstate(over="ignore"):
        distorted = distort_with_derivatives(camera.model, camera.distortion, points[:, :2] / points[:, 2:])
    return _raw_by_camera(camera, distorted.xy, distorted.by_coefficients)


def ideal_by_camera(camera: Camera, ideal: ArrayLike) -> Floats:
    """Return how the ideal pixels of fixed raw pixels move with (fx, fy, cx, cy, distortion...), (N, 2, 4 + D).

    Ideal pixels are normalised coordinates in units of the present K: with another K, the raw pixel's line of sight
    moves, and with it the pixel at which the camera as it is given would see it.

    Parameters
    ----------
    camera : D is the number of its distortion coefficients
    ideal : (N, 2) px of the camera with the same K and no distortion

    Raises
    ------
    ShapeError
        If a point is so far off the axis that the lens model is not finite or has no inverse.

    Examples
    --------
    With a focal length that is a pixel longer, what is seen 100 px right of the centre lies 1/5 px nearer to it:

    >>> from imgu_ros.vision.camera.intrinsics import make_camera
    >>> camera = make_camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], (), "plumb_bob", 640, 480)
    >>> (ideal_by_camera(camera, [[420.0, 240.0]])[0, :, :4].round(6) + 0.0).tolist()
    [[-0.2, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, -1.0]]
    """
    require_type(camera, Camera, "camera")
    ideal = as_points(ideal, "ideal")
    K = camera.K
    with np.errstate(over="ignore", invalid="ignore"):
        xy = np.linalg.solve(K[:2, :2], (ideal - K[:2, 2]).T).T
    distorted = distort_with_derivatives(camera.model, camera.distortion, xy)
    raw = _raw_by_camera(camera, distorted.xy, distorted.by_coefficients)
    if not camera.is_distorted:
        return -raw
    # Raw px by ideal px: a derivative that the lens model can lose only where it folds.
    a, b, c, d = distorted.by_xy.reshape(-1, 4, 1).swapaxes(0, 1)
    determinant = a * d - b * c
    if len(ideal) and not float(determinant.min()) > 0:
        raise ShapeError("ideal: beyond the range of the lens model; need points nearer the axis")
    (fx, skew), (_, fy) = K[:2, :2].tolist()
    y = raw[:, 1] / fy
    x = (raw[:, 0] - skew * y) / fx
    moved = np.empty_like(raw)
    moved[:, 1] = (c * x - a * y) / determinant
    moved[:, 0] = fx * (b * y - d * x) / determinant + skew * moved[:, 1]
    moved[:, 1] *= fy
    return moved


def _raw_by_camera(camera: Camera, distorted_xy: Points, by_coefficients: Floats) -> Floats:
    """Return the derivative of raw px, (N, 2, 4 + D), of distorted normalised points."""
    by = np.zeros((len(distorted_xy), 2, 4 + by_coefficients.shape[2]))
    by[:, 0, 0], by[:, 1, 1] = distorted_xy[:, 0], distorted_xy[:, 1]
    by[:, 0, 2] = by[:, 1, 3] = 1
    by[:, :, 4:] = camera.K[:2, :2] @ by_coefficients
    return by
