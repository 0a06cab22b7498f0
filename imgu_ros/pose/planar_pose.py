# SPDX-License-Identifier: Apache-2.0
"""From a target's homography to what is said of it: plausibility, outline, pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import DegenerateConfiguration, EstimationError
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.reasons import NO_CAMERA_INFO, NO_SIZE, no_pose, why_ambiguous
from imgu_ros.reference.planar import Target
from imgu_ros.result import PoseStatus, ReferenceResult
from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.camera.homography_pose import poses_of_homography
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.projective.homography import HomographyEstimate, HomographyNormalEquations

#: A target whose outline covers less than this in the frame is not one.
_MIN_AREA_PX = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Where a target is.

    Attributes
    ----------
    template_xy, image_xy : (N, 2) correspondences without outliers, template px and raw px
    homography : H_image_template in ideal px
    condensed : all that the correspondences tell; None: not condensed
    halvings : of the picture that they were seen in; 0: full resolution
    """

    template_xy: Points
    image_xy: Points
    homography: HomographyEstimate
    condensed: HomographyNormalEquations | None = None
    halvings: int = 0


def bending(camera: Camera | None) -> Camera | None:
    """Return the camera when its lens distorts, else None: then raw pixels are ideal ones."""
    return camera if camera is not None and camera.is_distorted else None


def posed(
    found: ReferenceResult,
    target: Target,
    located: Located,
    camera: Camera | None,
    parameters: Parameters,
    camera_reason: str = "",
    check: CalibrationCheck | None = None,
) -> ReferenceResult:
    """Complete a result by homography, outline and, where it can be, pose.

    Parameters
    ----------
    found : what is known so far
    target, located : which target, and where it is
    camera : intrinsics; None when there are none that can be used
    parameters : all parameters
    camera_reason : why there are none; empty: there is no camera_info
    check : is asked whether it wants what the pose leaves unexplained; None: it does
    """
    homography = located.homography
    outline = seen_outline(target, homography.H)
    lens = bending(camera)
    if lens is not None:
        outline = lens.raw_pixels(outline)
    seen = partial(replace, found, homography=homography, outline=outline, is_sharp=located.halvings == 0)
    if camera is None:
        return seen(pose_status=PoseStatus.UNCALIBRATED, reason=camera_reason or NO_CAMERA_INFO)
    if target.width_m == 0:
        return seen(pose_status=PoseStatus.NO_SIZE, reason=NO_SIZE)
    try:
        if located.condensed is not None:
            asked = check is None or camera.covariance is not None or check.wants(camera, found.number, outline)
            poses = poses_of_homography(
                located.condensed,
                camera.K,
                target.metres_from_template,
                camera if asked else None,
                located.template_xy,
            )
        else:
            poses = planar_poses(target.to_metres(located.template_xy), located.image_xy, camera)
    except EstimationError as error:
        return seen(reason=no_pose(error))
    limit = parameters.pose.ambiguity_ratio
    is_ambiguous = poses.ambiguity > limit
    return seen(
        pose_status=PoseStatus.AMBIGUOUS if is_ambiguous else PoseStatus.METRIC,
        reason=why_ambiguous(poses.ambiguity, limit) if is_ambiguous else "",
        pose=None if is_ambiguous else poses.solutions[0],
        solutions=poses.solutions,
        ambiguity=poses.ambiguity,
        calibration=None if is_ambiguous else poses.calibration,
    )


def seen_outline(target: Target, H: Matrix3) -> Points:
    """Return where a target's outer corners are seen, (4, 2) ideal px, in the order of `outline_template`.

    Raises
    ------
    DegenerateConfiguration
        If one would lie behind the camera.
    """
    x, y, w = H @ target.outline_homogeneous
    if not w.min() > 0:
        raise DegenerateConfiguration("H: a part of the target would lie behind the camera")
    return np.column_stack((x / w, y / w))


def require_plausible(target: Target, estimate: HomographyEstimate) -> None:
    """Raise `DegenerateConfiguration` when a homography cannot be a view of the whole target."""
    outline = seen_outline(target, estimate.H)
    area = abs(cv2.contourArea(outline.astype(np.float32)))
    if area < _MIN_AREA_PX:
        raise DegenerateConfiguration(f"H: the target would cover {area:.1f} px; need {_MIN_AREA_PX:g}")
