# SPDX-License-Identifier: Apache-2.0
"""From tentative matches to the pose of a planar reference: robust homography, alignment of patches, verification."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np

from imgu_ros.config.components import DetectionParameters
from imgu_ros.errors import DegenerateConfiguration, EstimationError, NoConsensus, NotConfirmed, TooFewPoints
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import Located, distorting_camera, require_plausible
from imgu_ros.reasons import why_not_found
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.verification import require_confirmed
from imgu_ros.result import ReferenceMatches, ReferenceResult, Stage, StageClock, Status
from imgu_ros.track.patch_alignment import PatchAlignment, align_patches
from imgu_ros.types import Mask, Matrix3, Points
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


@dataclass(frozen=True, slots=True, eq=False)
class _Agreed:
    """A homography on which tentative matches agree: the `inliers`, (N,), in ideal px at `ideal_xy`, (N, 2)."""

    H: Matrix3
    inliers: Mask
    ideal_xy: Points


@dataclass(frozen=True, slots=True, eq=False)
class LocatedMatches:
    """A reference that was located, and the matches that it was located by.

    Attributes
    ----------
    matches : tentative ones; those that agree with the homography are its inliers
    located : by the inliers
    """

    matches: ReferenceMatches
    located: Located


#: Returns more matches than a reference was located by, or the same.
Guide = Callable[[LocatedMatches], LocatedMatches]
#: Completes the result of a reference that was located.
Finish = Callable[[ReferenceResult, Located], ReferenceResult]


class RobustFit:
    """Locates planar references in one frame by tentative matches.

    Parameters
    ----------
    frame : gives the camera
    image : its image; None: nothing is refined by patches, nor verified by comparing images
    unit_px : raw px in a pixel of the image in which keypoints were detected
    parameters : those of detection
    clock : takes the time of the stages
    """

    def __init__(
        self, frame: Frame, image: FrameImage | None, unit_px: float, parameters: DetectionParameters, clock: StageClock
    ) -> None:
        self._frame = frame
        self._image = image
        self._lens = distorting_camera(frame.camera)
        self._unit_px = unit_px
        self._parameters = parameters
        self._clock = clock

    def locate(
        self,
        result: ReferenceResult,
        reference: Reference,
        rng: np.random.Generator,
        guide: Guide | None = None,
        finish: Finish | None = None,
    ) -> ReferenceResult:
        """Return the result of a reference; a failure becomes a status with its reason.

        Parameters
        ----------
        result : with its tentative matches, best first
        reference : the reference
        rng : draws minimal samples
        guide : matches again once the reference was located; None: the given matches are all
        finish : completes the result; None: by the reference's pose
        """
        matches, clock, p = result.matches, self._clock, self._parameters
        if matches is None:
            return result
        try:
            with clock.measures(Stage.HOMOGRAPHY):
                agreed = self._agreed(matches, rng)
                matches = replace(matches, inliers=agreed.inliers)
                result = replace(result, most_inliers=int(np.count_nonzero(agreed.inliers)))
                located = None if p.refinement.enabled else self._fitted(agreed, matches)
                if guide is not None:
                    more = guide(LocatedMatches(matches, located or self._fitted(agreed, matches)))
                    matches, located = more.matches, more.located
            is_confirmed, share = self._image is None, None
            if p.refinement.enabled and self._image is not None:
                H = _start(reference, agreed, matches) if located is None else located.homography.H
                with clock.measures(Stage.REFINE):
                    aligned = self._aligned(reference, self._image, H)
                if aligned is not None:
                    located = aligned
                    share = aligned.agreeing_share
                    is_confirmed = share >= _CONFIRMING_SHARE
            with clock.measures(Stage.HOMOGRAPHY):
                # Where patches do not agree (blur, little texture), keypoints still tell where the reference is.
                located = located or replace(self._fitted(agreed, matches), halvings=_NOT_SHARP)
                # Where little of a reference is in view, only the refined homography is accurate enough to judge.
                require_plausible(reference.plane, located.homography)
                if not is_confirmed and self._image is not None:
                    share = require_confirmed(self._image, reference, located.homography.H, self._lens)
        except EstimationError as error:
            return _missing(result, error, len(matches.template_xy), p)
        detected = replace(result, status=Status.DETECTED, matches=matches, confirmed_share=share, most_inliers=0)
        with clock.measures(Stage.POSE):
            if finish is not None:
                return finish(detected, located)
            return reference.pose(detected, located, self._frame)

    def _agreed(self, matches: ReferenceMatches, rng: np.random.Generator) -> _Agreed:
        p, usable, ideal = self._parameters.homography, np.arange(len(matches.template_xy)), matches.image_xy
        if self._lens is not None:
            ideal, valid = self._lens.ideal_pixels(matches.image_xy)
            usable = np.flatnonzero(valid)
        if len(usable) < p.min_inliers:
            raise TooFewPoints(f"matches: {len(usable)}; need {p.min_inliers}")
        estimate = homography_estimator(self._parameters)(
            matches.template_xy[usable],
            ideal[usable],
            p.threshold_px * self._unit_px,
            rng,
            _BY_CHANCE if self._image is None else math.inf,
        )
        inliers = np.zeros(len(matches.template_xy), bool)
        inliers[usable[estimate.inliers]] = True
        return _Agreed(estimate.H, inliers, ideal)

    def _fitted(self, agreed: _Agreed, matches: ReferenceMatches) -> Located:
        """Return the location that minimises the inliers' error."""
        p = self._parameters.homography
        estimate = fit_homography(
            matches.template_xy[agreed.inliers],
            agreed.ideal_xy[agreed.inliers],
            error=p.error,
            refine=None if p.refine == "none" else p.refine,
            start=agreed.H,
        )
        return Located(matches.template_xy[agreed.inliers], matches.image_xy[agreed.inliers], estimate)

    def _aligned(self, reference: Reference, image: FrameImage, H: Matrix3) -> PatchAlignment | None:
        """Return the alignment of patches; None when they do not agree."""
        p = self._parameters
        try:
            aligned = align_patches(
                image, reference, H, self._lens, p.refinement, p.homography.min_inliers, _DETECTION_REACH_PX
            )
            require_plausible(reference.plane, aligned.homography)
        except EstimationError:
            return None
        return aligned


def _missing(
    result: ReferenceResult, error: EstimationError, matches: int, parameters: DetectionParameters
) -> ReferenceResult:
    """Return the result of a reference that was searched and not found."""
    agreeing = max(result.most_inliers, error.inliers if isinstance(error, NoConsensus) else 0)
    return replace(
        result,
        status=Status.DEGENERATE if isinstance(error, DegenerateConfiguration) else result.status,
        reason=why_not_found(error, matches, agreeing, parameters.homography.min_inliers),
        confirmed_share=error.share if isinstance(error, NotConfirmed) else None,
        most_inliers=agreeing,
    )


def draws(seed: int, stamp_ns: int, reference: Reference) -> np.random.Generator:
    """Return the random generator of one frame and reference.

    It depends on the reference's name: a skipped frame, or another reference more or less, changes no other draws.
    """
    name = zlib.crc32(reference.name.encode("utf-8", "surrogatepass"))
    return np.random.default_rng((seed, stamp_ns % 2**64, name))


def homography_estimator(parameters: DetectionParameters) -> HomographyEstimator:
    """Return the chosen robust estimator, made once of its own parameters."""
    row = ESTIMATORS[parameters.homography.estimator]
    return _made(row, row.parameters_from(lambda name: attrgetter(name)(parameters)))


@lru_cache(maxsize=16)
def _made(row: EstimatorMethod, parameters: Any) -> HomographyEstimator:
    estimator: HomographyEstimator = row.made(parameters)
    return estimator


def _start(reference: Reference, agreed: _Agreed, matches: ReferenceMatches) -> Matrix3:
    """Return where to align from: the consensus, or its nearest affine map when that cannot be a view of the reference.

    Where a small part of a reference is in view, its perspective is too uncertain to be continued to all of it.
    """
    if faces_camera(agreed.H, reference.outline_template):
        return agreed.H
    src = matches.template_xy[agreed.inliers]
    affine, *_ = np.linalg.lstsq(np.column_stack((src, np.ones(len(src)))), agreed.ideal_xy[agreed.inliers], rcond=None)
    return np.vstack((affine.T, (0.0, 0.0, 1.0)))
