# SPDX-License-Identifier: Apache-2.0
"""The pose of a plane from its homography, and whether the homography can be one of its views."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from imgu_ros.config.parameters import PoseParameters
from imgu_ros.errors import DegenerateConfiguration, EstimationError, Undetermined
from imgu_ros.frame import Frame
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.plane import Plane
from imgu_ros.reasons import NO_CAMERA_INFO, NO_SIZE, looks_the_same, no_pose, why_ambiguous
from imgu_ros.result import PoseStatus, ReferenceResult
from imgu_ros.types import Floats, Matrix3, Points
from imgu_ros.vision.camera.homography_pose import poses_of_homography_unchecked
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.camera.pose_fusion import pose_after
from imgu_ros.vision.projective.homography import HomographyEstimate, HomographyNormalEquations

#: A target whose outline covers less than this in the frame is not one.
_MIN_AREA_PX = 100.0
#: Largest standard deviation of the outline's corners, rms over the four, px, where the whole reference in view looks
#: as it should.
_MOST_UNCERTAIN_PX = 3.0
#: The same where a part of it is covered: its corners are extrapolated from the rest, by up to ten times the error that
#: the residuals tell (labels under a hand).
_MOST_UNCERTAIN_COVERED_PX = 1.0
#: As a share of the outline's side, where that is more: of a target many times as large as the frame the corners are
#: far out of view.
_MOST_UNCERTAIN_SHARE = 2.5e-3


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Where a reference is in a frame.

    Attributes
    ----------
    template_xy, image_xy : (N, 2) correspondences without outliers, template px and raw px
    homography : H_image_template in ideal px
    normal_equations : of the correspondences; None: not computed
    halvings : of the level of the frame in which they were found; 0: full resolution
    H_seen : H_image_template where a rolling shutter shows the reference, for its track; None: as `homography`
    alike : motions (3, 3) of the template after which the reference looks the same there: it may as well be turned so
    told_covariance : (9, 9) of the homography by the correspondences alone, where its own also has a motion that nobody
        knows; None: its own
    """

    template_xy: Points
    image_xy: Points
    homography: HomographyEstimate
    normal_equations: HomographyNormalEquations | None = None
    halvings: int = 0
    H_seen: Matrix3 | None = None
    told_covariance: Floats | None = None
    alike: tuple[Matrix3, ...] = ()


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
    return replace(
        found,
        homography=located.homography,
        outline=outline,
        is_sharp=located.halvings == 0,
        H_seen=located.H_seen,
        alike=located.alike,
    )


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
        reason = _with_turns(frame.camera_reason or NO_CAMERA_INFO, located)
        return replace(found, pose_status=PoseStatus.UNCALIBRATED, reason=reason)
    if plane.width_m == 0:
        return replace(found, pose_status=PoseStatus.NO_SIZE, reason=_with_turns(NO_SIZE, located))
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
    reasons = [why_ambiguous(poses.ambiguity, limit)] if poses.ambiguity > limit else []
    solutions, ambiguity = poses.solutions, poses.ambiguity
    if located.alike:
        motions = [plane.motion(S) for S in located.alike]
        solutions += tuple(pose_after(pose, motion) for motion in motions for pose in poses.solutions)
        ambiguity = 1.0
        reasons.append(looks_the_same(turns_of(located.alike)))
    is_ambiguous = bool(reasons)
    return replace(
        found,
        pose_status=PoseStatus.AMBIGUOUS if is_ambiguous else PoseStatus.METRIC,
        reason="; ".join(reasons),
        pose=None if is_ambiguous else poses.solutions[0],
        solutions=solutions,
        ambiguity=ambiguity,
        width_m=plane.width_m,
        calibration=None if is_ambiguous else poses.calibration,
    )


def _with_turns(reason: str, located: Located) -> str:
    """Return why there is no pose, and where it applies, that the homography is one of several."""
    return f"{reason}; {looks_the_same(turns_of(located.alike))}" if located.alike else reason


def turns_of(motions: Iterable[Matrix3]) -> list[float]:
    """Return by how much motions (3, 3) of a template turn it, degrees, 0 to 360."""
    return [math.degrees(math.atan2(S[1, 0], S[0, 0])) % 360 for S in motions]


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


def corner_uncertainty_px(plane: Plane, located: Located) -> float:
    """Return the standard deviation of the outer corners by the correspondences, rms over the four, ideal px."""
    corners, estimate = plane.outline_homogeneous, located.homography
    covariance = estimate.covariance if located.told_covariance is None else located.told_covariance
    x, y, w = estimate.H @ corners
    at = corners / w  # (3, 4)
    J = np.zeros((2, 4, 3, 3))
    J[0, :, 0] = J[1, :, 1] = at.T
    J[:, :, 2] = -np.stack((x / w, y / w))[:, :, None] * at.T
    rows = J.reshape(8, 9)
    variance = float(((rows @ covariance) * rows).sum())
    return math.sqrt(max(variance, 0.0) / 4)


def require_determined(plane: Plane, located: Located, is_covered: bool = False) -> None:
    """Raise `Undetermined` when the corners of a reference, a part of which may be covered, are too uncertain."""
    sigma = corner_uncertainty_px(plane, located)
    most = _MOST_UNCERTAIN_COVERED_PX if is_covered else _MOST_UNCERTAIN_PX
    if sigma <= most:
        return
    if not is_covered:
        side = math.sqrt(abs(cv2.contourArea(seen_outline(plane, located.homography.H).astype(np.float32))))
        most = max(most, _MOST_UNCERTAIN_SHARE * side)
    if not sigma <= most:
        raise Undetermined(f"its corners are known to {sigma:.1f} px, {most:g} px needed")


def require_plausible(plane: Plane, estimate: HomographyEstimate) -> None:
    """Raise `DegenerateConfiguration` when a homography cannot be a view of the whole reference."""
    area = abs(cv2.contourArea(seen_outline(plane, estimate.H).astype(np.float32)))
    if area < _MIN_AREA_PX:
        raise DegenerateConfiguration(f"H: the target would cover {area:.1f} px; need {_MIN_AREA_PX:g}")
