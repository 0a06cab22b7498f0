# SPDX-License-Identifier: Apache-2.0
"""The pose of a plane from its homography, and whether the homography can be one of its views."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from imgu_ros.config.parameters import PoseParameters
from imgu_ros.errors import DegenerateConfiguration, EstimationError
from imgu_ros.frame import Frame
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.plane import Plane
from imgu_ros.reasons import NO_CAMERA_INFO, NO_SIZE, no_pose, why_ambiguous
from imgu_ros.result import PoseStatus, ReferenceResult
from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.camera.homography_pose import poses_of_homography_unchecked
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.projective.homography import HomographyEstimate, HomographyNormalEquations

#: A target whose outline covers less than this in the frame is not one.
_MIN_AREA_PX = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Where a reference is in a frame.

    Attributes
    ----------
    template_xy, image_xy : (N, 2) correspondences without outliers, template px and raw px
    homography : H_image_template in ideal px
    normal_equations : of the correspondences; None: not computed
    halvings : of the level of the frame in which they were found; 0: full resolution
    """

    template_xy: Points
    image_xy: Points
    homography: HomographyEstimate
    normal_equations: HomographyNormalEquations | None = None
    halvings: int = 0


@lru_cache(maxsize=8)
def distorting_camera(camera: Camera | None) -> Camera | None:
    """Return the camera when its lens distorts, else None: then raw pixels are ideal ones."""
    return camera if camera is not None and camera.is_distorted else None


def with_homography(found: ReferenceResult, plane: Plane, located: Located, camera: Camera | None) -> ReferenceResult:
    """Return a result with its homography and outline.

    Raises
    ------
    DegenerateConfiguration
        If a part of the reference would lie behind the camera.
    """
    outline = seen_outline(plane, located.homography.H)
    lens = distorting_camera(camera)
    if lens is not None:
        outline = lens.raw_pixels(outline)
    return replace(found, homography=located.homography, outline=outline, is_sharp=located.halvings == 0)


def planar_pose(
    found: ReferenceResult,
    plane: Plane,
    located: Located,
    frame: Frame,
    parameters: PoseParameters,
    check: CalibrationCheck | None = None,
) -> ReferenceResult:
    """Return a result with homography, outline and, where it can be estimated, the pose of a plane.

    Parameters
    ----------
    found : what is known so far
    plane, located : the reference's, and where it is
    frame : gives the camera
    parameters : when a pose is ambiguous
    check : is asked whether it needs the residuals of the pose; None: they are computed

    Raises
    ------
    DegenerateConfiguration
        If a part of the reference would lie behind the camera.
    """
    camera = frame.camera
    found = with_homography(found, plane, located, camera)
    if camera is None:
        reason = frame.camera_reason or NO_CAMERA_INFO
        return replace(found, pose_status=PoseStatus.UNCALIBRATED, reason=reason)
    if plane.width_m == 0:
        return replace(found, pose_status=PoseStatus.NO_SIZE, reason=NO_SIZE)
    try:
        if located.normal_equations is not None and found.outline is not None:
            asked = check is None or camera.covariance is not None or check.wants(camera, found.name, found.outline)
            poses = poses_of_homography_unchecked(
                located.normal_equations,
                camera.K,
                plane.metres_from_template,
                camera if asked else None,
                located.template_xy,
            )
        else:
            poses = planar_poses(plane.to_metres(located.template_xy), located.image_xy, camera)
    except EstimationError as error:
        return replace(found, reason=no_pose(error))
    limit = parameters.ambiguity_ratio
    is_ambiguous = poses.ambiguity > limit
    return replace(
        found,
        pose_status=PoseStatus.AMBIGUOUS if is_ambiguous else PoseStatus.METRIC,
        reason=why_ambiguous(poses.ambiguity, limit) if is_ambiguous else "",
        pose=None if is_ambiguous else poses.solutions[0],
        solutions=poses.solutions,
        ambiguity=poses.ambiguity,
        calibration=None if is_ambiguous else poses.calibration,
    )


def seen_outline(plane: Plane, H: Matrix3) -> Points:
    """Return where a reference's outer corners are seen, (4, 2) ideal px, in the order of `Plane.outline`.

    Raises
    ------
    DegenerateConfiguration
        If one would lie behind the camera.
    """
    x, y, w = H @ plane.outline_homogeneous
    if not w.min() > 0:
        raise DegenerateConfiguration("H: a part of the target would lie behind the camera")
    return np.column_stack((x / w, y / w))


def require_plausible(plane: Plane, estimate: HomographyEstimate) -> None:
    """Raise `DegenerateConfiguration` when a homography cannot be a view of the whole reference."""
    area = abs(cv2.contourArea(seen_outline(plane, estimate.H).astype(np.float32)))
    if area < _MIN_AREA_PX:
        raise DegenerateConfiguration(f"H: the target would cover {area:.1f} px; need {_MIN_AREA_PX:g}")
