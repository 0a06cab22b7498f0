# SPDX-License-Identifier: Apache-2.0
"""A stage of the pipeline: its inputs, its outputs, and how it processes a frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from rclpy.node import Node

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ReadingParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ParameterError
from imgu_ros.files.frame_reading import FrameReading, frame_reading
from imgu_ros.frame import Frame
from imgu_ros.messages.camera_reading import CameraReading
from imgu_ros.messages.header import Header
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_references, prepare_references
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.outputs import Outputs, TopicSelection
from imgu_ros.ros.qos import output_qos
from imgu_ros.ros.stages.input import Feed, StageTopics
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

IMAGE_TYPE = "sensor_msgs/msg/Image"
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
_CLOUD_DEPTH = 10
#: Of a frame without camera_info.
NO_CAMERA = CameraReading(None)


class PipelineStage(ABC):
    """A stage of the pipeline, for a node of its own.

    `work` is called in the worker's thread, everything else between two frames.

    Attributes
    ----------
    name : the node's
    takes : the names of the feeds that every frame needs
    selection : the topics that it publishes
    needs_targets : whether it needs the targets
    reads_camera : whether it reads raw frames or their camera
    reading : how frames are decoded
    remarks : of the last frame, for people
    """

    name: ClassVar[str]
    takes: ClassVar[tuple[str, ...]]
    selection: ClassVar[TopicSelection]
    needs_targets: ClassVar[bool] = False
    reads_camera: ClassVar[bool] = False
    reading: FrameReading = FrameReading()
    parameters: Parameters = Parameters()
    remarks: tuple[str, ...] = ()

    @abstractmethod
    def topics(self, node: Node, parameters: Parameters) -> StageTopics:
        """Return the topics that the stage takes."""

    @abstractmethod
    def work(self, job: FrameMessages, outputs: Outputs) -> None:
        """Process the messages of one frame and publish the result.

        Raises
        ------
        ImguError
            If they cannot be decoded or processed.
        """

    def use(self, parameters: Parameters, images: Sequence[TargetImage]) -> None:
        """Use these parameters and targets from the next frame on.

        Raises
        ------
        ImguError
            If they cannot be used; then nothing changes.
        """
        self.reading = self._reading_for(parameters)
        self.parameters = parameters

    def read_again(self, parameters: Parameters) -> None:
        """Read the camera's file again; FileError when it cannot be read: the old content stays."""
        if self.reads_camera:
            self.reading = frame_reading(ReadingParameters.of(parameters))

    def reset(self) -> None:  # noqa: B027
        """Drop the state of earlier frames: most stages have none."""

    def named(self, header: Header) -> Header:
        """Return a header with the camera's frame_id of this node's parameters, as every output has it."""
        name = self.parameters.frames.camera
        return replace(header, frame_id=name) if name else header

    def _reading_for(self, parameters: Parameters) -> FrameReading:
        wanted = ReadingParameters.of(parameters)
        return frame_reading(wanted, self.reading) if self.reads_camera else self.reading

    def is_complete(self, messages: Mapping[str, Any], absent: Set[str]) -> bool:
        """Return whether these messages of one frame, by the names of their feeds, are complete.

        Parameters
        ----------
        messages : what has come
        absent : feeds without a publisher
        """
        return all(name in messages for name in self.takes)


class TargetStage(PipelineStage):
    """A stage that uses the targets.

    Attributes
    ----------
    needs_features : whether it needs their features
    targets : the known ones
    """

    needs_targets = True
    needs_features: ClassVar[bool] = False
    targets: tuple[Reference, ...] = ()
    _parts: BuildCache | None = None

    def use(self, parameters: Parameters, images: Sequence[TargetImage]) -> None:
        """See `PipelineStage.use`; parts that do not depend on changed parameters are reused."""
        for image in images:
            if image.kind:
                raise ParameterError(
                    f"targets.images: {image.name} is a {image.kind}; stage nodes know pictures alone, need the "
                    "perception node"
                )
        reading = self._reading_for(parameters)
        parts = BuildCache(self._parts)
        self.targets = (prepare_references if self.needs_features else make_references)(images, parameters, parts)
        self._prepare(parameters, parts)
        parts.settle()
        self._parts = parts
        self.reading, self.parameters = reading, parameters

    def _prepare(self, parameters: Parameters, parts: BuildCache) -> None:
        """Prepare the targets for the stage."""


def picture_feed(node: Node, name: str) -> Feed:
    """Return a feed of images of another stage, reliable: across a network a large one would seldom arrive complete."""
    return Feed(name, node.resolve_topic_name(name), IMAGE_TYPE, output_qos())


def cloud_feed(node: Node, name: str) -> Feed:
    """Return a feed of point clouds of another stage."""
    return Feed(name, node.resolve_topic_name(name), CLOUD_TYPE, output_qos(_CLOUD_DEPTH))


def camera_info_beside(node: Node, feed: Feed, parameters: Parameters) -> str:
    """Return the camera_info topic beside a feed's, unless it is remapped itself; "" when a file is used instead."""
    return "" if parameters.camera.info_file else reduced_info_beside(node, feed, "camera_info")


def reduced_info_beside(node: Node, feed: Feed, own: str) -> str:
    """Return the topic beside a feed's that gives the part of a frame it shows, unless `own` is remapped itself."""
    topic = node.resolve_topic_name(own)
    if topic == node.resolve_topic_name(own, only_expand=True):
        return feed.topic.rpartition("/")[0] + "/camera_info"
    return topic


def frame_without_image(header: Header, read: CameraReading = NO_CAMERA) -> Frame:
    """Return a frame without its image, which other stages have processed, with its camera."""
    return Frame(_NO_IMAGE, header.stamp_ns, header.frame_id, read.camera, read.reason, read.remarks)


def unusable(read: CameraReading) -> tuple[str, ...]:
    """Return the remark for a camera_info that cannot be used; empty when it can, or there is none."""
    return (f"uncalibrated: {read.reason}; homographies, no poses",) if read.reason else ()


_NO_IMAGE = RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO))
