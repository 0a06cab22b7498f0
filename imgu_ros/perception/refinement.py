"""Refinement: the target, warped as the estimate says, is aligned with the full-resolution frame patch by patch."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.params import RefinementParameters
from imgu_ros.perception.targets import AlignmentLevel, Target
from imgu_ros.types import Image, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.keypoints.spreading import spread
from imgu_ros.vision.projective.dlt import homography_dlt
from imgu_ros.vision.projective.estimate import estimate_homography, fit_homography
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.refine import HomographyError
from imgu_ros.vision.projective.transform import local_jacobian, transform

#: Image pyramid levels of the first and of the second alignment: the first must bridge the detection's error.
_LK_LEVELS = (2, 0)
_LK_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.003)
_MIN_EIGENVALUE = 1e-4
_CONSENSUS_PX = 1.5
_OUTLIER_SIGMAS = 3.0
_MIN_SHARE = 0.3
_MARGIN_PX = 32


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Points of a target found in a frame by alignment.

    Attributes
    ----------
    template_xy : (N, 2) template px
    image_xy : (N, 2) raw px
    homography : H_image_template in ideal px, of these points; every one is an inlier
    """

    template_xy: Points
    image_xy: Points
    homography: HomographyEstimate


def refine_by_alignment(
    grey: Image,
    target: Target,
    H: Matrix3,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_points: int,
    rng: np.random.Generator,
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

    Raises
    ------
    NoConsensus, TooFewPoints, DegenerateConfiguration
        If the patches do not agree on a homography.
    """
    alignment: Alignment | None = None
    for lk_levels in _LK_LEVELS:
        alignment = _aligned(grey, target, H, camera, parameters, min_points, rng, lk_levels)
        H = alignment.homography.H
    assert alignment is not None
    return alignment


def _aligned(
    grey: Image,
    target: Target,
    H: Matrix3,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_points: int,
    rng: np.random.Generator,
    lk_levels: int,
) -> Alignment:
    height, width = grey.shape
    octave = _fitting_level(target, H)
    template_xy, predicted = _visible(octave.corners, H, camera, (width, height), parameters)
    if len(template_xy) < min_points:
        raise NoConsensus(f"patches: {len(template_xy)} in view; need {min_points}")
    left, top = np.maximum(np.floor(predicted.min(axis=0)).astype(int) - _MARGIN_PX, 0)
    right, bottom = np.minimum(np.ceil(predicted.max(axis=0)).astype(int) + 1 + _MARGIN_PX, (width, height))
    offset = np.array([left, top], np.float64)
    view = grey[top:bottom, left:right]

    H_raw = H if camera is None else _raw_homography(template_xy, predicted)
    warped = _warped(octave, H_raw, offset, view)
    drawn_at = transform(H_raw, template_xy) - offset
    found_at, status, _ = cv2.calcOpticalFlowPyrLK(
        warped, view, drawn_at.astype(np.float32), (predicted - offset).astype(np.float32),
        winSize=(parameters.window_px, parameters.window_px), maxLevel=lk_levels, criteria=_LK_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=_MIN_EIGENVALUE,
    )
    # The rounding of the drawn points to float32 is undone: it is not part of the displacement.
    displaced = found_at.astype(np.float64) + (drawn_at - drawn_at.astype(np.float32))
    good = status.ravel() == 1
    image_xy = displaced + offset
    # A patch drawn at H_raw that is seen at predicted + d is the template point seen at that place.
    template_xy, image_xy = template_xy[good], image_xy[good]
    ideal = image_xy
    if camera is not None:
        ideal, valid = camera.ideal_pixels(image_xy)
        template_xy, image_xy, ideal = template_xy[valid], image_xy[valid], ideal[valid]
    consensus = estimate_homography(
        template_xy, ideal, rng,
        threshold_px=_CONSENSUS_PX, confidence=0.999, max_iterations=256, refine=None, error=HomographyError.TRANSFER,
        min_inliers=max(min_points, math.ceil(_MIN_SHARE * len(predicted))),
    )
    return _trimmed(template_xy, image_xy, ideal, consensus, min_points)


def _trimmed(
    template_xy: Points, image_xy: Points, ideal: Points, consensus: HomographyEstimate, min_points: int
) -> Alignment:
    """Fit by least squares, leaving out what is improbably far off under the fit's own robust scale."""
    kept = consensus.inliers
    H = consensus.H
    for _ in range(3):
        fit = fit_homography(template_xy[kept], ideal[kept], error=HomographyError.TRANSFER, start=H)
        H = fit.H
        distance = np.hypot(*(transform(H, template_xy) - ideal).T)
        # Median of a Rayleigh distribution: 1.1774 sigma.
        sigma = float(np.median(distance[kept])) / 1.1774
        now = distance <= max(_OUTLIER_SIGMAS * 1.2 * sigma, 0.02)
        if np.count_nonzero(now) < min_points:
            raise NoConsensus(f"patches: {np.count_nonzero(now)} agree; need {min_points}")
        if np.array_equal(now, kept):
            break
        kept = now
    fit = fit_homography(template_xy[kept], ideal[kept], error=HomographyError.TRANSFER, start=H)
    return Alignment(template_xy[kept], image_xy[kept], fit)


def _fitting_level(target: Target, H: Matrix3) -> AlignmentLevel:
    """Return the octave whose pixels come out nearest to the frame's pixels in size."""
    width, height = target.size
    centre = np.array([[(width - 1) / 2, (height - 1) / 2]])
    pixels = math.sqrt(abs(float(np.linalg.det(local_jacobian(H, centre)[0]))))  # frame px in a template px
    steps = np.array([a.level.scale for a in target.alignment if len(a.corners)] or [1.0])
    return target.alignment[int(np.argmin(np.abs(np.log(steps * max(pixels, 1e-9)))))]


def _visible(
    corners: Points, H: Matrix3, camera: Camera | None, size: tuple[int, int], parameters: RefinementParameters
) -> tuple[Points, Points]:
    """Return the corners in view and where they are expected, raw px; at most as many as wanted, spread evenly."""
    mapped = corners @ H[:, :2].T + H[:, 2]
    ahead = mapped[:, 2] > 0
    corners, mapped = corners[ahead], mapped[ahead]
    xy = mapped[:, :2] / mapped[:, 2:]
    if camera is not None and len(xy):
        xy = camera.raw_pixels(xy)
    border = parameters.window_px // 2 + 1
    inside = (xy >= border).all(axis=1) & (xy < np.array(size) - border).all(axis=1)
    corners, xy = corners[inside], xy[inside]
    if len(xy) > parameters.max_points:
        low = xy.min(axis=0)
        extent = np.ceil(xy.max(axis=0) - low).astype(int) + 1
        chosen = spread(
            xy - low, -np.arange(len(xy), dtype=np.float64), (int(extent[0]), int(extent[1])), parameters.max_points
        )
        corners, xy = corners[chosen], xy[chosen]
    return corners, xy


def _raw_homography(template_xy: Points, predicted: Points) -> Matrix3:
    """Return the homography nearest to the distorted mapping: good enough to draw patches with."""
    return homography_dlt(template_xy, predicted)


def _warped(octave: AlignmentLevel, H_raw: Matrix3, offset: Points, view: Image) -> Image:
    """Draw the target as it should look in the view, brightness and contrast matched to it."""
    sx, sy = octave.level.step
    template_from_level = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])
    view_from_image = np.array([[1, 0, -offset[0]], [0, 1, -offset[1]], [0, 0, 1]])
    size = (view.shape[1], view.shape[0])
    M = view_from_image @ H_raw @ template_from_level
    warped = cv2.warpPerspective(octave.level.image, M, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    drawn = cv2.warpPerspective(np.full_like(octave.level.image, 255), M, size, flags=cv2.INTER_NEAREST)
    mean_w, deviation_w = (float(v[0, 0]) for v in cv2.meanStdDev(warped, mask=drawn))
    mean_v, deviation_v = (float(v[0, 0]) for v in cv2.meanStdDev(view, mask=drawn))
    if deviation_w < 1.0 or deviation_v < 1.0:
        return warped
    gain = deviation_v / deviation_w
    return cv2.addWeighted(warped, gain, warped, 0.0, mean_v - gain * mean_w)
