"""Keypoints and descriptors of a frame: in a first look, or thoroughly."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from imgu_ros.params import Parameters, PreprocessParameters
from imgu_ros.perception.clock import StageClock
from imgu_ros.perception.pictures import Pictures
from imgu_ros.perception.preprocessing import preprocessed, with_edges
from imgu_ros.perception.result import Stage
from imgu_ros.types import Image, Points
from imgu_ros.vision.descriptors.describe import Descriptions, describe
from imgu_ros.vision.keypoints.detect import detect
from imgu_ros.vision.scale_space.pyramid import Pyramid, PyramidKind, build_pyramid

#: A level with a shorter side than this has too few keypoints for its cost.
_SMALLEST_SIDE_PX = 64
#: Samples of a thorough search for each of a first look: of many more matches fewer are right.
_MORE_SAMPLES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """A frame's pyramid, and its keypoints with descriptors."""

    pyramid: Pyramid
    described: Descriptions

    @property
    def unit_px(self) -> float:
        """Raw px in a pixel of the picture that keypoints were sought in."""
        return self.pyramid.levels[0].scale


def find_features(pictures: Pictures, parameters: Parameters, clock: StageClock) -> Features:
    """Build a frame's pyramid, find its keypoints and describe them.

    Parameters
    ----------
    pictures : the frame's
    parameters : all parameters; for a thorough search those of `thoroughly`
    clock : takes the time of the stages
    """
    p = parameters
    with clock.measures(Stage.PYRAMID):
        base = _reduced(pictures, p)
        pyramid = build_pyramid(
            base.image,
            p.pyramid.kind,
            p.pyramid.levels,
            p.pyramid.scales_per_octave,
            min_side_px=_SMALLEST_SIDE_PX,
            kernel=p.pyramid.kernel,
            full_size=base.full_size,
        )
        pyramid = with_edges(pyramid, p.preprocess)
    with clock.measures(Stage.KEYPOINTS):
        keypoints = detect(pyramid, p.keypoints.detector, p.keypoints.max_count, fast_arc=p.keypoints.fast_arc)
    with clock.measures(Stage.DESCRIBE):
        return Features(pyramid, describe(pyramid, keypoints, p.descriptor.kind))


def thoroughly(parameters: Parameters) -> Parameters:
    """Return the parameters of a thorough search: more pixels, more scales, more keypoints, more samples."""
    p = parameters
    kind = PyramidKind.FINE if p.pyramid.kind == PyramidKind.COARSE else p.pyramid.kind
    return replace(
        p,
        pyramid=replace(p.pyramid, kind=str(kind), max_side_px=max(p.search.max_side_px, p.pyramid.max_side_px)),
        keypoints=replace(p.keypoints, max_count=max(p.search.max_count, p.keypoints.max_count)),
        homography=replace(p.homography, max_iterations=_MORE_SAMPLES * p.homography.max_iterations),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Reduced:
    """A picture, and width and height of the part of the frame that it shows, px."""

    image: Image
    full_size: Points


def _reduced(pictures: Pictures, parameters: Parameters) -> _Reduced:
    """Return the picture in which keypoints are sought: straight from the mosaic where it is small and as it came."""
    p = parameters.pyramid
    height, width = pictures.shape
    factor = math.ceil(max(height, width) / p.max_side_px)
    if parameters.preprocess != PreprocessParameters():
        grey = preprocessed(pictures.halved(0), parameters.preprocess, p.kernel)
        level = build_pyramid(grey, levels=1, max_side_px=p.max_side_px).levels[0]
        return _Reduced(level.image, np.array((width, height)))
    halvings = min(factor.bit_length() - 1, pictures.most_halvings)
    image = pictures.halved(halvings)
    rows, columns = image.shape
    left = factor / 2**halvings
    if left > 1:
        size = max(1, round(columns / left)), max(1, round(rows / left))
        image = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
    return _Reduced(image, np.array((columns, rows)) * 2**halvings)
