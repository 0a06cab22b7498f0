# SPDX-License-Identifier: Apache-2.0
"""Finding a target's patches in a frame, at one resolution: align, fit the motion that most agree on, and again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.reference.reference import Reference
from imgu_ros.track.patch_selection import Bank, Reduction, fitting_bank, in_view, mapped, sheet_of
from imgu_ros.types import Floats, Mask, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.matching.alignment import Patches
from imgu_ros.vision.matching.blur_gain import BlurGain
from imgu_ros.vision.projective.homography import HomographyNormalEquations, homography_normal_equations
from imgu_ros.vision.projective.plane_motion import Motion

#: Smallest correlation of a patch that is used. Measured: benchmarks/thresholds.py, study tracking.
_MIN_SIMILARITY = 0.5
#: Largest displacement of a patch that is used, as a share of its side. Measured: benchmarks/thresholds.py, study
#: tracking.
_FARTHEST_SHARE = 0.5
#: Fewest patches that must be usable in each iteration; a homography needs four. Measured: benchmarks/thresholds.py,
#: study tracking.
_FEWEST_AT_FIRST = 6
#: Number of patches in the first iterations; the others join when these move little. Measured:
#: benchmarks/thresholds.py, study tracking.
_SCOUTS = 60
#: The other patches join when the first ones move less, px of the level. Measured: benchmarks/thresholds.py, study
#: tracking.
_SCOUTED_PX = 0.3
#: Largest motion in the last iteration that still counts as converged, px of the level. Measured:
#: benchmarks/thresholds.py, study tracking.
_SETTLED_PX = 0.5
#: A median correlation below this means that the image is blurred: iterations then fall short of the displacement.
#: Measured: benchmarks/thresholds.py, study blur.
_SHARP_SIMILARITY = 0.9
#: Factor on the motion at which iterations stop, where the image is blurred. Measured: benchmarks/thresholds.py, study
#: blur.
_BLURRED_SHARE = 0.2
#: With fewer patches an affine motion is fitted: two parameters less. Measured: benchmarks/thresholds.py, study
#: tracking.
_ENOUGH_FOR_PROJECTIVE = 40


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Patches that were found.

    Attributes
    ----------
    H : H_image_template in ideal px, the motion that most agree on
    sought : how many were tried
    agreeing : how many agree
    bank : of the target's patches
    patches : those that were tried
    displacements : (N, 2) px of the bank, at `H_before`
    usable : (N,) those that look alike and near enough
    motion : what they make
    H_before : (3, 3) ideal px from the bank's px, without the motion
    settled : whether the last round hardly moved a patch
    response : how far displacements go in the picture's most blurred direction, 1 where it is as sharp as the target
    """

    H: Matrix3
    sought: int
    agreeing: int
    bank: Bank
    patches: Patches
    displacements: Points
    usable: Mask
    motion: Motion
    H_before: Matrix3
    settled: bool
    response: float

    def condensed(self, min_points: int) -> HomographyNormalEquations:
        """Return H_image_template with its covariance, in ideal px, of the patches that are not improbably far off.

        Raises
        ------
        NoConsensus, DegenerateConfiguration
            If there are too few, or they do not determine it.
        """
        return homography_normal_equations(
            self.patches.motions(affine=False),
            self.displacements,
            self.motion,
            self.H_before,
            self.bank.bank_from_template,
            self.patches.overlap,
            max(min_points, 5),
            self.usable,
        )

    def template_xy(self, chosen: Mask) -> Points:
        """Return some of the patches' centres, template px."""
        return self.bank.template_xy(self.patches.centres[chosen])

    def ideal_xy(self, chosen: Mask) -> Points:
        """Return where some of the patches are seen, ideal px."""
        return mapped(self.H_before, self.patches.centres[chosen] - self.displacements[chosen])


@dataclass(frozen=True, slots=True)
class AlignmentOptions:
    """How hard to look.

    Attributes
    ----------
    window_px : side of a patch, px of the picture
    most, fewest : number of patches
    steps : most rounds of alignment
    enough_px : a round that moves no patch farther is the last one, px of the picture; less where it is blurred
    """

    window_px: int
    most: int
    fewest: int
    steps: int
    enough_px: float


def follow_patches(
    pictures: FrameImage, halvings: int, target: Reference, H: Matrix3, camera: Camera | None, effort: AlignmentOptions
) -> Followed:
    """Find a target's patches in a frame's picture.

    Parameters
    ----------
    pictures, halvings : the frame's picture, halved so many times
    target : the target
    H : H_image_template in ideal px, right to some px of that picture
    camera : intrinsics when the lens distorts; else None
    effort : how hard to look

    Raises
    ------
    NoConsensus
        If too few patches are in view, are found or agree.
    """
    reduced = Reduction(0.5**halvings)
    bank = fitting_bank(target, pictures.is_linear, H, reduced.scale, effort.window_px)
    picture_from_bank = reduced.matrix @ H @ bank.template_from_bank
    shape = (pictures.shape[0] >> halvings, pictures.shape[1] >> halvings)
    seen_at = in_view(bank.patches, picture_from_bank, shape, reduced, camera, effort.window_px, effort.most)
    chosen = seen_at.chosen
    if len(chosen) < effort.fewest:
        raise NoConsensus(f"patches: {len(chosen)} in view; need {effort.fewest}")
    patches = bank.patches.select(chosen)
    centres = patches.centres
    motions = patches.motions(affine=len(chosen) < _ENOUGH_FOR_PROJECTIVE)
    sheet = None
    if halvings == 0:
        sheet = sheet_of(patches, seen_at.xy, picture_from_bank, shape, effort.window_px, bent=camera is not None)
    picture = pictures.halved(halvings) if sheet is None else pictures.cut(sheet)
    farthest = _FARTHEST_SHARE * effort.window_px
    motion: Motion | None = None
    response = BlurGain()
    measured = np.zeros((0, 2))
    # The first rounds are a scout's: some patches tell where the others are.
    count = _SCOUTS if len(chosen) > 2 * _SCOUTS else len(chosen)
    for _ in range(effort.steps):
        lens = None if camera is None else reduced.bend(camera, picture_from_bank, centres[:count])
        seen = patches.displacements(patches.sampled(picture, picture_from_bank, lens, sheet, count))
        usable = (seen.similarity > _MIN_SIMILARITY) & (np.abs(seen.xy).max(axis=1) < farthest)
        if motion is not None:
            both = usable[: len(motion.agreeing)] & motion.agreeing
            applied = motions.displacements(motion, len(both))[both]
            response.learn(applied, (measured - seen.xy[: len(both)])[both])
        measured = seen.xy
        displacements = response.corrected(measured)
        # From a poor start few look alike, near the middle; they bring the others near.
        if np.count_nonzero(usable) < _FEWEST_AT_FIRST:
            raise NoConsensus(f"patches: {np.count_nonzero(usable)} of {count} look alike; need {_FEWEST_AT_FIRST}")
        motion = motions.fit(displacements, usable, before=motion)
        # The picture at W(c - d) shows c: W is followed by the inverse of the motion by d.
        before = picture_from_bank
        picture_from_bank = before @ motions.inverse(motion.parameters)
        if count < len(chosen):
            if motion.largest_px < _SCOUTED_PX:
                count = len(chosen)
        elif motion.largest_px < effort.enough_px * (1.0 if _is_sharp(seen.similarity) else _BLURRED_SHARE):
            break
    if motion is None or len(motion.agreeing) < len(chosen):
        raise NoConsensus(f"patches: they still move after {effort.steps} steps; need a better start")
    agreeing = int(np.count_nonzero(motion.agreeing))
    if agreeing < effort.fewest:
        raise NoConsensus(f"patches: {agreeing} of {len(chosen)} agree; need {effort.fewest}")
    H = reduced.inverse @ picture_from_bank @ bank.bank_from_template
    settled = motion.largest_px < max(_SETTLED_PX, effort.enough_px)
    return Followed(
        H,
        len(chosen),
        agreeing,
        bank,
        patches,
        displacements,
        usable,
        motion,
        reduced.inverse @ before,
        settled,
        response.weakest,
    )


def _is_sharp(similarity: Floats) -> bool:
    # np.median takes ten times as long.
    middle = len(similarity) // 2
    return float(np.partition(similarity, middle)[middle]) > _SHARP_SIMILARITY
