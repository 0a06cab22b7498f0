# SPDX-License-Identifier: Apache-2.0
"""Keypoints with descriptors of a pyramid: by a detector and a descriptor, or by one method that does both.

A `FeatureExtractor` gets a whole pyramid at once, so that it may work on the levels as a batch, and is made once from
its parameters, so that it may hold weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from imgu_ros.arguments import require_type
from imgu_ros.errors import ShapeError
from imgu_ros.vision.descriptors.describe import Descriptions, describe
from imgu_ros.vision.keypoints.detect import detect
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.methods import DescriptorMethod, DetectorMethod
from imgu_ros.vision.scale_space.pyramid import Pyramid


class FeatureExtractor(Protocol):
    """Finds keypoints and describes them."""

    def extract(self, pyramid: Pyramid, max_count: int, even_scales: bool = False) -> Descriptions:
        """Return at most `max_count` keypoints of a pyramid, in full-resolution coordinates, with descriptors.

        `even_scales` asks for as many on every level, for an image that will be searched for at any scale; else they
        go with the levels' areas (`level_shares`).
        """


@dataclass(frozen=True, slots=True)
class ExtractorOptions:
    """All that a feature extractor depends on: equal options make equal extractors.

    Attributes
    ----------
    detector : row of the detector; None: the descriptor detects, too
    descriptor : row of the descriptor
    detector_parameters, descriptor_parameters : their own parameters; None: the defaults
    """

    detector: DetectorMethod | None
    descriptor: DescriptorMethod
    detector_parameters: Any = None
    descriptor_parameters: Any = None


class DetectorDescriptor:
    """A detector, then a descriptor of what it found.

    Parameters
    ----------
    options : of a descriptor that does not detect
    """

    def __init__(self, options: ExtractorOptions) -> None:
        require_type(options, ExtractorOptions, "options")
        if options.detector is None:
            raise ShapeError("options: no detector; need one, as the descriptor only describes")
        self._detector = options.detector.bound(options.detector_parameters)
        self._descriptor = options.descriptor.bound(options.descriptor_parameters)

    def detect(self, pyramid: Pyramid, max_count: int, even_scales: bool = False) -> Keypoints:
        """Return keypoints; see `detect`."""
        return detect(pyramid, self._detector, max_count, even_scales)

    def describe(self, pyramid: Pyramid, keypoints: Keypoints) -> Descriptions:
        """Return their descriptors; see `describe`."""
        return describe(pyramid, keypoints, self._descriptor)

    def extract(self, pyramid: Pyramid, max_count: int, even_scales: bool = False) -> Descriptions:
        """See `FeatureExtractor.extract`."""
        return self.describe(pyramid, self.detect(pyramid, max_count, even_scales))


def make_extractor(options: ExtractorOptions) -> FeatureExtractor:
    """Return the extractor that `options` choose."""
    require_type(options, ExtractorOptions, "options")
    if not options.descriptor.detects:
        return DetectorDescriptor(options)
    extractor: FeatureExtractor = options.descriptor.made(options.descriptor_parameters)
    return extractor
