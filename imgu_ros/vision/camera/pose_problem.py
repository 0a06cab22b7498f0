# SPDX-License-Identifier: Apache-2.0
"""The least-squares problem of a calibrated camera's pose: reprojection errors and their derivative."""

from __future__ import annotations

import numpy as np

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, Points, as_matrix, as_points, as_rows
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.estimation.nonlinear import Linearisation

#: Radians of a step: a wild one is to be rejected, not to fail.
_LONGEST_TURN = 1e3


class PoseProblem:
    """Reprojection residuals, (N, 2) px; the estimate is a rigid transform (4, 4) camera_from_object.

    Parameters
    ----------
    points : (N, 3) m, or (N, 2) on the plane z = 0
    pixels : (N, 2) raw px
    camera : intrinsics

    Raises
    ------
    ShapeError
        If an array has another shape or is not finite.
    """

    def __init__(self, points: Floats, pixels: Points, camera: Camera) -> None:
        on_plane = isinstance(points, np.ndarray) and points.ndim == 2 and points.shape[1] == 2
        self._points = as_rows(points, 2 if on_plane else 3, "points", 1)
        self._pixels = as_points(pixels, "pixels")
        if len(self._points) != len(self._pixels):
            raise ShapeError(f"pixels: {len(self._pixels)} points; need {len(self._points)}, one for each of points")
        self._camera = camera

    def residuals(self, estimate: Floats) -> Floats:
        """Return projected - measured."""
        return self._camera.project(self._in_camera(estimate)) - self._pixels

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals and their derivative by (x y z rx ry rz): t + xyz, Exp(r) R."""
        points = self._in_camera(estimate)
        try:
            projected, by_point = self._camera.project_with_jacobian(points)
        except ShapeError as error:  # grazing: so far off the axis that the pixel is not finite
            raise DegenerateConfiguration(f"pose: {error}") from None
        return Linearisation(projected - self._pixels, by_point @ point_by_pose(points, estimate[:3, 3]))

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        """Return the transform moved by (x y z rx ry rz)."""
        moved = np.eye(4)
        turn = delta[3:] / max(1.0, float(np.abs(delta[3:]).max()) / _LONGEST_TURN)
        moved[:3, :3] = exp_so3(turn) @ estimate[:3, :3]
        moved[:3, 3] = estimate[:3, 3] + delta[:3]
        return moved

    def _in_camera(self, estimate: Floats) -> Floats:
        points = self._points @ estimate[:3, : self._points.shape[1]].T + estimate[:3, 3]
        if not points[:, 2].min() > 0:
            raise DegenerateConfiguration("pose: points lie behind the camera; need all in front")
        return points


def point_by_pose(points: Floats, t: Floats) -> Floats:
    """Return the derivative of points of the camera's frame by their pose (x y z rx ry rz), (N, 3, 6).

    Parameters
    ----------
    points : (N, 3), R X + t
    t : (3,)
    """
    points = as_rows(points, 3, "points")
    turned = points - as_matrix(t, (3,), "t")
    by_step = np.zeros((len(points), 3, 6))
    by_step[:, :, :3] = np.eye(3)
    # d (Exp(r) v) / dr = -[v]x
    by_step[:, 0, 4], by_step[:, 0, 5] = turned[:, 2], -turned[:, 1]
    by_step[:, 1, 3], by_step[:, 1, 5] = -turned[:, 2], turned[:, 0]
    by_step[:, 2, 3], by_step[:, 2, 4] = turned[:, 1], -turned[:, 0]
    return by_step
