"""Targets: the known flat pictures, and what the chain prepares of them once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import ParameterError, ShapeError
from imgu_ros.parameter_checks import why_not
from imgu_ros.params import Parameters
from imgu_ros.perception.preprocessing import for_targets, preprocessed, with_edges
from imgu_ros.types import Image, Points
from imgu_ros.vision.descriptors.describe import Descriptions, describe
from imgu_ros.vision.keypoints.detect import detect
from imgu_ros.vision.keypoints.spreading import spread
from imgu_ros.vision.matching.gallery import Gallery, prepare_gallery
from imgu_ros.vision.matching.metrics import metric_for
from imgu_ros.vision.scale_space.pyramid import Level, PyramidKind, band_passed, build_pyramid

#: A target may fill this many times the frame's longer side.
_LARGEST_VIEW = 2
#: Keypoints of a target for each of the frame's: it is described at every scale.
_RICHNESS = 3
_CORNER_QUALITY = 0.005
_CORNER_DISTANCE_PX = 6
_FIRST_SPREAD = 40


@dataclass(frozen=True, slots=True, eq=False)
class TargetImage:
    """A known flat picture.

    Attributes
    ----------
    name : in topics, files and frames
    pixels : (H, W) or (H, W, 3) RGB, uint8
    width_m : printed width, outer edge to outer edge; 0: unknown
    """

    name: str
    pixels: Image
    width_m: float


@dataclass(frozen=True, slots=True, eq=False)
class AlignmentLevel:
    """A target at one scale, for alignment by patches.

    Attributes
    ----------
    level : the picture, uint8, and its scale
    corners : (N, 2) px of the full-resolution target, the points worth following, best spread first
    """

    level: Level
    corners: Points


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A target, ready for the chain.

    Attributes
    ----------
    name, width_m : as in `TargetImage`
    grey : (H, W) uint8
    described : keypoints and descriptors at every scale
    gallery : the descriptors, for a frame's to be matched to
    alignment : octaves from fine to coarse
    """

    name: str
    width_m: float
    grey: Image
    described: Descriptions
    gallery: Gallery
    alignment: tuple[AlignmentLevel, ...]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the full-resolution picture, px."""
        return self.grey.shape[1], self.grey.shape[0]

    @property
    def outline_template(self) -> Points:
        """The outer corners, (4, 2) template px: top left, top right, bottom right, bottom left."""
        width, height = self.size
        return np.array(
            [[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]], np.float64
        )

    def to_metres(self, template_xy: Points) -> Points:
        """Map template px (N, 2) to the target's plane, metres, origin at the centre, y up."""
        width, height = self.size
        scale = self.width_m / width
        return (template_xy - ((width - 1) / 2, (height - 1) / 2)) * (scale, -scale)


def prepare_targets(images: Sequence[TargetImage], parameters: Parameters) -> tuple[Target, ...]:
    """Describe every target at every scale.

    Raises
    ------
    ParameterError
        If methods make no sense together.
    ShapeError
        If a picture is not (H, W) or (H, W, 3) uint8, or has nothing that a keypoint could be found on.
    """
    reason = why_not(parameters)
    if reason:
        raise ParameterError(reason)
    return tuple(_prepared(image, parameters) for image in images)


def _prepared(image: TargetImage, parameters: Parameters) -> Target:
    pixels = image.pixels
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] != 3):
        raise ShapeError(f"target {image.name}: shape {pixels.shape} {pixels.dtype}; need (H, W) or (H, W, 3) uint8")
    metric = metric_for(parameters.descriptor.kind, parameters.matching.metric)
    grey = np.ascontiguousarray(pixels) if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    pyramid = build_pyramid(
        preprocessed(grey, for_targets(parameters.preprocess), parameters.pyramid.kernel),
        PyramidKind.FINE,
        levels=32,
        scales_per_octave=parameters.pyramid.scales_per_octave,
        max_side_px=_LARGEST_VIEW * parameters.pyramid.max_side_px,
        min_side_px=48,
        kernel=parameters.pyramid.kernel,
    )
    if parameters.pyramid.kind == PyramidKind.LAPLACIAN:
        pyramid = band_passed(pyramid)
    pyramid = with_edges(pyramid, parameters.preprocess)
    p = parameters.keypoints
    keypoints = detect(pyramid, p.detector, _RICHNESS * p.max_count, even_scales=True, fast_arc=p.fast_arc)
    described = describe(pyramid, keypoints, parameters.descriptor.kind)
    if len(described.keypoints) < parameters.homography.min_inliers:
        raise ShapeError(
            f"target {image.name}: {len(described.keypoints)} keypoints; need at least "
            f"{parameters.homography.min_inliers}: a picture with texture, and not too small"
        )
    octaves = build_pyramid(grey, PyramidKind.COARSE, levels=8, min_side_px=24, kernel=parameters.pyramid.kernel)
    count = parameters.refinement.max_points
    return Target(
        image.name,
        image.width_m,
        grey,
        described,
        prepare_gallery(described.descriptors, metric, described.keypoints.xy),
        tuple(_alignment(level, count) for level in octaves.levels),
    )


def _alignment(level: Level, count: int) -> AlignmentLevel:
    corners = cv2.goodFeaturesToTrack(level.image, 6 * count, _CORNER_QUALITY, _CORNER_DISTANCE_PX)
    xy = np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2).astype(np.float64)
    # goodFeaturesToTrack sorts by strength but does not return it: the rank serves as well.
    rank = -np.arange(len(xy), dtype=np.float64)
    size = (level.image.shape[1], level.image.shape[0])
    # However many of them are taken, from the first, lie spread over the picture.
    counts = [3 * count]
    while counts[0] > _FIRST_SPREAD:
        counts.insert(0, counts[0] // 2)
    order = np.concatenate([spread(xy, rank, size, n) for n in counts])
    _, first = np.unique(order, return_index=True)
    return AlignmentLevel(level, level.to_full(xy[order[np.sort(first)]]))
