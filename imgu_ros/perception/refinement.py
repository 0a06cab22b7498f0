"""Refinement: the target, drawn as the estimate says, is aligned with the full-resolution frame patch by patch."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.params import RefinementParameters
from imgu_ros.perception.following import Followed, follow_by_patches, follow_in_view
from imgu_ros.perception.targets import Target
from imgu_ros.types import Floats, Image, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.estimation.covariance import window_correlation
from imgu_ros.vision.estimation.ransac import ransac
from imgu_ros.vision.projective.estimate import fit_homography
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.refine import HomographyError
from imgu_ros.vision.projective.trimming import trimmed_homography

#: Image pyramid levels that bridge the error of a detection.
DETECTION_LEVELS = 2
_CONSENSUS_PX = 1.5
#: Of the points sought, the share that must agree after the first alignment.
_MIN_SHARE = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Points of a target found in a frame by alignment.

    Attributes
    ----------
    template_xy : (N, 2) template px
    image_xy : (N, 2) raw px
    homography : H_image_template in ideal px, of these points; every one is an inlier
    correlation : (N, N) of the errors in image_xy: patches that share pixels share their errors
    sought : patches that were looked for
    """

    template_xy: Points
    image_xy: Points
    homography: HomographyEstimate
    correlation: Floats
    sought: int


def refine_by_alignment(
    grey: Image,
    target: Target,
    H: Matrix3,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_points: int,
    rng: np.random.Generator,
    first_levels: int = DETECTION_LEVELS,
) -> Alignment:
    """Align a target with a frame, starting from a homography that is right to a few pixels.

    Parameters
    ----------
    grey : (H, W) uint8, the frame at full resolution
    target : the target
    H : H_image_template in ideal px (raw px without a distorted camera)
    camera : intrinsics when the lens distorts; else None
    parameters : number and size of the patches
    min_points : fewest patches that must agree
    rng : source of the draws of the robust fit
    first_levels : image pyramid levels of the first alignment, 0 to 4; each doubles the error that it bridges

    Raises
    ------
    NoConsensus, TooFewPoints, DegenerateConfiguration
        If the patches do not agree on a homography.
    """
    window_px = parameters.window_px
    # The first alignment only has to bring the second one near: it looks at a reduced picture.
    coarse = follow_in_view(grey, target, H, camera, window_px, min_points, first_levels)
    if len(coarse.template_xy) < min_points:
        raise NoConsensus(f"patches: {len(coarse.template_xy)} followed; need {min_points}")
    model = HomographyModel(coarse.template_xy, coarse.ideal_xy)
    consensus = ransac(
        model,
        _CONSENSUS_PX,
        rng,
        confidence=0.999,
        max_iterations=256,
        min_inliers=max(min_points, math.ceil(_MIN_SHARE * coarse.sought)),
        unit=" px",
    )
    H = model.denormalised(consensus.hypothesis)
    # Drawn once more where it truly is, no patch is turned or stretched against the frame any longer.
    fine = follow_by_patches(grey, target, H, camera, window_px, parameters.max_points, min_points)
    return _fitted(fine, H, min_points, window_px)


def _fitted(followed: Followed, H: Matrix3, min_points: int, window_px: int) -> Alignment:
    """Fit by least squares, leaving out what is improbably far off at the fit's own robust scale."""
    trimmed = trimmed_homography(followed.template_xy, followed.ideal_xy, H, _CONSENSUS_PX, min_points)
    kept = trimmed.inliers
    template_xy, image_xy, ideal = followed.template_xy[kept], followed.image_xy[kept], followed.ideal_xy[kept]
    correlation = window_correlation(image_xy, window_px)
    fit = fit_homography(template_xy, ideal, error=HomographyError.TRANSFER, start=trimmed.H, correlation=correlation)
    return Alignment(template_xy, image_xy, fit, correlation, followed.sought)
