# SPDX-License-Identifier: Apache-2.0
"""The search for one planar reference in one frame: its keypoints are matched, and those that agree locate it."""

from __future__ import annotations

import math
from enum import StrEnum
from functools import partial

import numpy as np

from imgu_ros.config.components import DetectionParameters
from imgu_ros.config.parameters import MatchingParameters
from imgu_ros.detect.features import Features
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.detect.robust_fit import LocatedMatches, RobustFit
from imgu_ros.errors import EstimationError
from imgu_ros.pose.planar_pose import Located, distorting_camera, require_plausible
from imgu_ros.reference.features import TargetFeatures
from imgu_ros.reference.planar import PlanarReference
from imgu_ros.reference.reference import Reference
from imgu_ros.result import ReferenceMatches, ReferenceResult, Stage, Status
from imgu_ros.types import Indices
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.matching.guided import guided_homography
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.matching.nearest import match_to_gallery

#: Ratio of descriptor distances: with few rivals near a predicted place it may be looser than among all. Measured:
#: benchmarks/thresholds.py, study detection.
_RATIO = 0.95
#: Two matches tell of the same view of a reference when the similarities that they tell differ by at most a turn, a
#: scale, and a distance of the reference's centre, as a share of its size. Measured: benchmarks/printed_targets.py.
_SAME_TURN_RAD, _SAME_OCTAVES, _SAME_CENTRE = 0.5, 0.8, 0.6
#: Among more matches they are not looked for: bounds time and memory.
_MOST_COMPARED = 1000


class SearchPass(StrEnum):
    """How thoroughly a reference is searched."""

    FIRST = "first"  #: fast, at every scale
    CLOSE = "close"  #: fast, for a camera so near that little of the reference is in view
    THOROUGH = "thorough"  #: with more of the frame's keypoints, and oblique views of the reference

    def features_of(self, reference: PlanarReference) -> TargetFeatures:
        """Return the features of a reference that the frame's are matched to."""
        if self is SearchPass.FIRST:
            return reference.features
        return (reference.close if self is SearchPass.CLOSE else reference.thorough).features()


def search(
    reference: PlanarReference,
    search_pass: SearchPass,
    features: Features,
    context: FrameContext,
    parameters: DetectionParameters,
    rng: np.random.Generator,
) -> ReferenceResult:
    """Search a frame for a reference; a failure becomes a status with its reason.

    Parameters
    ----------
    reference : the reference
    search_pass : which of its features are matched
    features : of the frame, for this pass
    context : the frame
    parameters : those of detection, of this pass
    rng : draws minimal samples
    """
    with context.clock.measures(Stage.MATCH):
        known = search_pass.features_of(reference)
        matches = tentative_matches(known, features.described, parameters.matching)
    missing = ReferenceResult(reference.name, reference.number, Status.LOST, matches=matches)
    guide = None
    if parameters.matching.guided:
        lens = distorting_camera(context.frame.camera)
        guide = partial(guided, reference, known, features, lens=lens, parameters=parameters)
    is_thorough = search_pass is SearchPass.THOROUGH
    fit = RobustFit(context.frame, context.image, features.unit_px, parameters, context.clock, is_thorough)
    return fit.locate(missing, reference, rng, guide)


def tentative_matches(
    known: TargetFeatures, described: Descriptions, parameters: MatchingParameters
) -> ReferenceMatches:
    """Match the descriptors of a frame to those of a reference.

    Those with the most others that put the reference at about the same place come first, then those least ambiguous.
    """
    found = match_to_gallery(described.descriptors, known.gallery, parameters.ratio, parameters.mutual)
    # Matched from the frame to the reference, reported from the reference to the frame.
    matches = Matches(found.index_dst, found.index_src, found.distance)
    order = np.argsort(-_supporters(known.described.keypoints, described.keypoints, matches), kind="stable")
    matches = Matches(matches.index_src[order], matches.index_dst[order], matches.distance[order])
    return ReferenceMatches(
        matches,
        known.described.keypoints.xy[matches.index_src],
        described.keypoints.xy[matches.index_dst],
        np.zeros(len(matches), bool),
    )


def _supporters(known: Keypoints, seen: Keypoints, matches: Matches) -> Indices:
    """Return how many matches put the reference at about the same place as each does, with the same turn and scale.

    A match of oriented keypoints tells a similarity (Lowe 2004, section 7.3): where few matches are right, those are
    drawn first by it.
    """
    if not 1 < len(matches) <= _MOST_COMPARED:
        return np.zeros(len(matches), np.intp)
    src, dst = matches.index_src, matches.index_dst
    middle = known.xy.mean(axis=0)
    reach = math.sqrt(float(((known.xy - middle) ** 2).sum(axis=1).mean()))
    scale = seen.scale[dst] / known.scale[src]
    turned = scale * np.exp(1j * (seen.angle[dst] - known.angle[src]))
    x, y = (middle - known.xy[src]).T
    centre = seen.xy[dst] @ (1, 1j) + turned * (x + 1j * y)
    ratio = turned[:, None] / turned
    alike = (np.abs(np.angle(ratio)) < _SAME_TURN_RAD) & (np.abs(np.log2(np.abs(ratio))) < _SAME_OCTAVES)
    alike &= np.abs(centre[:, None] - centre) < _SAME_CENTRE * reach * np.minimum(scale[:, None], scale)
    supporters: Indices = np.count_nonzero(alike, axis=1)
    return supporters


def guided(
    reference: Reference,
    known: TargetFeatures,
    features: Features,
    found: LocatedMatches,
    lens: Camera | None,
    parameters: DetectionParameters,
) -> LocatedMatches:
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
        require_plausible(reference.plane, more.homography)
    except EstimationError:
        return found
    inliers = more.homography.inliers
    matches = Matches(more.matches.index_src, usable[more.matches.index_dst], more.matches.distance)
    tentative = ReferenceMatches(
        matches, known.described.keypoints.xy[matches.index_src], described.keypoints.xy[matches.index_dst], inliers
    )
    located = Located(tentative.template_xy[inliers], tentative.image_xy[inliers], more.homography)
    return LocatedMatches(tentative, located)
