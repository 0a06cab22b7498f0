"""Looking for one target in one frame: match, homography, refinement, pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imgu_ros.errors import DegenerateConfiguration, EstimationError, TooFewPoints
from imgu_ros.params import Parameters
from imgu_ros.perception.clock import StageClock
from imgu_ros.perception.confirming import require_confirmed
from imgu_ros.perception.features import Features
from imgu_ros.perception.frame import Frame
from imgu_ros.perception.guiding import Guided, guided
from imgu_ros.perception.pictures import Pictures
from imgu_ros.perception.posing import Located, bending, posed, require_plausible
from imgu_ros.perception.refinement import refine_by_alignment
from imgu_ros.perception.result import Stage, Status, TargetMatches, TargetResult
from imgu_ros.perception.target_features import TargetFeatures
from imgu_ros.perception.targets import Target
from imgu_ros.types import Mask
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.matching.nearest import match_to_gallery
from imgu_ros.vision.projective.estimate import estimate_homography

#: How wrong, raw px, a homography of keypoints may be.
_DETECTION_REACH_PX = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """A frame, ready to be searched.

    Attributes
    ----------
    frame : as it came
    pictures : the grey one, at every resolution
    features : the frame's keypoints and descriptors
    thorough : whether they are those of a thorough search
    """

    frame: Frame
    pictures: Pictures
    features: Features
    thorough: bool = False

    def features_of(self, target: Target) -> TargetFeatures:
        """Return what this frame's descriptors are to be matched to."""
        return target.thorough.features() if self.thorough else target.features


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
        known = searched.features_of(target)
        matches = _matched(known, searched.features.described, parameters)
    missing = TargetResult(target.name, index, Status.LOST, matches=matches)
    lens = bending(searched.frame.camera)
    try:
        with clock.measures(Stage.HOMOGRAPHY):
            located, inliers = _located(target, matches, searched, lens, parameters, rng)
            matches = replace(matches, inliers=inliers)
            if parameters.matching.guided:
                more = guided(target, known, searched.features, Guided(matches, located), lens, parameters)
                matches, located = more.matches, more.located
        with clock.measures(Stage.REFINE):
            if parameters.refinement.enabled:
                located = _aligned(target, searched, located, lens, parameters)
            # Where little of a target is in view, only the refined homography is good enough to tell.
            require_plausible(target, located.homography)
            require_confirmed(searched.pictures, target, located.homography.H, lens)
    except DegenerateConfiguration as error:
        return replace(missing, status=Status.DEGENERATE, reason=str(error))
    except EstimationError as error:
        return replace(missing, reason=str(error))
    found = replace(missing, status=Status.DETECTED, matches=matches)
    with clock.measures(Stage.POSE):
        return posed(found, target, located, searched.frame.camera, parameters)


def _matched(known: TargetFeatures, described: Descriptions, parameters: Parameters) -> TargetMatches:
    p = parameters.matching
    found = match_to_gallery(described.descriptors, known.gallery, p.ratio, p.mutual)
    # Sought from the frame to the target, told from the target to the frame.
    matches = Matches(found.index_dst, found.index_src, found.distance)
    return TargetMatches(
        matches,
        known.described.keypoints.xy[matches.index_src],
        described.keypoints.xy[matches.index_dst],
        np.zeros(len(matches), bool),
    )


def _located(
    target: Target,
    matches: TargetMatches,
    searched: Searched,
    lens: Camera | None,
    parameters: Parameters,
    rng: np.random.Generator,
) -> tuple[Located, Mask]:
    """Return the homography of the tentative matches, and which of them agree with it."""
    p = parameters.homography
    usable = np.ones(len(matches.template_xy), bool)
    ideal = matches.image_xy
    if lens is not None:
        ideal, usable = lens.ideal_pixels(matches.image_xy)
    count = np.count_nonzero(usable)
    if count < p.min_inliers:
        raise TooFewPoints(f"matches: {count}; need {p.min_inliers}")
    estimate = estimate_homography(
        matches.template_xy[usable],
        ideal[usable],
        rng,
        threshold_px=p.threshold_px * searched.features.unit_px,
        sampler=p.sampler,
        score=p.score,
        confidence=p.confidence,
        max_iterations=p.max_iterations,
        min_inliers=p.min_inliers,
        error=p.error,
        refine=None if p.refine == "none" else p.refine,
    )
    inliers = np.zeros(len(usable), bool)
    inliers[np.flatnonzero(usable)[estimate.inliers]] = True
    return Located(matches.template_xy[inliers], matches.image_xy[inliers], estimate), inliers


def _aligned(
    target: Target,
    searched: Searched,
    located: Located,
    lens: Camera | None,
    parameters: Parameters,
) -> Located:
    """Return the refined location, or the given one when the patches do not agree (blur, little texture)."""
    try:
        aligned = refine_by_alignment(
            searched.pictures,
            target,
            located.homography.H,
            lens,
            parameters.refinement,
            parameters.homography.min_inliers,
            _DETECTION_REACH_PX,
        )
        require_plausible(target, aligned.homography)
    except EstimationError:
        return located
    return Located(aligned.template_xy, aligned.image_xy, aligned.homography, aligned.condensed)
