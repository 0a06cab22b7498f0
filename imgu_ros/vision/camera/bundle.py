# SPDX-License-Identifier: Apache-2.0
"""The least-squares problem of a calibration: one camera, many views of one plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.arguments import as_sequence
from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, Points, as_points
from imgu_ros.vision.camera.distortion import distort_with_derivatives
from imgu_ros.vision.camera.distortion_model import COEFFICIENTS, DistortionModel, as_distortion_model
from imgu_ros.vision.camera.pose_problem import point_by_pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3
from imgu_ros.vision.estimation.nonlinear import Linearisation

#: Numbers of a pose in the estimate (R row by row, t), and its degrees of freedom.
_POSE_NUMBERS, _POSE_FREEDOM = 12, 6
#: Radians of a step: a wild one is to be rejected, not to fail.
_LONGEST_TURN = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class BundleState:
    """An estimate of the bundle.

    Attributes
    ----------
    intrinsics : (4 + C,) fx, fy, cx, cy and the distortion coefficients
    poses : camera_from_plane of every view
    """

    intrinsics: Floats
    poses: tuple[RigidTransform, ...]


class BundleProblem:
    """Reprojection residuals, (V N, 2) px, of V views of N points; parameters: intrinsics, then x y z rx ry rz a view.

    Parameters
    ----------
    plane_xy : (N, 2) m
    views : V times (N, 2) raw px
    model : of the lens

    Raises
    ------
    ShapeError
        If an array has another shape or is not finite, or a view another number of points.
    """

    def __init__(self, plane_xy: Points, views: Sequence[Points], model: DistortionModel) -> None:
        views, model = as_sequence(views, "views"), as_distortion_model(model)
        self._plane = as_points(plane_xy, "plane_xy", 1)
        pixels = [as_points(view, f"views[{index}]") for index, view in enumerate(views)]
        if not pixels or any(len(view) != len(self._plane) for view in pixels):
            raise ShapeError(f"views: {[len(view) for view in pixels]} points; need {len(self._plane)} in each")
        self._pixels = np.concatenate(pixels)
        self._model = model
        self._count = len(views)
        self._shared = 4 + COEFFICIENTS[model]

    def pack(self, state: BundleState) -> Floats:
        """Return the state as one array, as `minimise` moves it."""
        return np.concatenate([state.intrinsics, *(np.r_[pose.R.ravel(), pose.t] for pose in state.poses)])

    def unpack(self, estimate: Floats) -> BundleState:
        """Return what `pack` packed."""
        rows = estimate[self._shared :].reshape(-1, _POSE_NUMBERS)
        return BundleState(
            estimate[: self._shared].copy(), tuple(RigidTransform(row[:9].reshape(3, 3), row[9:]) for row in rows)
        )

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals, and their derivative: (V N, 2, 4 + C + 6 V)."""
        state = self.unpack(estimate)
        fx, fy, cx, cy = state.intrinsics[:4]
        if not (fx > 0 and fy > 0):
            raise DegenerateConfiguration(f"focal length: {fx:g}, {fy:g}; need positive ones")
        points = np.concatenate([self._plane @ pose.R[:, :2].T + pose.t for pose in state.poses])
        if not points[:, 2].min() > 0:
            raise DegenerateConfiguration("pose: a view lies behind the camera; need all in front")
        size, count = len(self._plane), len(points)
        xy = points[:, :2] / points[:, 2:]
        try:
            distorted = distort_with_derivatives(self._model, state.intrinsics[4:], xy)
        except ShapeError as error:
            raise DegenerateConfiguration(f"view: {error}") from None
        focal = np.array([fx, fy])
        jacobian = np.zeros((count, 2, self._shared + _POSE_FREEDOM * self._count))
        jacobian[:, 0, 0], jacobian[:, 1, 1] = distorted.xy.T
        jacobian[:, 0, 2] = jacobian[:, 1, 3] = 1.0
        jacobian[:, :, 4 : self._shared] = focal[:, None] * distorted.by_coefficients
        by_point = np.zeros((count, 2, 3))
        by_point[:, 0, 0] = by_point[:, 1, 1] = 1 / points[:, 2]
        by_point[:, :, 2] = -xy / points[:, 2:]
        by_point = focal[:, None] * (distorted.by_xy @ by_point)
        for index, pose in enumerate(state.poses):
            rows = slice(index * size, (index + 1) * size)
            first = self._shared + _POSE_FREEDOM * index
            jacobian[rows, :, first : first + _POSE_FREEDOM] = by_point[rows] @ point_by_pose(points[rows], pose.t)
        return Linearisation(focal * distorted.xy + (cx, cy) - self._pixels, jacobian)

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        """Return the estimate moved: intrinsics and t by addition, R to Exp(r) R."""
        moved = estimate.copy()
        moved[: self._shared] += delta[: self._shared]
        rows = moved[self._shared :].reshape(-1, _POSE_NUMBERS)
        for row, change in zip(rows, delta[self._shared :].reshape(-1, _POSE_FREEDOM), strict=True):
            turn = change[3:] / max(1.0, float(np.abs(change[3:]).max()) / _LONGEST_TURN)
            row[:9] = (exp_so3(turn) @ row[:9].reshape(3, 3)).ravel()
            row[9:] += change[:3]
        return moved
