# SPDX-License-Identifier: Apache-2.0
"""Estimates against the truth: corner error, rotation, translation, and whether the covariance is honest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.simulate.truth import Truth, corner_error, normalised_squared_error
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import rigid_transform
from imgu_ros.vision.camera.rotation import log_so3

#: What counts when an estimate puts a corner on or behind the horizon, where the corner error is infinite, px.
_LARGEST_CORNER_ERROR_PX = 1e4


@dataclass(frozen=True, slots=True, eq=False)
class RowErrors:
    """Errors of one target in one frame; None where the estimate or the truth has nothing.

    Attributes
    ----------
    corner_px : see `corner_error`; at most 10000
    rotation_deg : angle between the estimated and the true rotation
    translation_percent : distance between the estimated and the true position, of the true distance
    nees : see `normalised_squared_error`
    true_position : (3,) of the camera in the target's frame, m
    """

    corner_px: float | None = None
    rotation_deg: float | None = None
    translation_percent: float | None = None
    nees: float | None = None
    true_position: Floats | None = None


class TruthComparison:
    """Compares estimates with a truth file.

    Parameters
    ----------
    truths : the file's rows
    target_sizes : width, height of each target's template, px, by name
    image_size : width, height of the frames, px
    camera : of the frames; decides what falls inside a distorted image

    Attributes
    ----------
    compared : rows for which there was a truth so far
    """

    def __init__(
        self,
        truths: Sequence[Truth],
        target_sizes: Mapping[str, tuple[int, int]],
        image_size: tuple[int, int],
        camera: Camera | None,
    ) -> None:
        self._truths = {(truth.stamp_ns, truth.target): truth for truth in truths}
        self._sizes = dict(target_sizes)
        self._image_size = image_size
        self._camera = camera
        self.compared = 0

    def errors(
        self, stamp_ns: int, target: str, H: Matrix3 | None, pose: Floats | None, covariance: Floats | None
    ) -> RowErrors:
        """Compare one estimate.

        Parameters
        ----------
        H : (3, 3) H_image_template, or None
        pose : (7,) tx ty tz qx qy qz qw, camera_from_target, or None
        covariance : (6, 6) of the pose, or None
        """
        truth = self._truths.get((stamp_ns, target))
        if truth is None:
            return RowErrors()
        self.compared += 1
        corner_px = None if H is None else self._corner_px(H, truth)
        if truth.pose is None:
            return RowErrors(corner_px=corner_px)
        true_position = truth.pose.inverse().t
        if pose is None or covariance is None:
            return RowErrors(corner_px=corner_px, true_position=true_position)
        estimate = rigid_transform(pose)
        delta_r = log_so3(truth.pose.R @ estimate.R.T)
        delta_t = truth.pose.t - estimate.t
        return RowErrors(
            corner_px=corner_px,
            rotation_deg=float(np.rad2deg(np.linalg.norm(delta_r))),
            translation_percent=float(100 * np.linalg.norm(delta_t) / np.linalg.norm(truth.pose.t)),
            nees=normalised_squared_error(truth.pose, estimate, covariance),
            true_position=true_position,
        )

    def _corner_px(self, H: Matrix3, truth: Truth) -> float | None:
        try:
            error = corner_error(H, truth.H, self._sizes[truth.target], self._image_size, self._camera)
        except ShapeError:  # the target is not in the picture at all
            return None
        return min(error, _LARGEST_CORNER_ERROR_PX)


def camera_position(pose: Floats) -> Floats:
    """Return where the camera is in the target's frame, (3,) m, from camera_from_target (7,)."""
    return rigid_transform(pose).inverse().t
