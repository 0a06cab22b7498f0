# SPDX-License-Identifier: Apache-2.0
"""Refinement: a target's patches are aligned with the frame, from coarse to full resolution."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imgu_ros.config.parameters import RefinementParameters
from imgu_ros.errors import DegenerateConfiguration, EstimationError, NoConsensus
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import seen_outline
from imgu_ros.reference.reference import Reference
from imgu_ros.track.patch_alignment import AlignmentOptions, Followed, follow_patches
from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.projective.homography import HomographyEstimate, HomographyNormalEquations

#: Largest error that patches bridge, px of the level in which they are aligned. Measured: benchmarks/thresholds.py,
#: study reach.
_REACH_PX = 3.0
#: Smallest side of the reference in the coarsest level. Measured: benchmarks/thresholds.py, study reach.
_COARSEST_SIDE_PX = 60
#: Number of halvings from one level to the next. Measured: benchmarks/thresholds.py, study reach.
_STRIDE = 2
#: Levels halved more often give a start, not a result. Measured: benchmarks/thresholds.py, study blur.
_COARSEST_RESULT = 2
#: Share of the patches that must agree in a reduced level. Measured: benchmarks/thresholds.py, study tracking.
_COARSE_SHARE = 0.5
#: Below this blur gain, patches of a reduced level are more accurate than those of full resolution. Measured:
#: benchmarks/thresholds.py, study blur.
_BLURRED = 0.6
#: Number of patches in a level that gives a start. Measured: benchmarks/thresholds.py, study reach.
_COARSE_PATCHES = 80
#: Most iterations in a level that gives a start. Measured: benchmarks/thresholds.py, study reach.
_COARSE_STEPS = 8
#: Motion below which iterations stop in such a level, px of the level. Measured: benchmarks/thresholds.py, study reach.
_COARSE_ENOUGH_PX = 0.2
#: Most iterations in the level that gives the result. Measured: benchmarks/thresholds.py, study tracking.
_FINE_STEPS = 10
#: Motion below which iterations stop there, px of the level: the last fit is exact to first order in it. Measured:
#: benchmarks/thresholds.py, study tracking.
_FINE_ENOUGH_PX = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Patches of a target found in a frame by alignment.

    Attributes
    ----------
    template_xy : (N, 2) template px
    image_xy : (N, 2) raw px
    condensed : what they tell; every one is an inlier
    sought : patches that were looked for
    halvings : of the finest picture in which they were found; 0: full resolution
    """

    template_xy: Points
    image_xy: Points
    condensed: HomographyNormalEquations
    sought: int
    halvings: int

    @property
    def agreeing_share(self) -> float:
        """Share of the patches looked for that agree, 0 to 1."""
        return len(self.template_xy) / self.sought

    @property
    def homography(self) -> HomographyEstimate:
        """H_image_template in ideal px."""
        return self.condensed.estimate


def refine_by_alignment(
    pictures: FrameImage,
    target: Reference,
    H: Matrix3,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_points: int,
    reach_px: float,
) -> Alignment:
    """Align a target with a frame, starting from a homography that is nearly right.

    Where full resolution shows no patches (blur), the result is that of a reduced picture.

    Parameters
    ----------
    pictures : the frame's
    target : the target
    H : H_image_template in ideal px (raw px without a distorted camera)
    camera : intrinsics when the lens distorts; else None
    parameters : number and size of the patches
    min_points : fewest patches that must agree
    reach_px : how wrong H may be, raw px

    Raises
    ------
    NoConsensus, TooFewPoints, DegenerateConfiguration
        If the patches do not agree on a homography.
    """
    found: Followed | None = None
    failure: EstimationError | None = None
    at = 0
    for halvings in _ladder(_first_halvings(pictures, target, H, reach_px)):
        try:
            found = follow_patches(
                pictures, halvings, target, H, camera, _effort(parameters, min_points, halvings == 0)
            )
            H, at = found.H, halvings
        except EstimationError as error:
            # Without its traceback, which holds this frame, which holds the error: the frame's pictures would live on.
            failure = error.with_traceback(None)
            # What a reduced picture showed stands; where it showed nothing, a finer one may.
            if found is not None:
                break
    if found is not None and at == 0 and found.response < _BLURRED:
        found, at = _reduced_instead(pictures, target, found, camera, parameters, min_points)
    if found is None or (at > 0 and not _stands_alone(found, at)):
        try:
            raise failure or NoConsensus("patches: not found")
        finally:
            del failure
    if not found.settled:
        raise NoConsensus(f"patches: they still move by {found.motion.largest_px:.2f} px; need a better start")
    return _fitted(found, at, camera, min_points)


def _reduced_instead(
    pictures: FrameImage,
    target: Reference,
    found: Followed,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_points: int,
) -> tuple[Followed, int]:
    """Return the patches of the finest picture that is as sharp as the target there, and how often it is halved."""
    at = 0
    for halvings in range(1, min(_COARSEST_RESULT, pictures.most_halvings) + 1):
        try:
            effort = _effort(parameters, min_points, for_result=True)
            reduced = follow_patches(pictures, halvings, target, found.H, camera, effort)
        except EstimationError:
            break
        if not _stands_alone(reduced, halvings):
            break
        found, at = reduced, halvings
        if found.response >= _BLURRED:
            break
    return found, at


def _stands_alone(found: Followed, halvings: int) -> bool:
    """Whether what a reduced picture showed can be a result: there, few patches agree by chance sooner."""
    return halvings <= _COARSEST_RESULT and found.settled and found.agreeing >= _COARSE_SHARE * found.sought


def _effort(parameters: RefinementParameters, min_points: int, for_result: bool) -> AlignmentOptions:
    if for_result:
        return AlignmentOptions(parameters.window_px, parameters.max_points, min_points, _FINE_STEPS, _FINE_ENOUGH_PX)
    most = min(_COARSE_PATCHES, parameters.max_points)
    return AlignmentOptions(parameters.window_px, most, min_points, _COARSE_STEPS, _COARSE_ENOUGH_PX)


def _ladder(first: int) -> list[int]:
    """Return the halvings of one picture after the other, down to full resolution."""
    return [*range(first, 0, -_STRIDE), 0]


def _first_halvings(pictures: FrameImage, target: Reference, H: Matrix3, reach_px: float) -> int:
    """Return how often to halve the frame so that patches bridge `reach_px`, and the target is not too small."""
    wanted = math.ceil(math.log2(max(reach_px / _REACH_PX, 1.0)))
    if wanted == 0:
        return 0
    height, width = pictures.shape
    try:
        extent = np.ptp(np.clip(seen_outline(target.plane, H), 0, (width, height)), axis=0)
    except DegenerateConfiguration:
        extent = np.array((width, height))
    side = math.sqrt(float(extent[0] * extent[1]))
    possible = math.floor(math.log2(max(side / _COARSEST_SIDE_PX, 1.0)))
    return min(wanted, possible, pictures.most_halvings)


def _fitted(found: Followed, halvings: int, camera: Camera | None, min_points: int) -> Alignment:
    """Fit by least squares, leaving out what is improbably far off."""
    condensed = found.condensed(min_points)
    kept = condensed.estimate.inliers
    image_xy = found.ideal_xy(kept)
    if camera is not None:
        image_xy = camera.raw_pixels(image_xy)
    return Alignment(found.template_xy(kept), image_xy, condensed, found.sought, halvings)
