# SPDX-License-Identifier: Apache-2.0
"""From tentative matches to the pose of a planar reference: robust homography, alignment of patches, verification."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np

from imgu_ros.config.components import DetectionParameters
from imgu_ros.detect.copies import best_copy
from imgu_ros.errors import (
    DegenerateConfiguration,
    EstimationError,
    LooksAlike,
    NoConsensus,
    NotConfirmed,
    TooFewPoints,
)
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import Located, distorting_camera, require_determined, require_plausible
from imgu_ros.reasons import why_not_found
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.verification import Evidence, evidence, require_confirming
from imgu_ros.result import ReferenceMatches, ReferenceResult, Stage, StageClock, Status
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.track.sample_refinement import PatchAlignment
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
#: The same of few keypoints, whose homography is extrapolated to the rest of it: as that of an unknown motion.
_EXTRAPOLATED_REACH_PX = 24.0
#: Share of the patches that must agree where much of what is in view looks otherwise. Of targets behind hands two
#: fifths and more do; with three tenths corners were 23 px off (benchmarks/foreign_frames.py, row hand). Measured:
#: benchmarks/thresholds.py, study covered.
_AGREEING = 0.36
#: Where less than this share of what is in view looks as it should, the patches must agree to so much, px: those of
#: true poses did to 0.07, a ticket's under a hand to 0.19 with corners 15 px off (benchmarks/printed_targets.py, seed
#: 811).
_MOSTLY_COVERED, _AGREE_TO_PX = 0.45, 0.15
#: Matches that must agree in a thorough search: of five of a hundred any five do. Measured:
#: benchmarks/printed_targets.py.
_FEWER = 6
#: Share of what is in view that must look as it should where fewer keypoints than usual, or none, agreed before.
_WITHOUT_KEYPOINTS = 0.6
#: So few patches must agree so closely at full resolution, px: those of true poses do to 0.24, those of half a tag
#: whose other corners were 30 px off did to 0.5 (benchmarks/printed_targets.py, seed 913). More may agree less, as
#: through a lens that is not known.
_FEW_PATCHES, _CLOSELY_PX = 24, 0.3


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
    is_thorough : fewer matches must agree, where more of what is in view looks as it should
    """

    def __init__(
        self,
        frame: Frame,
        image: FrameImage | None,
        unit_px: float,
        parameters: DetectionParameters,
        clock: StageClock,
        is_thorough: bool = False,
    ) -> None:
        self._frame = frame
        self._image = image
        self._lens = distorting_camera(frame.camera)
        self._unit_px = unit_px
        self._parameters = self._matching = parameters
        if is_thorough and image is not None and parameters.refinement.enabled:
            fewest = min(_FEWER, parameters.homography.min_inliers)
            self._matching = replace(parameters, homography=replace(parameters.homography, min_inliers=fewest))
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
        finish : completes the result, and knows of exact symmetries alone; None: by the reference's pose
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
            located, found = self._verified(reference, agreed, matches, located)
            if np.count_nonzero(agreed.inliers) < p.homography.min_inliers:
                _require_much(found)
            if finish is not None and len(located.alike) > len(reference.symmetries):
                raise LooksAlike("the target looks the same turned", None if found is None else found.share)
        except EstimationError as error:
            if 0 < result.most_inliers < p.homography.min_inliers and not isinstance(error, LooksAlike):
                # So few agree by chance, and then all kinds of things are wrong.
                error = NoConsensus("matches: too few agree", result.most_inliers)
            return _missing(result, error, len(matches.template_xy), p)
        share = None if found is None else found.share
        detected = replace(result, status=Status.DETECTED, matches=matches, confirmed_share=share, most_inliers=0)
        with clock.measures(Stage.POSE):
            if finish is not None:
                return finish(detected, located)
            return reference.pose(detected, located, self._frame)

    def locate_at(self, result: ReferenceResult, reference: Reference, starts: Sequence[Matrix3]) -> ReferenceResult:
        """Return the result of a reference that may be near some places: at the first one that the frame confirms.

        No keypoints agreed on them, so that more must look as it should.

        Parameters
        ----------
        result : what is known so far
        reference : the reference
        starts : H_image_template, ideal px
        """
        p = self._parameters
        for H in starts:
            located = self._aligned(reference, H)
            if located is None:
                continue
            try:
                with self._clock.measures(Stage.HOMOGRAPHY):
                    there, found = self._confirmed(reference, located)
                    _require_much(found)
                with self._clock.measures(Stage.POSE):
                    share = None if found is None else found.share
                    detected = replace(result, status=Status.DETECTED, reason="", confirmed_share=share)
                    return reference.pose(detected, there, self._frame)
            except EstimationError as error:
                if not result.reason or isinstance(error, LooksAlike):
                    result = _missing(result, error, 0, p)
        return result

    def _verified(
        self, reference: Reference, agreed: _Agreed, matches: ReferenceMatches, located: Located | None
    ) -> tuple[Located, Evidence | None]:
        """Return where a reference is, refined, and what the frame says of that: from the first start that it confirms.

        Raises
        ------
        EstimationError
            If the frame does not show it there.
        """
        starts: Sequence[Matrix3 | None] = (None,)
        if self._parameters.refinement.enabled and self._image is not None:
            starts = _starts(reference, agreed, matches) if located is None else (located.homography.H,)
        first: EstimationError | None = None
        for H in starts:
            aligned = None if H is None else self._aligned(reference, H)
            with self._clock.measures(Stage.HOMOGRAPHY):
                try:
                    # Where patches do not agree (blur, little texture), keypoints still tell where the reference is.
                    there = aligned or located or replace(self._fitted(agreed, matches), halvings=_NOT_SHARP)
                    return self._confirmed(reference, there)
                except EstimationError as error:
                    first = first or error
        assert first is not None
        raise first

    def _confirmed(self, reference: Reference, located: Located) -> tuple[Located, Evidence | None]:
        """Return where a reference is, of the places where it looks like itself, and what the frame says of that."""
        p = self._parameters
        found: Evidence | None = None
        # Where little of a reference is in view, only the refined homography is accurate enough to judge.
        require_plausible(reference.plane, located.homography)
        if self._image is not None:
            found = evidence(self._image, reference, located.homography.H, self._lens)
            if p.refinement.enabled and found is not None:
                located, found = best_copy(
                    self._image, reference, located, found, self._lens, p.refinement, p.homography.min_inliers
                )
            found = require_confirming(found)
            if p.refinement.enabled:
                _require_close(located, found)
                if found.is_covered:
                    _require_agreeing(located, found)
        if not located.alike:
            located = replace(located, alike=reference.symmetries)
        if p.refinement.enabled:
            # Without refinement, keypoints tell corners to some px in every frame: that is what was asked for.
            require_determined(reference.plane, located, found is not None and found.is_covered)
        return located, found

    def _agreed(self, matches: ReferenceMatches, rng: np.random.Generator) -> _Agreed:
        p, usable, ideal = self._matching.homography, np.arange(len(matches.template_xy)), matches.image_xy
        if self._lens is not None:
            ideal, valid = self._lens.ideal_pixels(matches.image_xy)
            usable = np.flatnonzero(valid)
        if len(usable) < p.min_inliers:
            raise TooFewPoints(f"matches: {len(usable)}; need {p.min_inliers}")
        estimate = homography_estimator(self._matching)(
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

    def _aligned(self, reference: Reference, H: Matrix3) -> PatchAlignment | None:
        """Return the alignment of patches; None when they do not agree."""
        p, image = self._parameters, self._image
        assert image is not None
        with self._clock.measures(Stage.REFINE):
            for reach_px in (_DETECTION_REACH_PX, _EXTRAPOLATED_REACH_PX):
                try:
                    aligned = align_patches(
                        image, reference, H, self._lens, p.refinement, p.homography.min_inliers, reach_px
                    )
                    require_plausible(reference.plane, aligned.homography)
                except EstimationError:
                    continue
                return aligned
        return None


def _require_much(found: Evidence | None) -> None:
    """Raise unless much of a reference in view looks as it should: too few keypoints agreed that it is there."""
    if found is not None and found.share < _WITHOUT_KEYPOINTS:
        raise NotConfirmed(
            f"{found.share:.0%} of what is in view looks as it should, {_WITHOUT_KEYPOINTS:.0%} needed", found.share
        )


def _require_close(located: Located, found: Evidence) -> None:
    """Raise unless few patches agree closely at full resolution: they do not tell where corners out of view are."""
    rms_px = located.homography.rms_px
    if located.halvings == 0 and len(located.template_xy) < _FEW_PATCHES and rms_px > _CLOSELY_PX:
        raise NotConfirmed(f"few patches agree, to {rms_px:.2f} px, {_CLOSELY_PX:g} px needed", found.share)


def _require_agreeing(located: Located, found: Evidence) -> None:
    """Raise unless enough patches agree: a part of a reference alone does not tell where the rest is."""
    share = located.agreeing_share if isinstance(located, PatchAlignment) else 0.0
    if share < _AGREEING:
        raise NotConfirmed(
            f"{found.share:.0%} of what is in view looks as it should, and {share:.0%} of the patches agree, "
            f"{_AGREEING:.0%} needed",
            found.share,
        )
    rms_px = located.homography.rms_px
    if found.share < _MOSTLY_COVERED and rms_px > _AGREE_TO_PX:
        raise NotConfirmed(
            f"{found.share:.0%} of what is in view looks as it should, and there the patches agree to {rms_px:.2f} px, "
            f"{_AGREE_TO_PX:g} px needed",
            found.share,
        )


def _missing(
    result: ReferenceResult, error: EstimationError, matches: int, parameters: DetectionParameters
) -> ReferenceResult:
    """Return the result of a reference that was searched and not found."""
    agreeing = max(result.most_inliers, error.inliers if isinstance(error, NoConsensus) else 0)
    return replace(
        result,
        status=Status.DEGENERATE if isinstance(error, DegenerateConfiguration) else result.status,
        reason=why_not_found(error, matches, agreeing, parameters.homography.min_inliers),
        confirmed_share=error.share if isinstance(error, NotConfirmed | LooksAlike) else None,
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


def _starts(reference: Reference, agreed: _Agreed, matches: ReferenceMatches) -> tuple[Matrix3, ...]:
    """Return where to align from: the consensus, when it can be a view of the reference, and its nearest affine map.

    Where a small part of a reference is in view, its perspective is too uncertain to be continued to all of it.
    """
    src = matches.template_xy[agreed.inliers]
    affine, *_ = np.linalg.lstsq(np.column_stack((src, np.ones(len(src)))), agreed.ideal_xy[agreed.inliers], rcond=None)
    H = np.vstack((affine.T, (0.0, 0.0, 1.0)))
    return (agreed.H, H) if faces_camera(agreed.H, reference.outline_template) else (H,)
