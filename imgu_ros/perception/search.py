"""Looking for one target in one frame: match, homography, refinement, pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from imgu_ros.errors import DegenerateConfiguration, EstimationError
from imgu_ros.params import Parameters
from imgu_ros.perception.clock import StageClock
from imgu_ros.perception.frame import Frame
from imgu_ros.perception.refinement import refine_by_alignment
from imgu_ros.perception.result import PoseStatus, Stage, Status, TargetMatches, TargetResult
from imgu_ros.perception.targets import Target
from imgu_ros.types import Image, Mask, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.matching.nearest import match
from imgu_ros.vision.projective.estimate import estimate_homography
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.transform import faces_camera, transform

#: A target whose outline covers less than this in the frame is not one.
_MIN_AREA_PX = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """A frame, ready to be searched.

    Attributes
    ----------
    frame : as it came
    grey : (H, W) uint8
    described : the frame's keypoints and descriptors
    """

    frame: Frame
    grey: Image
    described: Descriptions


@dataclass(frozen=True, slots=True, eq=False)
class _Located:
    """Correspondences that carry the pose, with their homography: template px, raw px."""

    template_xy: Points
    image_xy: Points
    homography: HomographyEstimate


def search(
    target: Target,
    index: int,
    searched: Searched,
    parameters: Parameters,
    rng: np.random.Generator,
    clock: StageClock,
) -> TargetResult:
    """Look for a target in a frame; what fails becomes a status with its reason."""
    with clock.measures(Stage.MATCH):
        matches = _matched(target, searched.described, parameters)
    missing = TargetResult(target.name, index, Status.LOST, matches=matches)
    camera = searched.frame.camera
    bending = camera if camera is not None and camera.is_distorted else None
    try:
        with clock.measures(Stage.HOMOGRAPHY):
            located, inliers = _located(target, matches, bending, parameters, rng)
    except DegenerateConfiguration as error:
        return replace(missing, status=Status.DEGENERATE, reason=str(error))
    except EstimationError as error:
        return replace(missing, reason=str(error))
    if parameters.refinement.enabled:
        with clock.measures(Stage.REFINE):
            located = _aligned(target, searched, located, bending, parameters, rng)
    outline = transform(located.homography.H, target.outline_template)
    found = replace(
        missing,
        status=Status.DETECTED,
        matches=replace(matches, inliers=inliers),
        homography=located.homography,
        outline=outline if bending is None else bending.raw_pixels(outline),
    )
    with clock.measures(Stage.POSE):
        return _posed(found, target, located, camera, parameters)


def _matched(target: Target, described: Descriptions, parameters: Parameters) -> TargetMatches:
    p = parameters.matching
    found = match(
        described.descriptors,
        target.described.descriptors,
        p.metric,
        p.ratio,
        p.mutual,
        dst_xy=target.described.keypoints.xy,
    )
    # Sought from the frame to the target, told from the target to the frame.
    matches = Matches(found.index_dst, found.index_src, found.distance)
    return TargetMatches(
        matches,
        target.described.keypoints.xy[matches.index_src],
        described.keypoints.xy[matches.index_dst],
        np.zeros(len(matches), bool),
    )


def _located(
    target: Target, matches: TargetMatches, bending: Camera | None, parameters: Parameters, rng: np.random.Generator
) -> tuple[_Located, Mask]:
    """Return the homography of the tentative matches, and which of them agree with it."""
    p = parameters.homography
    usable = np.ones(len(matches.template_xy), bool)
    ideal = matches.image_xy
    if bending is not None:
        ideal, usable = bending.ideal_pixels(matches.image_xy)
    estimate = estimate_homography(
        matches.template_xy[usable],
        ideal[usable],
        rng,
        threshold_px=p.threshold_px,
        sampler=p.sampler,
        confidence=p.confidence,
        max_iterations=p.max_iterations,
        min_inliers=p.min_inliers,
        error=p.error,
        refine=None if p.refine == "none" else p.refine,
    )
    _require_plausible(target, estimate)
    inliers = np.zeros(len(usable), bool)
    inliers[np.flatnonzero(usable)[estimate.inliers]] = True
    return _Located(matches.template_xy[inliers], matches.image_xy[inliers], estimate), inliers


def _require_plausible(target: Target, estimate: HomographyEstimate) -> None:
    if not faces_camera(estimate.H, target.outline_template):
        raise DegenerateConfiguration("H: a part of the target would lie behind the camera")
    outline = transform(estimate.H, target.outline_template)
    area = abs(cv2.contourArea(outline.astype(np.float32)))
    if area < _MIN_AREA_PX:
        raise DegenerateConfiguration(f"H: the target would cover {area:.1f} px; need {_MIN_AREA_PX:g}")


def _aligned(
    target: Target,
    searched: Searched,
    located: _Located,
    bending: Camera | None,
    parameters: Parameters,
    rng: np.random.Generator,
) -> _Located:
    """Return the refined location, or the given one when the patches do not agree (blur, little texture)."""
    try:
        aligned = refine_by_alignment(
            searched.grey, target, located.homography.H, bending,
            parameters.refinement, parameters.homography.min_inliers, rng,
        )
        _require_plausible(target, aligned.homography)
    except EstimationError:
        return located
    return _Located(aligned.template_xy, aligned.image_xy, aligned.homography)


def _posed(
    found: TargetResult, target: Target, located: _Located, camera: Camera | None, parameters: Parameters
) -> TargetResult:
    if camera is None:
        return replace(found, pose_status=PoseStatus.UNCALIBRATED, reason="no calibration: K is zero or there is no camera_info")
    if target.width_m == 0:
        return replace(found, pose_status=PoseStatus.NO_SIZE, reason="targets.widths_m is 0 for this target")
    try:
        poses = planar_poses(target.to_metres(located.template_xy), located.image_xy, camera)
    except EstimationError as error:
        return replace(found, reason=str(error))
    ambiguous = poses.ambiguity > parameters.pose.ambiguity_ratio
    return replace(
        found,
        pose_status=PoseStatus.AMBIGUOUS if ambiguous else PoseStatus.METRIC,
        reason="both planar solutions fit" if ambiguous else "",
        pose=None if ambiguous else poses.solutions[0],
        solutions=poses.solutions,
        ambiguity=poses.ambiguity,
    )
