# SPDX-License-Identifier: Apache-2.0
"""Looking for one target in one frame: its keypoints are matched, and what agrees is located."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import partial

import numpy as np

from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.features import Features
from imgu_ros.detect.guided_matching import guided
from imgu_ros.detect.robust_fit import Sight, located
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import bending
from imgu_ros.reference.features import TargetFeatures
from imgu_ros.reference.planar import PlanarReference
from imgu_ros.result import ReferenceMatches, ReferenceResult, Stage, StageClock, Status
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.matching.nearest import match_to_gallery


class SearchPass(StrEnum):
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
    pictures: FrameImage
    features: Features
    look: SearchPass = SearchPass.FIRST

    def features_of(self, target: PlanarReference) -> TargetFeatures:
        """Return what this frame's descriptors are to be matched to."""
        return _FEATURES[self.look](target)


def search(
    target: PlanarReference,
    searched: Searched,
    parameters: Parameters,
    rng: np.random.Generator,
    clock: StageClock,
) -> ReferenceResult:
    """Look for a target in a frame; what fails becomes a status with its reason."""
    with clock.measures(Stage.MATCH):
        known = searched.features_of(target)
        matches = tentative_matches(known, searched.features.described, parameters)
    missing = ReferenceResult(target.name, target.number, Status.LOST, matches=matches)
    frame = searched.frame
    sight = Sight(frame, searched.pictures, searched.features.unit_px)
    guide = None
    if parameters.matching.guided:
        guide = partial(guided, target, known, searched.features, lens=bending(frame.camera), parameters=parameters)
    return located(missing, target, sight, parameters, rng, clock, guide)


_FEATURES: dict[SearchPass, Callable[[PlanarReference], TargetFeatures]] = {
    SearchPass.FIRST: lambda target: target.features,
    SearchPass.CLOSE: lambda target: target.close.features(),
    SearchPass.THOROUGH: lambda target: target.thorough.features(),
}


def tentative_matches(known: TargetFeatures, described: Descriptions, parameters: Parameters) -> ReferenceMatches:
    """Match the descriptors of a frame to those of a target, best first."""
    p = parameters.matching
    found = match_to_gallery(described.descriptors, known.gallery, p.ratio, p.mutual)
    # Sought from the frame to the target, told from the target to the frame.
    matches = Matches(found.index_dst, found.index_src, found.distance)
    return ReferenceMatches(
        matches,
        known.described.keypoints.xy[matches.index_src],
        described.keypoints.xy[matches.index_dst],
        np.zeros(len(matches), bool),
    )
