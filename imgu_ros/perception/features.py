"""Keypoints and descriptors of a frame: in a first look, or thoroughly."""

from __future__ import annotations

from dataclasses import dataclass, replace

from imgu_ros.params import Parameters
from imgu_ros.perception.clock import StageClock
from imgu_ros.perception.preprocessing import preprocessed, with_edges
from imgu_ros.perception.result import Stage
from imgu_ros.types import Image
from imgu_ros.vision.descriptors.describe import Descriptions, describe
from imgu_ros.vision.keypoints.detect import detect
from imgu_ros.vision.scale_space.pyramid import Pyramid, PyramidKind, build_pyramid


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """A frame's pyramid, and its keypoints with descriptors."""

    pyramid: Pyramid
    described: Descriptions

    @property
    def unit_px(self) -> float:
        """Raw px in a pixel of the picture that keypoints were sought in."""
        return self.pyramid.levels[0].scale


def find_features(grey: Image, parameters: Parameters, clock: StageClock) -> Features:
    """Build a frame's pyramid, find its keypoints and describe them.

    Parameters
    ----------
    grey : (H, W) uint8, at full resolution
    parameters : all parameters; for a thorough search those of `thoroughly`
    clock : takes the time of the stages
    """
    p = parameters
    with clock.measures(Stage.PYRAMID):
        pyramid = build_pyramid(
            preprocessed(grey, p.preprocess, p.pyramid.kernel),
            p.pyramid.kind,
            p.pyramid.levels,
            p.pyramid.scales_per_octave,
            p.pyramid.max_side_px,
            kernel=p.pyramid.kernel,
        )
        pyramid = with_edges(pyramid, p.preprocess)
    with clock.measures(Stage.KEYPOINTS):
        keypoints = detect(pyramid, p.keypoints.detector, p.keypoints.max_count, fast_arc=p.keypoints.fast_arc)
    with clock.measures(Stage.DESCRIBE):
        return Features(pyramid, describe(pyramid, keypoints, p.descriptor.kind))


def thoroughly(parameters: Parameters) -> Parameters:
    """Return the parameters of a thorough search: more pixels, more scales, more keypoints."""
    p = parameters
    kind = PyramidKind.FINE if p.pyramid.kind == PyramidKind.COARSE else p.pyramid.kind
    return replace(
        p,
        pyramid=replace(p.pyramid, kind=str(kind), max_side_px=max(p.search.max_side_px, p.pyramid.max_side_px)),
        keypoints=replace(p.keypoints, max_count=max(p.search.max_count, p.keypoints.max_count)),
    )
