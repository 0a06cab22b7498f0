"""What frames are matched to: a target's keypoints at every scale, how it looks from near and from the side."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Lock

import cv2
import numpy as np

from imgu_ros.params import Parameters
from imgu_ros.perception.features import as_told, thoroughly
from imgu_ros.perception.preprocessing import for_targets, preprocessed, with_edges
from imgu_ros.types import Image
from imgu_ros.vision.descriptors.describe import Descriptions, describe
from imgu_ros.vision.keypoints.detect import OF_EVERY_SCALE, detect
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.matching.gallery import Gallery, prepare_gallery
from imgu_ros.vision.matching.metrics import metric_for
from imgu_ros.vision.scale_space.pyramid import PyramidKind, band_passed, build_pyramid

#: A target may fill this many times the frame's longer side.
_LARGEST_VIEW = 2
#: Keypoints of a target for each of the frame's: it is described at every scale.
_RICHNESS = 1.5
_SMALLEST_SIDE_PX = 48
#: Oblique views: descriptors bear about 45 degrees of tilt, so that one of 60 reaches beyond 70 (Yu & Morel 2011).
_SHORTENING = 2
_DIRECTIONS = 4
#: Keypoints of an oblique view for each of the frame's in a thorough search.
_OBLIQUE_RICHNESS = 0.4
#: For a target seen from near: how many times the frame's longer side it may fill, how far its picture is enlarged for
#: that, over how many octaves, and keypoints for each of the frame's.
_CLOSEST_VIEW = 4
_ENLARGED = 2
_CLOSE_OCTAVES = 2
_CLOSE_RICHNESS = 6


@dataclass(frozen=True, slots=True, eq=False)
class TargetFeatures:
    """Keypoints of a target, in template px, and their descriptors for a frame's to be matched to."""

    described: Descriptions
    gallery: Gallery


def target_features(grey: Image, parameters: Parameters) -> TargetFeatures:
    """Describe a target, as it looks from its front, at every scale.

    Parameters
    ----------
    grey : (H, W) uint8
    parameters : all parameters, the frame's
    """
    described = _described(grey, parameters, round(_RICHNESS * parameters.keypoints.max_count))
    return _gathered(described, parameters)


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


def close_features(grey: Image, parameters: Parameters) -> TargetFeatures:
    """Describe a target as it looks from so near that little of it is in view: densely, and enlarged.

    Of keypoints spread over all of a target, at every scale, a part of it seen at one scale has too few.

    Parameters
    ----------
    grey : (H, W) uint8
    parameters : all parameters, the frame's
    """
    p = parameters
    enlarged = grey
    # A picture with fewer pixels than a frame shows of it is interpolated in the frame as well. These detectors do so.
    if (
        p.keypoints.detector not in OF_EVERY_SCALE
        and _ENLARGED * max(grey.shape) <= _CLOSEST_VIEW * p.pyramid.max_side_px
    ):
        enlarged = cv2.resize(grey, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
    count = round(_CLOSE_RICHNESS * p.keypoints.max_count)
    scales = _Scales(_CLOSEST_VIEW, _CLOSE_OCTAVES * p.pyramid.scales_per_octave + 1, even=False)
    described = _described(enlarged, p, count, scales)
    factor = enlarged.shape[0] / grey.shape[0]
    k = described.keypoints
    keypoints = replace(k, xy=(k.xy + 0.5) / factor - 0.5, scale=k.scale / factor)
    return _gathered(Descriptions(keypoints, described.descriptors), p)


def thorough_features(grey: Image, parameters: Parameters) -> TargetFeatures:
    """Describe a target for a thorough search: with more keypoints, and also in oblique views.

    Parameters
    ----------
    grey : (H, W) uint8
    parameters : all parameters, those of a first look
    """
    p = thoroughly(parameters)
    views = [_described(grey, p, round(_RICHNESS * p.keypoints.max_count))]
    views += [_oblique(grey, p, math.pi * k / _DIRECTIONS) for k in range(_DIRECTIONS)]
    keypoints = [view.keypoints for view in views]
    together = Keypoints(
        *(np.concatenate([getattr(k, name) for k in keypoints]) for name in Keypoints.__dataclass_fields__)
    )
    return _gathered(Descriptions(together, np.concatenate([view.descriptors for view in views])), p)


def _oblique(grey: Image, parameters: Parameters, direction_rad: float) -> Descriptions:
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
    described = _described(view, parameters, max(1, round(_OBLIQUE_RICHNESS * parameters.keypoints.max_count)))
    k = described.keypoints
    xy = ((k.xy + 0.5) * (_SHORTENING, 1) - 0.5 + offset) @ R
    inside = np.flatnonzero(((xy >= 0) & (xy <= (width - 1, height - 1))).all(axis=1))
    from_front = Keypoints(xy, k.scale * math.sqrt(_SHORTENING), k.angle, k.response, k.octave)
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


_EVERY_SCALE = _Scales(_LARGEST_VIEW, levels=32, even=True)


def _described(grey: Image, parameters: Parameters, count: int, scales: _Scales = _EVERY_SCALE) -> Descriptions:
    p = parameters
    pyramid = build_pyramid(
        preprocessed(grey, for_targets(p.preprocess), p.pyramid.kernel),
        PyramidKind.FINE,
        levels=scales.levels,
        scales_per_octave=p.pyramid.scales_per_octave,
        max_side_px=scales.largest * p.pyramid.max_side_px,
        min_side_px=_SMALLEST_SIDE_PX,
        kernel=p.pyramid.kernel,
    )
    if p.pyramid.kind == PyramidKind.LAPLACIAN:
        pyramid = band_passed(pyramid)
    pyramid = with_edges(pyramid, p.preprocess)
    keypoints = detect(pyramid, p.keypoints.detector, count, even_scales=scales.even, fast_arc=p.keypoints.fast_arc)
    return describe(pyramid, keypoints, p.descriptor.kind)


def _gathered(described: Descriptions, parameters: Parameters) -> TargetFeatures:
    metric = metric_for(parameters.descriptor.kind, parameters.matching.metric)
    described = Descriptions(as_told(described.keypoints), described.descriptors)
    return TargetFeatures(described, prepare_gallery(described.descriptors, metric, described.keypoints.xy))
