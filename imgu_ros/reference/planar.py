# SPDX-License-Identifier: Apache-2.0
"""Targets: the known flat pictures, and what the chain prepares of them once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import cv2
import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.checks import method_conflict
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ParameterError, ShapeError
from imgu_ros.image.development import grey_of
from imgu_ros.reference.features import (
    FeaturesOnDemand,
    TargetFeatures,
    close_features,
    description_options,
    target_features,
    thorough_features,
    thorough_parameters,
)
from imgu_ros.types import Floats, Image, Matrix3, Points
from imgu_ros.vision.descriptors.extractor import make_extractor
from imgu_ros.vision.formation.transfer import linear_from_srgb, srgb_from_linear
from imgu_ros.vision.keypoints.spreading import spread
from imgu_ros.vision.matching.patch_bank import PatchBank
from imgu_ros.vision.scale_space.pyramid import Level, PyramidKind, build_pyramid

#: Weakest corner for a patch, as a share of the strongest response. Measured: benchmarks/thresholds.py, study tracking.
_CORNER_QUALITY = 0.005
#: Smallest distance of two patch centres, px of the level. Measured: benchmarks/thresholds.py, study tracking.
_CORNER_DISTANCE_PX = 6
#: The best-spread patches come first: sets of so many and more patches are each spread over the whole image.
_FIRST_SPREAD = 40


@dataclass(frozen=True, slots=True, eq=False)
class TargetImage:
    """A known flat picture.

    Attributes
    ----------
    name : in topics, files and frames
    pixels : (H, W) or (H, W, 3) RGB, uint8
    width_m : printed width, outer edge to outer edge; 0: unknown
    is_linear : whether values go with the light, as a sensor's; else they are sRGB, as those of image files
    """

    name: str
    pixels: Image
    width_m: float
    is_linear: bool = False

    def shows_the_same(self, other: TargetImage) -> bool:
        """Return whether both are the same picture, of whatever width."""
        if self.pixels is other.pixels:
            return self.is_linear == other.is_linear
        return self.is_linear == other.is_linear and bool(np.array_equal(self.pixels, other.pixels))


class AlignmentLevel:
    """A target at one scale, for alignment by patches; of a known target few octaves are ever seen.

    Parameters
    ----------
    level : the picture, uint8, and its scale
    count : patches that are used at once

    Attributes
    ----------
    level : as given
    """

    def __init__(self, level: Level, count: int) -> None:
        self.level = level
        self._count = count
        self._corners: Points | None = None
        self._patches: tuple[int, PatchBank] | None = None

    @property
    def corners(self) -> Points:
        """The points worth following, best spread first: (N, 2) px of the full-resolution target; made once."""
        if self._corners is None:
            self._corners = _corners(self.level, self._count)
        return self._corners

    def patches(self, window_px: int) -> PatchBank:
        """Return the patches about the corners, in the level's px; those of the last size are kept."""
        kept = self._patches
        if kept is None or kept[0] != window_px:
            kept = (window_px, PatchBank(self.level.image, self.level.from_full(self.corners), window_px))
            self._patches = kept
        return kept[1]


class AlignmentPyramids:
    """A target's picture at every octave, with values that go with the light, or those of sRGB; made when asked for.

    Parameters
    ----------
    image : the picture
    grey_weights : of red, green and blue; not used for a grey picture
    kernel : of the pyramid
    """

    def __init__(self, image: TargetImage, grey_weights: tuple[float, ...], kernel: str) -> None:
        self._image = image
        self._grey_weights = grey_weights
        self._kernel = kernel
        self._made: dict[bool, tuple[Level, ...]] = {}

    def levels(self, linear: bool) -> tuple[Level, ...]:
        """Return the octaves, from fine to coarse."""
        if linear not in self._made:
            pixels = self._image.pixels
            if linear != self._image.is_linear:
                pixels = linear_from_srgb(pixels) if linear else srgb_from_linear(pixels)
            grey = _grey(pixels, self._grey_weights)
            self._made[linear] = build_pyramid(
                grey, PyramidKind.COARSE, levels=8, min_side_px=24, kernel=self._kernel
            ).levels
        return self._made[linear]


class AlignmentPictures:
    """A target's picture at every octave, as frames show it, with its points worth following; made when asked for.

    Parameters
    ----------
    pyramids : the picture
    max_points : patches that are used at once
    """

    def __init__(self, pyramids: AlignmentPyramids, max_points: int) -> None:
        self._pyramids = pyramids
        self._max_points = max_points
        self._made: dict[bool, tuple[AlignmentLevel, ...]] = {}

    def octaves(self, linear: bool) -> tuple[AlignmentLevel, ...]:
        """Return the octaves, from fine to coarse, with values that go with the light, or those of sRGB."""
        if linear not in self._made:
            levels = self._pyramids.levels(linear)
            self._made[linear] = tuple(AlignmentLevel(level, self._max_points) for level in levels)
        return self._made[linear]


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A target, ready for the chain.

    Attributes
    ----------
    name, width_m : as in `TargetImage`
    image : what it was prepared from
    grey : (H, W) uint8
    front : keypoints and descriptors at every scale
    close, thorough : those for the search of a target that is near, and for a thorough search
    pictures : for alignment
    """

    name: str
    width_m: float
    image: TargetImage
    grey: Image
    front: FeaturesOnDemand
    close: FeaturesOnDemand
    thorough: FeaturesOnDemand
    pictures: AlignmentPictures

    @property
    def features(self) -> TargetFeatures:
        """Keypoints and descriptors at every scale, of a first look."""
        return self.front.features()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the full-resolution picture, px."""
        return self.grey.shape[1], self.grey.shape[0]

    @property
    def outline_template(self) -> Points:
        """The outer corners, (4, 2) template px: top left, top right, bottom right, bottom left."""
        return _outline(*self.size)

    @property
    def outline_homogeneous(self) -> Floats:
        """The outer corners, (3, 4) homogeneous template px, one a column."""
        return _outline_homogeneous(*self.size)

    @property
    def metres_from_template(self) -> Matrix3:
        """Template px to the target's plane, metres, origin at the centre, y up: (3, 3) affine."""
        return _metres_from_template(*self.size, self.width_m)

    def prepare(self, linear: bool) -> None:
        """Make what the first frame that shows another octave of the target would have to wait for; see `octaves`."""
        for octave in self.octaves(linear):
            _ = octave.corners

    def octaves(self, linear: bool) -> tuple[AlignmentLevel, ...]:
        """Return the octaves, from fine to coarse, as frames show them whose values go with the light, or are sRGB."""
        return self.pictures.octaves(linear)

    def to_metres(self, template_xy: Points) -> Points:
        """Map template px (N, 2) to the target's plane, metres, origin at the centre, y up."""
        M = self.metres_from_template
        return template_xy @ M[:2, :2].T + M[:2, 2]


def prepare_targets(
    images: Sequence[TargetImage], parameters: Parameters, parts: BuildCache | None = None
) -> tuple[Target, ...]:
    """Describe every target at every scale.

    Parameters
    ----------
    images : the targets
    parameters : all parameters, the frame's
    parts : takes what is made; what was made before of the same image and equal values is used again

    Raises
    ------
    ParameterError
        If methods make no sense together.
    ShapeError
        If a picture is not (H, W) or (H, W, 3) uint8, or has nothing that a keypoint could be found on.
    """
    targets = known_targets(images, parameters, parts)
    for target in targets:
        count, fewest = len(target.features.described.keypoints), parameters.homography.min_inliers
        if count < fewest:
            raise ShapeError(
                f"target {target.name}: {count} keypoints; need at least {fewest}: a picture with texture, and not too "
                "small"
            )
    return targets


def known_targets(
    images: Sequence[TargetImage], parameters: Parameters, parts: BuildCache | None = None
) -> tuple[Target, ...]:
    """Return targets of which everything is made when it is first asked for; see `prepare_targets`."""
    reason = method_conflict(parameters)
    if reason:
        raise ParameterError(reason)
    parts = BuildCache() if parts is None else parts
    return tuple(_known(image, parameters, parts) for image in images)


def _known(image: TargetImage, parameters: Parameters, parts: BuildCache) -> Target:
    pixels, p = image.pixels, parameters
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] != 3):
        raise ShapeError(f"target {image.name}: shape {pixels.shape} {pixels.dtype}; need (H, W) or (H, W, 3) uint8")
    weights = p.raw.grey_weights if pixels.ndim == 3 else ()
    grey = parts.make(_grey, pixels, weights)
    first, thorough = description_options(p), description_options(thorough_parameters(p))
    extractor = parts.make(make_extractor, first.extractor)
    pyramids = parts.make(AlignmentPyramids, image, weights, p.pyramid.kernel)
    return parts.make(
        Target,
        image.name,
        image.width_m,
        image,
        grey,
        parts.make(_on_demand, target_features, grey, first, extractor),
        parts.make(_on_demand, close_features, grey, first, extractor),
        parts.make(_on_demand, thorough_features, grey, thorough, extractor),
        parts.make(AlignmentPictures, pyramids, p.refinement.max_points),
    )


def _on_demand(make: Callable[..., TargetFeatures], *arguments: Any) -> FeaturesOnDemand:
    return FeaturesOnDemand(partial(make, *arguments))


def _grey(pixels: Image, weights: tuple[float, ...]) -> Image:
    return np.ascontiguousarray(pixels) if pixels.ndim == 2 else grey_of(pixels, weights)


@cache
def _outline(width: int, height: int) -> Points:
    right, bottom = width - 0.5, height - 0.5
    outline = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    outline.flags.writeable = False
    return outline


@cache
def _outline_homogeneous(width: int, height: int) -> Floats:
    homogeneous = np.vstack((_outline(width, height).T, np.ones(4)))
    homogeneous.flags.writeable = False
    return homogeneous


@cache
def _metres_from_template(width: int, height: int, width_m: float) -> Matrix3:
    scale = width_m / width
    matrix = np.array([[scale, 0, -scale * (width - 1) / 2], [0, -scale, scale * (height - 1) / 2], [0, 0, 1]])
    matrix.flags.writeable = False
    return matrix


def _corners(level: Level, count: int) -> Points:
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
    return level.to_full(xy[order[np.sort(first)]])
