# SPDX-License-Identifier: Apache-2.0
"""What frames are matched to: a target's keypoints at every scale, how it looks from near and from the side."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from threading import Lock

import cv2
import numpy as np

from imgu_ros.config.components import DetectionParameters, FeatureParameters
from imgu_ros.config.parameters import PreprocessParameters
from imgu_ros.image.preprocessing import for_targets, preprocessed, with_edges
from imgu_ros.types import Image, Indices
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.descriptors.extractor import ExtractorOptions, FeatureExtractor
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.matching.gallery import Gallery, prepare_gallery
from imgu_ros.vision.matching.metrics import Metric, metric_for
from imgu_ros.vision.methods import DESCRIPTORS, DETECTORS
from imgu_ros.vision.scale_space.pyramid import PixelScaling, PyramidKind, band_passed, build_pyramid

#: Largest size at which a reference is described, in the frame's longer side. Measured: benchmarks/thresholds.py, study
#: detection.
_LARGEST_VIEW = 2
#: Keypoints of a reference for each of the frame's: it is described at every scale. Measured: benchmarks/thresholds.py,
#: study detection.
_RICHNESS = 1.5
#: A level with a shorter side holds little more than one descriptor patch of 31 px.
_SMALLEST_SIDE_PX = 48
#: Oblique views are shortened by this factor, a tilt of 60 degrees: descriptors bear about 45 degrees of tilt, so that
#: these reach beyond 70 (Yu & Morel 2011). Measured: benchmarks/thresholds.py, study detection.
_SHORTENING = 2
#: Number of directions of tilt among the oblique views. Measured: benchmarks/thresholds.py, study detection.
_DIRECTIONS = 4
#: Keypoints of an oblique view for each of the frame's in a thorough search. Measured: benchmarks/thresholds.py, study
#: detection.
_OBLIQUE_RICHNESS = 0.4
#: Largest size at which a reference seen from near is described, in the frame's longer side. Measured:
#: benchmarks/thresholds.py, study detection.
_CLOSEST_VIEW = 4
#: Factor by which the image is enlarged for the view from near. Measured: benchmarks/thresholds.py, study detection.
_ENLARGED = 2
#: Octaves of scale of the view from near. Measured: benchmarks/thresholds.py, study detection.
_CLOSE_OCTAVES = 2
#: Keypoints of the view from near for each of the frame's. Measured: benchmarks/thresholds.py, study detection.
_CLOSE_RICHNESS = 6
#: Samples of a thorough search for each of a first search: of many more matches a smaller share is right. Measured:
#: benchmarks/thresholds.py, study detection.
_MORE_SAMPLES = 3


@dataclass(frozen=True, slots=True, eq=False)
class TargetFeatures:
    """Keypoints of a target, in template px, and their descriptors for a frame's to be matched to."""

    described: Descriptions
    gallery: Gallery


@dataclass(frozen=True, slots=True)
class DescriptionOptions:
    """All values that the description of a target depends on: equal options describe it alike.

    Values that the chosen methods do not read are at their defaults.

    Attributes
    ----------
    preprocess : steps before keypoints are sought
    kernel, scales_per_octave, max_side_px : of the frame's pyramid
    band_passed : whether levels are bands of detail
    extractor, max_count : of the frame's keypoints
    metric : by which descriptors are compared
    """

    preprocess: PreprocessParameters
    kernel: str
    scales_per_octave: int
    max_side_px: int
    band_passed: bool
    extractor: ExtractorOptions
    max_count: int
    metric: Metric


def description_options(parameters: DetectionParameters) -> DescriptionOptions:
    """Return the values that the description of a target depends on, of `thorough_parameters` for a thorough search."""
    p = parameters
    return DescriptionOptions(
        preprocess=for_targets(p.preprocess),
        kernel=p.pyramid.kernel,
        scales_per_octave=p.pyramid.scales_per_octave,
        max_side_px=p.pyramid.max_side_px,
        band_passed=p.pyramid.kind == PyramidKind.LAPLACIAN,
        extractor=extractor_options(p),
        max_count=p.keypoints.max_count,
        metric=metric_for(p.descriptor.kind, p.matching.metric),
    )


def extractor_options(parameters: FeatureParameters) -> ExtractorOptions:
    """Return the chosen detector and descriptor with their own parameters."""
    descriptor = DESCRIPTORS[parameters.descriptor.kind]
    detector = None if descriptor.detects else DETECTORS[parameters.keypoints.detector]

    def value_of(name: str) -> object:
        return attrgetter(name)(parameters)

    return ExtractorOptions(
        detector,
        descriptor,
        None if detector is None else detector.parameters_from(value_of),
        descriptor.parameters_from(value_of),
    )


def thorough_parameters(parameters: DetectionParameters) -> DetectionParameters:
    """Return the parameters of a thorough search: more pixels, scales, keypoints and RANSAC samples."""
    p = parameters
    kind = PyramidKind.FINE if p.pyramid.kind == PyramidKind.COARSE else p.pyramid.kind
    return replace(
        p,
        pyramid=replace(p.pyramid, kind=str(kind), max_side_px=max(p.search.max_side_px, p.pyramid.max_side_px)),
        keypoints=replace(p.keypoints, max_count=max(p.search.max_count, p.keypoints.max_count)),
        homography=replace(p.homography, max_iterations=_MORE_SAMPLES * p.homography.max_iterations),
    )


def target_features(grey: Image, options: DescriptionOptions, extractor: FeatureExtractor) -> TargetFeatures:
    """Describe a target, as it looks from its front, at every scale.

    Parameters
    ----------
    grey : (H, W) uint8
    options : of a first look
    extractor : that `options` name
    """
    return _gathered(_described(grey, options, extractor, round(_RICHNESS * options.max_count)), options)


class FeaturesOnDemand:
    """Features that few frames need: made on the first call, then kept.

    Parameters
    ----------
    make : makes them
    """

    def __init__(self, make: Callable[[], TargetFeatures]) -> None:
        self._make = make
        self._features: TargetFeatures | None = None
        self._lock = Lock()

    def features(self) -> TargetFeatures:
        """Return them."""
        with self._lock:
            if self._features is None:
                self._features = self._make()
            return self._features


def close_features(grey: Image, options: DescriptionOptions, extractor: FeatureExtractor) -> TargetFeatures:
    """Describe a target as it looks from so near that little of it is in view: densely, and enlarged.

    Of keypoints spread over all of a target, at every scale, a part of it seen at one scale has too few.

    Parameters
    ----------
    grey : (H, W) uint8
    options : of a first look
    extractor : that `options` name
    """
    o, enlarged = options, grey
    # A picture with fewer pixels than a frame shows of it is interpolated in the frame as well. These detectors do so.
    detector = o.extractor.detector
    finds_every_scale = detector is not None and detector.finds_every_scale
    if not finds_every_scale and _ENLARGED * max(grey.shape) <= _CLOSEST_VIEW * o.max_side_px:
        enlarged = cv2.resize(grey, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
    scales = _Scales(_CLOSEST_VIEW, _CLOSE_OCTAVES * o.scales_per_octave + 1, even=False)
    described = _described(enlarged, o, extractor, round(_CLOSE_RICHNESS * o.max_count), scales)
    factor = enlarged.shape[0] / grey.shape[0]
    k = described.keypoints
    keypoints = replace(k, xy=PixelScaling(factor).from_full_unchecked(k.xy), scale=k.scale / factor)
    return _gathered(Descriptions(keypoints, described.descriptors), o)


def thorough_features(grey: Image, options: DescriptionOptions, extractor: FeatureExtractor) -> TargetFeatures:
    """Describe a target for a thorough search: with more keypoints, and also in oblique views.

    Parameters
    ----------
    grey : (H, W) uint8
    options : of a thorough search
    extractor : that `options` name
    """
    views = [_described(grey, options, extractor, round(_RICHNESS * options.max_count))]
    views += [_oblique(grey, options, extractor, math.pi * k / _DIRECTIONS) for k in range(_DIRECTIONS)]
    keypoints = together([view.keypoints for view in views])
    return _gathered(Descriptions(keypoints, np.concatenate([view.descriptors for view in views])), options)


def chosen_features(features: TargetFeatures, which: Indices, options: DescriptionOptions) -> TargetFeatures:
    """Return some of a target's features."""
    k, descriptors = features.described.keypoints, features.described.descriptors
    return _gathered(Descriptions(k.chosen(which), descriptors[which]), options)


def together(keypoints: Sequence[Keypoints]) -> Keypoints:
    """Return several keypoints as one, in their order."""
    return Keypoints(
        *(np.concatenate([getattr(k, name) for k in keypoints]) for name in Keypoints.__dataclass_fields__)
    )


def _oblique(
    grey: Image, options: DescriptionOptions, extractor: FeatureExtractor, direction_rad: float
) -> Descriptions:
    """Describe a target as it looks when it is turned away about the normal of a direction in its plane."""
    height, width = grey.shape
    c, s = math.cos(direction_rad), math.sin(direction_rad)
    R = np.array([[c, s], [-s, c]])  # the direction becomes x
    edges = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]]) @ R.T
    columns, rows = (max(1, math.ceil(extent)) for extent in np.ptp(edges, axis=0))
    columns = _SHORTENING * math.ceil(columns / _SHORTENING)
    offset = edges.min(axis=0) + 0.5
    turned = cv2.warpAffine(grey, np.column_stack((R, -offset)), (columns, rows), borderMode=cv2.BORDER_REPLICATE)
    view = cv2.resize(turned, (columns // _SHORTENING, rows), interpolation=cv2.INTER_AREA)
    described = _described(view, options, extractor, max(1, round(_OBLIQUE_RICHNESS * options.max_count)))
    k = described.keypoints
    xy = (PixelScaling((_SHORTENING, 1.0)).to_full_unchecked(k.xy) + offset) @ R
    inside = np.flatnonzero(((xy >= 0) & (xy <= (width - 1, height - 1))).all(axis=1))
    angle = (k.angle + direction_rad + math.pi) % (2 * math.pi) - math.pi
    from_front = Keypoints(xy, k.scale * math.sqrt(_SHORTENING), angle, k.response, k.octave)
    return Descriptions(from_front.chosen(inside), described.descriptors[inside])


@dataclass(frozen=True, slots=True)
class _Scales:
    """At which scales a target is described.

    Attributes
    ----------
    largest : the target's longer side over the longest side of a frame's level 0
    levels : from there on
    even : as many keypoints at every scale; else in proportion to the area
    """

    largest: int
    levels: int
    even: bool


#: 32 levels are more than any image has: the smallest side ends the pyramid.
_EVERY_SCALE = _Scales(_LARGEST_VIEW, levels=32, even=True)


def _described(
    grey: Image, options: DescriptionOptions, extractor: FeatureExtractor, count: int, scales: _Scales = _EVERY_SCALE
) -> Descriptions:
    o = options
    pyramid = build_pyramid(
        preprocessed(grey, o.preprocess, o.kernel),
        PyramidKind.FINE,
        levels=scales.levels,
        scales_per_octave=o.scales_per_octave,
        max_side_px=scales.largest * o.max_side_px,
        min_side_px=_SMALLEST_SIDE_PX,
        kernel=o.kernel,
    )
    if o.band_passed:
        pyramid = band_passed(pyramid)
    pyramid = with_edges(pyramid, o.preprocess)
    return extractor.extract(pyramid, count, scales.even)


def _gathered(described: Descriptions, options: DescriptionOptions) -> TargetFeatures:
    described = Descriptions(described.keypoints.rounded_to_float32(), described.descriptors)
    gallery = prepare_gallery(described.descriptors, options.metric, described.keypoints.xy)
    return TargetFeatures(described, gallery)
