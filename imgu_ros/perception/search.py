"""Looking for one target in one frame: match, homography, refinement, pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

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
from imgu_ros.perception.refinement import Alignment, refine_by_alignment
from imgu_ros.perception.result import Stage, Status, TargetMatches, TargetResult
from imgu_ros.perception.target_features import TargetFeatures
from imgu_ros.perception.targets import Target
from imgu_ros.types import Mask, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.estimation.ransac import Score, ransac
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.matching.nearest import match_to_gallery
from imgu_ros.vision.projective.estimate import fit_homography
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.transform import faces_camera

#: How wrong, raw px, a homography of keypoints may be.
_DETECTION_REACH_PX = 8.0
#: Of the patches in view, spread over the target, the share that says as much as comparing all of it.
_CONFIRMING_SHARE = 0.6


class Look(StrEnum):
    """How a target is looked for."""

    FIRST = "first"  #: quickly, at every scale
    CLOSE = "close"  #: as quickly, when the camera is so near that little of it is in view
    THOROUGH = "thorough"  #: with more of the frame's keypoints, also from the side


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """A frame, ready to be searched.

    Attributes
    ----------
    frame : as it came
    pictures : the grey one, at every resolution
    features : the frame's keypoints and descriptors
    look : which of a target's they are to be matched to
    """

    frame: Frame
    pictures: Pictures
    features: Features
    look: Look = Look.FIRST

    def features_of(self, target: Target) -> TargetFeatures:
        """Return what this frame's descriptors are to be matched to."""
        return _FEATURES[self.look](target)


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
            agreed = _agreed(matches, searched, lens, parameters, rng)
            matches = replace(matches, inliers=agreed.inliers)
            located = None if parameters.refinement.enabled else _fitted(agreed, matches, parameters)
            if parameters.matching.guided:
                found = Guided(matches, located or _fitted(agreed, matches, parameters))
                more = guided(target, known, searched.features, found, lens, parameters)
                matches, located = more.matches, more.located
        confirmed = False
        if parameters.refinement.enabled:
            H = _start(target, agreed, matches) if located is None else located.homography.H
            with clock.measures(Stage.REFINE):
                aligned = _aligned(target, searched, H, lens, parameters)
            if aligned is not None:
                located = Located(aligned.template_xy, aligned.image_xy, aligned.homography, aligned.condensed)
                confirmed = len(aligned.template_xy) >= _CONFIRMING_SHARE * aligned.sought
        with clock.measures(Stage.HOMOGRAPHY):
            # Where patches do not agree (blur, little texture), keypoints still say where the target is.
            located = located or _fitted(agreed, matches, parameters)
            # Where little of a target is in view, only the refined homography is good enough to tell.
            require_plausible(target, located.homography)
            if not confirmed:
                require_confirmed(searched.pictures, target, located.homography.H, lens)
    except DegenerateConfiguration as error:
        return replace(missing, status=Status.DEGENERATE, reason=str(error))
    except EstimationError as error:
        return replace(missing, reason=str(error))
    detected = replace(missing, status=Status.DETECTED, matches=matches)
    with clock.measures(Stage.POSE):
        return posed(detected, target, located, searched.frame.camera, parameters)


_FEATURES: dict[Look, Callable[[Target], TargetFeatures]] = {
    Look.FIRST: lambda target: target.features,
    Look.CLOSE: lambda target: target.close.features(),
    Look.THOROUGH: lambda target: target.thorough.features(),
}


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


@dataclass(frozen=True, slots=True, eq=False)
class _Agreed:
    """A homography on which tentative matches agree: the `inliers`, (N,), in ideal px at `ideal_xy`, (N, 2)."""

    H: Matrix3
    inliers: Mask
    ideal_xy: Points


def _agreed(
    matches: TargetMatches, searched: Searched, lens: Camera | None, parameters: Parameters, rng: np.random.Generator
) -> _Agreed:
    p = parameters.homography
    usable = np.arange(len(matches.template_xy))
    ideal = matches.image_xy
    if lens is not None:
        ideal, valid = lens.ideal_pixels(matches.image_xy)
        usable = np.flatnonzero(valid)
    if len(usable) < p.min_inliers:
        raise TooFewPoints(f"matches: {len(usable)}; need {p.min_inliers}")
    symmetric = Score(p.score) is Score.BIWEIGHT
    model = HomographyModel(matches.template_xy[usable], ideal[usable], symmetric)
    consensus = ransac(
        model,
        p.threshold_px * searched.features.unit_px,
        rng,
        sampler=p.sampler,
        score=p.score,
        confidence=p.confidence,
        max_iterations=p.max_iterations,
        min_inliers=p.min_inliers,
        unit=" px",
    )
    inliers = np.zeros(len(matches.template_xy), bool)
    inliers[usable[consensus.inliers]] = True
    return _Agreed(model.denormalised(consensus.hypothesis), inliers, ideal)


def _start(target: Target, agreed: _Agreed, matches: TargetMatches) -> Matrix3:
    """Return where to align from: the consensus, or its nearest affine map when that cannot be a view of the target.

    Where a small part of a target is in view, its perspective is too uncertain to be continued to all of it.
    """
    if faces_camera(agreed.H, target.outline_template):
        return agreed.H
    src = matches.template_xy[agreed.inliers]
    affine, *_ = np.linalg.lstsq(np.column_stack((src, np.ones(len(src)))), agreed.ideal_xy[agreed.inliers], rcond=None)
    return np.vstack((affine.T, (0.0, 0.0, 1.0)))


def _fitted(agreed: _Agreed, matches: TargetMatches, parameters: Parameters) -> Located:
    """Return the location that minimises the inliers' error."""
    p = parameters.homography
    estimate = fit_homography(
        matches.template_xy[agreed.inliers],
        agreed.ideal_xy[agreed.inliers],
        error=p.error,
        refine=None if p.refine == "none" else p.refine,
        start=agreed.H,
    )
    return Located(matches.template_xy[agreed.inliers], matches.image_xy[agreed.inliers], estimate)


def _aligned(
    target: Target, searched: Searched, H: Matrix3, lens: Camera | None, parameters: Parameters
) -> Alignment | None:
    """Return the refined location; None when the patches do not agree."""
    try:
        aligned = refine_by_alignment(
            searched.pictures,
            target,
            H,
            lens,
            parameters.refinement,
            parameters.homography.min_inliers,
            _DETECTION_REACH_PX,
        )
        require_plausible(target, aligned.homography)
    except EstimationError:
        return None
    return aligned
