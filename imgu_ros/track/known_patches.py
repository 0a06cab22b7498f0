# SPDX-License-Identifier: Apache-2.0
"""Alignment of a tracked reference by the patches of the frame before: they need neither be chosen nor tried again."""

from __future__ import annotations

import numpy as np

from imgu_ros.config.parameters import RefinementParameters
from imgu_ros.errors import NoConsensus
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.reference.reference import Reference
from imgu_ros.result import SampledPatches
from imgu_ros.track.patch_alignment import AlignmentOptions, LevelAlignment
from imgu_ros.track.sample_refinement import AlignedPatches, FrameHints, PatchAlignment, refined_on_samples
from imgu_ros.types import Matrix3
from imgu_ros.vision.camera.intrinsics import Camera

#: They are chosen anew after so many frames: other parts of the reference may have come into view.
_FRAMES = 15
#: They are, too, when fewer than this share of them agree.
_ENOUGH = 0.9
#: They are, too, when the reference is larger or smaller by this factor: it shows other details.
_ZOOMED = 1.4
#: Largest error that the samples bridge alone, raw px.
_REACH_PX = 0.75
#: Patches of the halved frame that bridge a longer one, their iterations, and the motion below which these stop, px of
#: the level.
_COARSE_PATCHES, _COARSE_STEPS, _COARSE_ENOUGH_PX = 40, 8, 0.2
#: Share of them that must agree.
_COARSE_SHARE = 0.5


def are_known(sampled: SampledPatches) -> bool:
    """Whether patches can be used for one more frame."""
    if sampled.frames >= _FRAMES or not 1 / _ZOOMED < sampled.zoom < _ZOOMED:
        return False
    return bool(np.count_nonzero(sampled.kept) >= _ENOUGH * sampled.sought)


def align_known(
    frame: FrameImage,
    reference: Reference,
    H: Matrix3,
    camera: Camera | None,
    known: SampledPatches,
    parameters: RefinementParameters,
    min_points: int,
    reach_px: float,
    hints: FrameHints,
) -> PatchAlignment:
    """Align patches of the frame before with the raw samples.

    Parameters
    ----------
    known : the patches
    frame, reference, H, camera, parameters, min_points, reach_px, hints : as for `align_patches`

    Raises
    ------
    EstimationError
        If they do not agree on a homography.
    """
    if reach_px > _REACH_PX:
        options = AlignmentOptions(parameters.window_px, _COARSE_PATCHES, min_points, _COARSE_STEPS, _COARSE_ENOUGH_PX)
        coarse = LevelAlignment(frame, min(1, frame.most_halvings), reference, H, camera, options)
        if not coarse.converged or coarse.agreeing < _COARSE_SHARE * coarse.sought:
            raise NoConsensus(f"patches: {coarse.agreeing} of {coarse.sought} agree in the halved frame")
        H = coarse.H
    start = AlignedPatches(H, known.template_xy, 0, known.sought, known)
    return refined_on_samples(frame, reference, start, camera, min_points, hints)
