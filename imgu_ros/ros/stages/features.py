# SPDX-License-Identifier: Apache-2.0
"""The node `features`: the levels of a pyramid in, keypoints with their descriptors out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from functools import lru_cache
from typing import Any

import numpy as np
from rclpy.node import Node

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import FeatureParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.features import Reduced, extracted_features, frame_pyramid
from imgu_ros.errors import EncodingError, ImguError
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.image import decode_image
from imgu_ros.messages.reduced_info import Covered, decode_covered
from imgu_ros.reference.features import extractor_options
from imgu_ros.reference.templates import TargetImage
from imgu_ros.result import Result, StageClock
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.outputs import Outputs, TopicSelection
from imgu_ros.ros.stages.input import StageTopics
from imgu_ros.ros.stages.node import run_stage
from imgu_ros.ros.stages.pyramid import LEVELS, LEVELS_INFO
from imgu_ros.ros.stages.stage import PipelineStage, frame_without_image, picture_feed, reduced_info_beside
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.types import Image
from imgu_ros.vision.descriptors.extractor import DetectorDescriptor, FeatureExtractor, make_extractor
from imgu_ros.vision.scale_space.pyramid import Level, Pyramid

_FIRST = f"{LEVELS}0"


def run(ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run the node until the process is asked to stop; return the exit code."""
    return run_stage(FeaturesStage(), ros_arguments, stop)


class FeaturesStage(PipelineStage):
    """Finds and describes keypoints."""

    name = "features"
    takes = (_FIRST,)
    selection = TopicSelection(lambda topic: topic == "keypoints", {})
    _parts: BuildCache | None = None
    _extractor: FeatureExtractor = DetectorDescriptor(extractor_options(FeatureParameters.of(Parameters())))

    def use(self, parameters: Parameters, images: Sequence[TargetImage]) -> None:
        """See `PipelineStage.use`."""
        parts = BuildCache(self._parts)
        extractor = parts.make(make_extractor, extractor_options(FeatureParameters.of(parameters)))
        super().use(parameters, images)
        parts.settle()
        self._parts, self._extractor = parts, extractor

    def topics(self, node: Node, parameters: Parameters) -> StageTopics:
        """See `PipelineStage.topics`."""
        levels = tuple(picture_feed(node, f"{LEVELS}{k}") for k in range(parameters.pyramid.levels))
        return StageTopics(levels, reduced_info_beside(node, levels[0], LEVELS_INFO))

    def is_complete(self, messages: Mapping[str, Any], absent: Set[str]) -> bool:
        """See `PipelineStage.is_complete`: the size of level 0 tells how many there are."""
        if _FIRST not in messages:
            return False
        try:
            count = _level_count(_picture(messages[_FIRST]).shape, FeatureParameters.of(self.parameters))
        except ImguError:
            return True  # `work` raises the error
        return all(f"{LEVELS}{k}" in messages for k in range(count))

    def work(self, job: FrameMessages, outputs: Outputs) -> None:
        """See `PipelineStage.work`."""
        first = _picture(job.messages[_FIRST])
        size = Covered(first.shape[1], first.shape[0])
        shown = size if job.camera_info is None else decode_covered(job.camera_info, size)
        count = _level_count(first.shape, FeatureParameters.of(self.parameters))
        pictures = [first, *(_picture(job.messages[f"{LEVELS}{k}"]) for k in range(1, count))]
        full = np.array((shown.width, shown.height), np.float64)
        pyramid = Pyramid(tuple(Level(picture, full / np.array(picture.shape[1::-1])) for picture in pictures))
        clock = StageClock()
        features = extracted_features(pyramid, self._extractor, self.parameters.keypoints.max_count, clock)
        described = features.described
        outputs.publish(
            Result(
                frame_without_image(decode_header(job.messages[_FIRST])),
                {},
                keypoints=described.keypoints,
                descriptors=described.descriptors,
                times_ns=clock.times_ns,
            )
        )


def _picture(message: Any) -> Image:
    pixels = decode_image(message).pixels
    if pixels.dtype != np.uint8 or pixels.ndim != 2:
        raise EncodingError(f"pyramid level: shape {pixels.shape} {pixels.dtype}; need mono8")
    return np.ascontiguousarray(pixels)


@lru_cache(maxsize=8)
def _level_count(shape: tuple[int, int], parameters: FeatureParameters) -> int:
    """Return how many levels `frame_pyramid` makes of an image of `shape`."""
    return len(frame_pyramid(Reduced(np.zeros(shape, np.uint8), np.array(shape[::-1])), parameters).levels)
