# SPDX-License-Identifier: Apache-2.0
"""From tentative matches to where a target is: homography, refinement, confirmation, pose."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np

from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.guided_matching import Guided
from imgu_ros.errors import DegenerateConfiguration, EstimationError, NoConsensus, NotConfirmed, TooFewPoints
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import Located, bending, require_plausible
from imgu_ros.reasons import why_not_found
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.verification import require_confirmed
from imgu_ros.result import ReferenceMatches, ReferenceResult, Stage, StageClock, Status
from imgu_ros.track.patch_alignment import PatchAlignment, align_patches
from imgu_ros.types import Mask, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.methods import ESTIMATORS, EstimatorMethod
from imgu_ros.vision.projective.fit import fit_homography
from imgu_ros.vision.projective.robust import HomographyEstimator
from imgu_ros.vision.projective.transform import faces_camera

#: Hypotheses as good as the answer that wrong matches are expected to give, where nothing else confirms a target.
#: Comparing it with the frame tells it from chance better: with both, one in ten seen small or steeply was lost
#: (`imgu bench --suite detection --conditions size-10,tilt-70`).
_BY_CHANCE = 1e-3
#: Number of halvings reported where patches did not confirm a pose: its covariance must not judge a calibration.
_NOT_SHARP = 1
#: Largest error of a homography from keypoints that alignment must bridge, raw px. Measured: benchmarks/thresholds.py,
#: study detection.
_DETECTION_REACH_PX = 8.0
#: Share of the patches in view that must agree to make a comparison of the whole reference unnecessary. Measured:
#: benchmarks/thresholds.py, study detection.
_CONFIRMING_SHARE = 0.8


#: Completes a result by what the place of a reference tells.
Finish = Callable[[ReferenceResult, Located], ReferenceResult]


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What tentative matches are weighed by.

    Attributes
    ----------
    frame : gives the camera
    pictures : its grey image, at every resolution; None: nothing is refined, nor verified by comparing images
    unit_px : raw px in a pixel of the image in which keypoints were detected
    """

    frame: Frame
    pictures: FrameImage | None
    unit_px: float


def located(
    target: ReferenceResult,
    known: Reference,
    sight: Sight,
    parameters: Parameters,
    rng: np.random.Generator,
    clock: StageClock,
    guide: Callable[[Guided], Guided] | None = None,
    finish: Finish | None = None,
) -> ReferenceResult:
    """Find where a target is by its tentative matches; what fails becomes a status with its reason.

    Parameters
    ----------
    target : with its tentative matches, best first
    known : the target itself
    sight : what they are weighed by
    parameters : all parameters
    rng : draws minimal samples
    clock : takes the time of the stages
    guide : looks for more matches once the target was found; None: those given are all
    finish : completes the result; None: by the reference's pose
    """
    matches = target.matches
    if matches is None:
        return target
    lens = bending(sight.frame.camera)
    try:
        with clock.measures(Stage.HOMOGRAPHY):
            agreed = _agreed(matches, sight, lens, parameters, rng)
            matches = replace(matches, inliers=agreed.inliers)
            target = replace(target, most_inliers=int(np.count_nonzero(agreed.inliers)))
            place = None if parameters.refinement.enabled else _fitted(agreed, matches, parameters)
            if guide is not None:
                more = guide(Guided(matches, place or _fitted(agreed, matches, parameters)))
                matches, place = more.matches, more.located
        is_confirmed, share = sight.pictures is None, None
        if parameters.refinement.enabled and sight.pictures is not None:
            H = _start(known, agreed, matches) if place is None else place.homography.H
            with clock.measures(Stage.REFINE):
                aligned = _aligned(known, sight.pictures, H, lens, parameters)
            if aligned is not None:
                place = Located(
                    aligned.template_xy,
                    aligned.image_xy,
                    aligned.homography,
                    aligned.normal_equations,
                    aligned.halvings,
                )
                share = aligned.agreeing_share
                is_confirmed = share >= _CONFIRMING_SHARE
        with clock.measures(Stage.HOMOGRAPHY):
            # Where patches do not agree (blur, little texture), keypoints still say where the target is.
            place = place or replace(_fitted(agreed, matches, parameters), halvings=_NOT_SHARP)
            # Where little of a target is in view, only the refined homography is good enough to tell.
            require_plausible(known.plane, place.homography)
            if not is_confirmed and sight.pictures is not None:
                share = require_confirmed(sight.pictures, known, place.homography.H, lens)
    except EstimationError as error:
        return _missing(target, error, len(matches.template_xy), parameters)
    detected = replace(target, status=Status.DETECTED, matches=matches, confirmed_share=share, most_inliers=0)
    with clock.measures(Stage.POSE):
        if finish is not None:
            return finish(detected, place)
        return known.pose(detected, place, sight.frame, parameters)


def _missing(target: ReferenceResult, error: EstimationError, matches: int, parameters: Parameters) -> ReferenceResult:
    """Return the result of a target that was looked for and not found."""
    agreeing = max(target.most_inliers, error.inliers if isinstance(error, NoConsensus) else 0)
    return replace(
        target,
        status=Status.DEGENERATE if isinstance(error, DegenerateConfiguration) else target.status,
        reason=why_not_found(error, matches, agreeing, parameters.homography.min_inliers),
        confirmed_share=error.share if isinstance(error, NotConfirmed) else None,
        most_inliers=agreeing,
    )


def draws(parameters: Parameters, stamp_ns: int, reference: Reference) -> np.random.Generator:
    """Return the random generator of one frame and reference.

    It depends on the reference's name: a skipped frame, or another reference more or less, changes no other draws.
    """
    name = zlib.crc32(reference.name.encode("utf-8", "surrogatepass"))
    return np.random.default_rng((parameters.seed, stamp_ns % 2**64, name))


@dataclass(frozen=True, slots=True, eq=False)
class _Agreed:
    """A homography on which tentative matches agree: the `inliers`, (N,), in ideal px at `ideal_xy`, (N, 2)."""

    H: Matrix3
    inliers: Mask
    ideal_xy: Points


def _agreed(
    matches: ReferenceMatches, sight: Sight, lens: Camera | None, parameters: Parameters, rng: np.random.Generator
) -> _Agreed:
    p = parameters.homography
    usable = np.arange(len(matches.template_xy))
    ideal = matches.image_xy
    if lens is not None:
        ideal, valid = lens.ideal_pixels(matches.image_xy)
        usable = np.flatnonzero(valid)
    if len(usable) < p.min_inliers:
        raise TooFewPoints(f"matches: {len(usable)}; need {p.min_inliers}")
    estimate = homography_estimator(parameters)(
        matches.template_xy[usable],
        ideal[usable],
        p.threshold_px * sight.unit_px,
        rng,
        _BY_CHANCE if sight.pictures is None else math.inf,
    )
    inliers = np.zeros(len(matches.template_xy), bool)
    inliers[usable[estimate.inliers]] = True
    return _Agreed(estimate.H, inliers, ideal)


def homography_estimator(parameters: Parameters) -> HomographyEstimator:
    """Return the chosen robust estimator, made once of its own parameters."""
    row = ESTIMATORS[parameters.homography.estimator]
    return _made(row, row.parameters_from(lambda name: attrgetter(name)(parameters)))


@lru_cache(maxsize=16)
def _made(row: EstimatorMethod, parameters: Any) -> HomographyEstimator:
    estimator: HomographyEstimator = row.made(parameters)
    return estimator


def _start(target: Reference, agreed: _Agreed, matches: ReferenceMatches) -> Matrix3:
    """Return where to align from: the consensus, or its nearest affine map when that cannot be a view of the target.

    Where a small part of a target is in view, its perspective is too uncertain to be continued to all of it.
    """
    if faces_camera(agreed.H, target.outline_template):
        return agreed.H
    src = matches.template_xy[agreed.inliers]
    affine, *_ = np.linalg.lstsq(np.column_stack((src, np.ones(len(src)))), agreed.ideal_xy[agreed.inliers], rcond=None)
    return np.vstack((affine.T, (0.0, 0.0, 1.0)))


def _fitted(agreed: _Agreed, matches: ReferenceMatches, parameters: Parameters) -> Located:
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
    target: Reference, pictures: FrameImage, H: Matrix3, lens: Camera | None, parameters: Parameters
) -> PatchAlignment | None:
    """Return the refined location; None when the patches do not agree."""
    try:
        aligned = align_patches(
            pictures,
            target,
            H,
            lens,
            parameters.refinement,
            parameters.homography.min_inliers,
            _DETECTION_REACH_PX,
        )
        require_plausible(target.plane, aligned.homography)
    except EstimationError:
        return None
    return aligned
