# SPDX-License-Identifier: Apache-2.0
"""Keypoints and descriptors of a frame: in a first look, or thoroughly."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from imgu_ros.config.components import FeatureParameters
from imgu_ros.config.parameters import PreprocessParameters
from imgu_ros.image.frame_image import FrameImage, most_halvings
from imgu_ros.image.preprocessing import preprocessed, with_edges
from imgu_ros.reference.features import extractor_options, together
from imgu_ros.result import Stage, StageClock
from imgu_ros.types import Image, Points
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.descriptors.extractor import DetectorDescriptor, FeatureExtractor
from imgu_ros.vision.scale_space.pyramid import PixelScaling, Pyramid, build_pyramid

#: Factor by which a frame is enlarged for a thorough search: a small target has few corners that are larger than noise.
#: Measured: benchmarks/printed_targets.py.
_ENLARGED = 2
#: Keypoints in images of even contrast for each of the others. Measured: benchmarks/printed_targets.py.
_EVEN_RICHNESS = 1.5
#: The contrast of a part of an image is that of so many steps about it, of so many px of the level. Measured:
#: benchmarks/printed_targets.py.
_SURROUNDINGS, _STEP_PX = (7, 7), 4
#: Contrast that counts as noise, grey values. Measured: benchmarks/printed_targets.py.
_FAINT = 2.0
#: Contrast of every part of an image with even contrast, grey values.
_EVEN = 40.0
#: A level with a shorter side holds hardly two descriptor patches of 31 px: too few keypoints for its cost.
_SMALLEST_SIDE_PX = 64


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """A frame's pyramid, and its keypoints with descriptors."""

    pyramid: Pyramid
    described: Descriptions

    @property
    def unit_px(self) -> float:
        """Raw px in a pixel of the image in which keypoints were detected."""
        return self.pyramid.levels[0].scale


def find_features(
    pictures: FrameImage, parameters: FeatureParameters, extractor: FeatureExtractor, clock: StageClock
) -> Features:
    """Build a frame's pyramid, detect its keypoints and describe them.

    Parameters
    ----------
    images : the frame's
    parameters : those of features; for a thorough search those of `thorough_parameters`
    extractor : the one that the parameters choose, see `extractor_options`
    clock : takes the time of the stages
    """
    with clock.measures(Stage.PYRAMID):
        pyramid = frame_pyramid(reduced_picture(pictures, parameters), parameters)
    return extracted_features(pyramid, extractor, parameters.keypoints.max_count, clock)


def find_faint_features(
    pictures: FrameImage, parameters: FeatureParameters, extractor: FeatureExtractor, clock: StageClock
) -> Features:
    """Detect and describe a frame's keypoints, also those of small targets and of parts with little contrast.

    The frame is enlarged where that is within `pyramid.max_side_px`, and more keypoints are detected in images of even
    contrast: strong corners elsewhere in a scene take all places else. Detectors that find every scale by
    themselves enlarge by themselves.

    Parameters
    ----------
    pictures, parameters, extractor, clock : see `find_features`; the parameters are those of a thorough search
    """
    p = parameters
    detector = extractor_options(p).detector
    if not isinstance(extractor, DetectorDescriptor) or (detector is not None and detector.finds_every_scale):
        return find_features(pictures, p, extractor, clock)
    with clock.measures(Stage.PYRAMID):
        base, factor = reduced_picture(pictures, p), 1
        if _ENLARGED * max(base.image.shape) <= p.pyramid.max_side_px:
            factor = _ENLARGED
            enlarged = cv2.resize(base.image, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
            base = Reduced(enlarged, base.full_size * factor)
        pyramid = frame_pyramid(base, p)
        even = replace(pyramid, levels=tuple(replace(each, image=_even(each.image)) for each in pyramid.levels))
    with clock.measures(Stage.KEYPOINTS):
        count = p.keypoints.max_count
        strong, dull = extractor.detect(pyramid, count), extractor.detect(even, round(_EVEN_RICHNESS * count))
        keypoints = together((strong, dull))
    with clock.measures(Stage.DESCRIBE):
        described = extractor.describe(pyramid, keypoints)
    k = described.keypoints
    keypoints = replace(k, xy=PixelScaling(factor).from_full_unchecked(k.xy), scale=k.scale / factor)
    return Features(pyramid, Descriptions(keypoints.rounded_to_float32(), described.descriptors))


def _even(image: Image) -> Image:
    """Return an image whose every part has about the same contrast."""
    height, width = image.shape
    small = max(width // _STEP_PX, 1), max(height // _STEP_PX, 1)
    squares = cv2.multiply(image, image, dtype=cv2.CV_16U)
    mean, square = (
        cv2.blur(cv2.resize(each, small, interpolation=cv2.INTER_AREA).astype(np.float32), _SURROUNDINGS)
        for each in (image, squares)
    )
    gain = _EVEN / (np.sqrt(np.maximum(square - mean * mean, 0)) + _FAINT)
    factor, offset = (cv2.resize(each, (width, height)) for each in (gain, 128 - mean * gain))
    even: Image = cv2.add(cv2.multiply(image, factor, dtype=cv2.CV_32F), offset, dtype=cv2.CV_8U)
    return even


def frame_pyramid(base: Reduced, parameters: FeatureParameters) -> Pyramid:
    """Build the pyramid in which keypoints are detected."""
    p = parameters.pyramid
    pyramid = build_pyramid(
        base.image,
        p.kind,
        p.levels,
        p.scales_per_octave,
        min_side_px=_SMALLEST_SIDE_PX,
        kernel=p.kernel,
        full_size=base.full_size,
    )
    return with_edges(pyramid, parameters.preprocess)


def extracted_features(pyramid: Pyramid, extractor: FeatureExtractor, max_count: int, clock: StageClock) -> Features:
    """Detect and describe at most `max_count` keypoints of a frame's pyramid."""
    if isinstance(extractor, DetectorDescriptor):
        with clock.measures(Stage.KEYPOINTS):
            keypoints = extractor.detect(pyramid, max_count)
        with clock.measures(Stage.DESCRIBE):
            described = extractor.describe(pyramid, keypoints)
    else:
        # A method that does both at once: its time cannot be told apart.
        with clock.measures(Stage.DESCRIBE):
            described = extractor.extract(pyramid, max_count)
    return Features(pyramid, Descriptions(described.keypoints.rounded_to_float32(), described.descriptors))


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """An image, and width and height of the part of the frame that it shows, px."""

    image: Image
    full_size: Points


@dataclass(frozen=True, slots=True)
class Reduction:
    """How a frame is reduced before keypoints are detected.

    Attributes
    ----------
    halvings : by the mean of four pixels each, as often as possible
    width, height : of the reduced image, px
    full_width, full_height : of the part of the frame that it shows, px
    """

    halvings: int
    width: int
    height: int
    full_width: int
    full_height: int

    @property
    def unit_px(self) -> float:
        """Raw px in a pixel of the reduced image."""
        return math.sqrt(self.full_width / self.width * (self.full_height / self.height))


def reduction_of(shape: tuple[int, int], parameters: FeatureParameters) -> Reduction:
    """Return how a frame of `shape`, (height, width) px, is reduced."""
    height, width = shape
    factor = math.ceil(max(height, width) / parameters.pyramid.max_side_px)
    if _is_preprocessed(parameters):
        columns, rows = (max(1, round(side / factor - 1e-9)) for side in (width, height))
        return Reduction(0, columns, rows, width, height)
    halvings = min(factor.bit_length() - 1, most_halvings(shape))
    rows, columns, step = height >> halvings, width >> halvings, 2**halvings
    left = factor / step
    small = [max(1, round(side / left)) if left > 1 else side for side in (columns, rows)]
    return Reduction(halvings, small[0], small[1], columns * step, rows * step)


def reduced_picture(pictures: FrameImage, parameters: FeatureParameters) -> Reduced:
    """Return the image in which keypoints are detected: straight from the mosaic where it is small and as it came."""
    p = parameters.pyramid
    reduction = reduction_of(pictures.shape, parameters)
    full_size = np.array((reduction.full_width, reduction.full_height))
    if _is_preprocessed(parameters):
        grey = preprocessed(pictures.halved(0), parameters.preprocess, p.kernel)
        level = build_pyramid(grey, levels=1, max_side_px=p.max_side_px).levels[0]
        return Reduced(level.image, full_size)
    image = pictures.halved(reduction.halvings)
    size = reduction.width, reduction.height
    if image.shape[1::-1] != size:
        image = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
    return Reduced(image, full_size)


def plain_picture(pictures: FrameImage, parameters: FeatureParameters) -> Reduced:
    """Return the image from which `reduced_picture` can be made elsewhere: the same, or all of a frame's pixels.

    Steps of `preprocess` come before the reduction, and are left to whoever makes the pyramid.
    """
    if not _is_preprocessed(parameters):
        return reduced_picture(pictures, parameters)
    return Reduced(pictures.halved(0), np.array(pictures.shape[::-1]))


def _is_preprocessed(parameters: FeatureParameters) -> bool:
    return parameters.preprocess != PreprocessParameters()
