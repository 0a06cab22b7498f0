"""Refinement: the target, warped as the estimate says, is aligned with the full-resolution frame patch by patch."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.params import RefinementParameters
from imgu_ros.perception.targets import AlignmentLevel, Target
from imgu_ros.types import Floats, Image, Mask, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.estimation.covariance import window_correlation
from imgu_ros.vision.estimation.ransac import ransac
from imgu_ros.vision.keypoints.spreading import spread
from imgu_ros.vision.projective.dlt import homography_dlt
from imgu_ros.vision.projective.estimate import fit_homography
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.refine import HomographyError
from imgu_ros.vision.projective.transform import local_jacobian, transform

#: Image pyramid levels that bridge the error of a detection.
DETECTION_LEVELS = 2
_LK_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.003)
_MIN_EIGENVALUE = 1e-4
_CONSENSUS_PX = 1.5
#: Of the patches sought, the share that must agree after the first alignment.
_MIN_SHARE = 0.3
#: Room around the patches, for their windows and for the first alignment's pyramid.
_MARGIN_PX = 32
#: A view larger than this square is reduced for the first alignment.
_COARSE_SIDE_PX = 400
#: Brightness is measured on every third pixel of every third row.
_SAMPLED = 3
_TRIMMINGS = 2
_OUTLIER_SIGMAS = 3.6
_RAYLEIGH_MEDIAN = 1.1774  # in sigmas of one coordinate
_FLOOR_PX = 0.02


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
    # The first alignment only has to bring the second one near: a large view is looked at in a reduced picture.
    coarse = _follow(grey, target, H, camera, parameters, min_points, first_levels, _COARSE_SIDE_PX)
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
    fine = _follow(grey, target, H, camera, parameters, min_points, 0, None)
    return _trimmed(fine, H, min_points, parameters.window_px)


@dataclass(frozen=True, slots=True, eq=False)
class _Followed:
    """Points found by Lucas-Kanade: template px, raw px, ideal px, each (N, 2); `sought` is how many were tried."""

    template_xy: Points
    image_xy: Points
    ideal_xy: Points
    sought: int


def _follow(
    grey: Image,
    target: Target,
    H: Matrix3,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_points: int,
    lk_levels: int,
    side_px: int | None,
) -> _Followed:
    """Draw the target where H says, and find its patches in the frame near there (Bouguet 2001).

    The part of the frame in question is halved until it is about `side_px` square; None: full resolution.
    """
    step = _reduction(target, H, grey.shape, side_px)
    octave = _fitting_level(target, H, step)
    margin = step * (parameters.window_px // 2 + 1)
    template_xy, predicted = _visible(octave.corners, H, camera, grey.shape, margin, parameters.max_points)
    if len(template_xy) < min_points:
        raise NoConsensus(f"patches: {len(template_xy)} in view; need {min_points}")
    view = _cut_out(grey, predicted, step)

    # Through a lens that bends, the nearest homography draws patches well enough.
    H_raw = H if camera is None else homography_dlt(template_xy, predicted)
    drawn_at = view.from_raw(transform(H_raw, template_xy))
    start_at = drawn_at.astype(np.float32)
    found_at, status, _ = cv2.calcOpticalFlowPyrLK(
        _drawn(target, octave, H_raw, view),
        view.image,
        start_at,
        view.from_raw(predicted).astype(np.float32),
        winSize=(parameters.window_px, parameters.window_px),
        maxLevel=lk_levels,
        criteria=_LK_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=_MIN_EIGENVALUE,
    )
    # Rounding the starting points to float32 moved them; what was found moves back by as much.
    image_xy = view.to_raw(found_at.astype(np.float64) + (drawn_at - start_at))
    good = (status.ravel() == 1) & np.isfinite(image_xy).all(axis=1)
    template_xy, image_xy, sought = template_xy[good], image_xy[good], len(template_xy)
    if camera is None:
        return _Followed(template_xy, image_xy, image_xy, sought)
    ideal, valid = camera.ideal_pixels(image_xy)
    return _Followed(template_xy[valid], image_xy[valid], ideal[valid], sought)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A part of the frame, reduced by `step`; `offset` is its top-left raw pixel."""

    image: Image
    offset: Points
    step: int

    def from_raw(self, xy: Points) -> Points:
        return (xy - self.offset + 0.5) / self.step - 0.5

    def to_raw(self, xy: Points) -> Points:
        return (xy + 0.5) * self.step - 0.5 + self.offset


def _cut_out(grey: Image, predicted: Points, step: int) -> _View:
    """Return the part of the frame about the predicted points, with room for windows and image pyramid."""
    height, width = grey.shape
    margin = _MARGIN_PX * step
    left, top = np.maximum(np.floor(predicted.min(axis=0)).astype(int) - margin, 0)
    right, bottom = np.minimum(np.ceil(predicted.max(axis=0)).astype(int) + 1 + margin, (width, height))
    # Whole cells only: a reduced pixel is the mean of step x step raw ones.
    right, bottom = right - (right - left) % step, bottom - (bottom - top) % step
    image = grey[top:bottom, left:right]
    if step > 1:
        size = ((right - left) // step, (bottom - top) // step)
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return _View(image, np.array([left, top], np.float64), step)


def _reduction(target: Target, H: Matrix3, shape: tuple[int, ...], side_px: int | None) -> int:
    """Return by how much to reduce the view so that its area is at most about side_px^2: 1, 2 or 4."""
    if side_px is None:
        return 1
    outline = transform(H, target.outline_template)
    width, height = np.ptp(np.clip(outline, 0, (shape[1], shape[0])), axis=0)
    side = math.sqrt(float(width * height))
    return 1 if side <= side_px else 2 if side <= 2 * side_px else 4


def _trimmed(followed: _Followed, H: Matrix3, min_points: int, window_px: int) -> Alignment:
    """Fit by least squares, leaving out what is improbably far off at the fit's own robust scale."""
    template_xy, ideal = followed.template_xy, followed.ideal_xy
    kept = np.hypot(*(transform(H, template_xy) - ideal).T) <= _CONSENSUS_PX
    for _ in range(_TRIMMINGS):
        _require(kept, min_points)
        H = fit_homography(template_xy[kept], ideal[kept], error=HomographyError.TRANSFER, start=H).H
        distance = np.hypot(*(transform(H, template_xy) - ideal).T)
        sigma = float(np.median(distance[kept])) / _RAYLEIGH_MEDIAN
        kept = distance <= max(_OUTLIER_SIGMAS * sigma, _FLOOR_PX)
    _require(kept, min_points)
    template_xy, image_xy, ideal = template_xy[kept], followed.image_xy[kept], ideal[kept]
    correlation = window_correlation(image_xy, window_px)
    fit = fit_homography(template_xy, ideal, error=HomographyError.TRANSFER, start=H, correlation=correlation)
    return Alignment(template_xy, image_xy, fit, correlation, followed.sought)


def _require(kept: Mask, min_points: int) -> None:
    if np.count_nonzero(kept) < min_points:
        raise NoConsensus(f"patches: {np.count_nonzero(kept)} agree; need {min_points}")


def _fitting_level(target: Target, H: Matrix3, step: int) -> AlignmentLevel:
    """Return the octave whose pixels come out nearest in size to the view's, each `step` of the frame's."""
    width, height = target.size
    centre = np.array([[(width - 1) / 2, (height - 1) / 2]])
    pixels = math.sqrt(abs(float(np.linalg.det(local_jacobian(H, centre)[0]))))
    pixels /= step  # view px in a template px
    steps = np.array([a.level.scale for a in target.alignment if len(a.corners)] or [1.0])
    return target.alignment[int(np.argmin(np.abs(np.log(steps * max(pixels, 1e-9)))))]


def _visible(
    corners: Points, H: Matrix3, camera: Camera | None, shape: tuple[int, ...], margin: int, most: int
) -> tuple[Points, Points]:
    """Return the corners in view and where they are expected, raw px; at most `most`, spread evenly."""
    mapped = corners @ H[:, :2].T + H[:, 2]
    ahead = mapped[:, 2] > 0
    corners, mapped = corners[ahead], mapped[ahead]
    xy = mapped[:, :2] / mapped[:, 2:]
    if camera is not None and len(xy):
        xy = camera.raw_pixels(xy)
    inside = (xy >= margin).all(axis=1) & (xy < np.array((shape[1], shape[0])) - margin).all(axis=1)
    corners, xy = corners[inside], xy[inside]
    if len(xy) > most:
        low = xy.min(axis=0)
        extent = np.ceil(xy.max(axis=0) - low).astype(int) + 1
        rank = -np.arange(len(xy), dtype=np.float64)
        chosen = spread(xy - low, rank, (int(extent[0]), int(extent[1])), most)
        corners, xy = corners[chosen], xy[chosen]
    return corners, xy


def _drawn(target: Target, octave: AlignmentLevel, H_raw: Matrix3, view: _View) -> Image:
    """Draw the target as it should look in the view, brightness and contrast matched to it."""
    sx, sy = octave.level.step
    template_from_level = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])
    s = 1 / view.step
    shift = (0.5 - view.offset) * s - 0.5
    view_from_raw = np.array([[s, 0, shift[0]], [0, s, shift[1]], [0, 0, 1]])
    size = (view.image.shape[1], view.image.shape[0])
    M = view_from_raw @ H_raw @ template_from_level
    # Its rim is continued outwards: a black surround would pull at the outermost patches, which weigh most.
    drawn = cv2.warpPerspective(octave.level.image, M, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    covered = np.zeros(view.image.shape, np.uint8)
    outline = view.from_raw(transform(H_raw, target.outline_template))
    cv2.fillConvexPoly(covered, np.clip(np.rint(outline), -30000, 30000).astype(np.int32), 255)
    n = _SAMPLED
    mean_drawn, deviation_drawn = _mean_and_deviation(drawn[::n, ::n], covered[::n, ::n])
    mean_view, deviation_view = _mean_and_deviation(view.image[::n, ::n], covered[::n, ::n])
    if deviation_drawn < 1.0 or deviation_view < 1.0:
        return drawn
    gain = deviation_view / deviation_drawn
    return cv2.addWeighted(drawn, gain, drawn, 0.0, mean_view - gain * mean_drawn)


def _mean_and_deviation(image: Image, mask: Image) -> tuple[float, float]:
    mean, deviation = cv2.meanStdDev(np.ascontiguousarray(image), mask=np.ascontiguousarray(mask))
    return float(mean[0, 0]), float(deviation[0, 0])
