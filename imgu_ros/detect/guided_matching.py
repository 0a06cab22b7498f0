# SPDX-License-Identifier: Apache-2.0
"""More matches for a target that was found: sought again where its homography predicts them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.features import Features
from imgu_ros.errors import EstimationError
from imgu_ros.pose.planar_pose import Located, require_plausible
from imgu_ros.reference.features import TargetFeatures
from imgu_ros.reference.reference import Reference
from imgu_ros.result import ReferenceMatches
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.matching.guided import guided_homography
from imgu_ros.vision.matching.matches import Matches

#: Ratio of descriptor distances: with few rivals near a predicted place it may be looser than among all. Measured:
#: benchmarks/thresholds.py, study detection.
_RATIO = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Guided:
    """Where a target is, and the matches that say so.

    Attributes
    ----------
    matches : tentative ones, those that agree with the homography are its inliers
    located : from the inliers
    """

    matches: ReferenceMatches
    located: Located


def guided(
    target: Reference,
    known: TargetFeatures,
    features: Features,
    found: Guided,
    lens: Camera | None,
    parameters: Parameters,
) -> Guided:
    """Match again, guided by the homography of `found`, to convergence; `found` itself when that brings no more."""
    p = parameters.homography
    described = features.described
    xy, usable = described.keypoints.xy, np.arange(len(described.keypoints))
    if lens is not None:
        xy, inside = lens.ideal_pixels(xy)
        usable = np.flatnonzero(inside)
    try:
        more = guided_homography(
            known.described.descriptors,
            described.descriptors[usable],
            known.described.keypoints.xy,
            xy[usable],
            found.located.homography.H,
            threshold_px=p.threshold_px * features.unit_px,
            metric=known.gallery.metric,
            ratio=max(_RATIO, parameters.matching.ratio),
            min_inliers=max(p.min_inliers, int(found.matches.inliers.sum())),
            error=p.error,
            refine=None if p.refine == "none" else p.refine,
        )
        require_plausible(target.plane, more.homography)
    except EstimationError:
        return found
    inliers = more.homography.inliers
    matches = Matches(more.matches.index_src, usable[more.matches.index_dst], more.matches.distance)
    tentative = ReferenceMatches(
        matches, known.described.keypoints.xy[matches.index_src], described.keypoints.xy[matches.index_dst], inliers
    )
    located = Located(tentative.template_xy[inliers], tentative.image_xy[inliers], more.homography)
    return Guided(tentative, located)
