# SPDX-License-Identifier: Apache-2.0
"""What a stage of the chain is when it has a node of its own: what it takes, what it gives, and what it does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Set
from typing import Any, ClassVar

import numpy as np
from rclpy.node import Node

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ReadingParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.files.frame_reading import FrameReading, frame_reading
from imgu_ros.frame import Frame
from imgu_ros.messages.camera_reading import CameraReading
from imgu_ros.messages.header import Header
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_references, prepare_references
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.outputs import Choice, Outputs
from imgu_ros.ros.qos import output_qos
from imgu_ros.ros.stages.input import Feed, StageTopics
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

IMAGE_TYPE = "sensor_msgs/msg/Image"
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
_CLOUD_DEPTH = 10
#: Of a frame without camera_info.
NO_CAMERA = CameraReading(None)


class Stage(ABC):
    """A stage of the chain, for a node of its own.

    `work` is called in the worker's thread, everything else between two frames.

    Attributes
    ----------
    name : the node's
    takes : the names of the feeds without which there is nothing to work on
    choice : the topics that it gives
    needs_targets : whether it has to know the targets
    reads_camera : whether it reads raw frames or their camera
    reading : how it does
    remarks : what people should know of the last frame
    """

    name: ClassVar[str]
    takes: ClassVar[tuple[str, ...]]
    choice: ClassVar[Choice]
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
        """Work on the messages of one stamp and publish what comes out.

        Raises
        ------
        ImguError
            If they cannot be read or worked on.
        """

    def use(self, parameters: Parameters, images: Sequence[TargetImage]) -> None:
        """Work with these parameters and targets from now on.

        Raises
        ------
        ImguError
            If that cannot be; then nothing changes.
        """
        self.reading = self._reading_for(parameters)
        self.parameters = parameters

    def read_again(self, parameters: Parameters) -> None:
        """Read the camera's file anew; FileError when that cannot be: the old one stays."""
        if self.reads_camera:
            self.reading = frame_reading(ReadingParameters.of(parameters))

    def reset(self) -> None:  # noqa: B027
        """Forget what earlier frames told: most stages remember nothing."""

    def _reading_for(self, parameters: Parameters) -> FrameReading:
        wanted = ReadingParameters.of(parameters)
        return frame_reading(wanted, self.reading) if self.reads_camera else self.reading

    def is_complete(self, messages: Mapping[str, Any], absent: Set[str]) -> bool:
        """Return whether these messages of one stamp, by the names of their feeds, are enough to work on.

        Parameters
        ----------
        messages : what has come
        absent : feeds that nobody publishes
        """
        return all(name in messages for name in self.takes)


class TargetStage(Stage):
    """A stage that knows the targets.

    Attributes
    ----------
    needs_features : whether it has to know what they look like to a detector
    targets : the known ones
    """

    needs_targets = True
    needs_features: ClassVar[bool] = False
    targets: tuple[Reference, ...] = ()
    _parts: BuildCache | None = None

    def use(self, parameters: Parameters, images: Sequence[TargetImage]) -> None:
        """See `Stage.use`; what does not depend on the parameters that have changed is used again."""
        reading = self._reading_for(parameters)
        parts = BuildCache(self._parts)
        self.targets = (prepare_references if self.needs_features else make_references)(images, parameters, parts)
        self._prepare(parameters, parts)
        parts.settle()
        self._parts = parts
        self.reading, self.parameters = reading, parameters

    def _prepare(self, parameters: Parameters, parts: BuildCache) -> None:
        """Make what the stage needs of its targets."""


def picture_feed(node: Node, name: str) -> Feed:
    """Return a feed of pictures of another stage, reliable: across a network a large one would seldom arrive whole."""
    return Feed(name, node.resolve_topic_name(name), IMAGE_TYPE, output_qos())


def cloud_feed(node: Node, name: str) -> Feed:
    """Return a feed of point clouds of another stage."""
    return Feed(name, node.resolve_topic_name(name), CLOUD_TYPE, output_qos(_CLOUD_DEPTH))


def camera_info_beside(node: Node, feed: Feed, parameters: Parameters) -> str:
    """Return the camera_info topic beside a feed's, unless it is remapped itself; "" when a file is used instead."""
    return "" if parameters.camera.info_file else reduced_info_beside(node, feed, "camera_info")


def reduced_info_beside(node: Node, feed: Feed, own: str) -> str:
    """Return the topic beside a feed's that says what part of a frame it shows, unless `own` is remapped itself."""
    topic = node.resolve_topic_name(own)
    if topic == node.resolve_topic_name(own, only_expand=True):
        return feed.topic.rpartition("/")[0] + "/camera_info"
    return topic


def frame_without_image(header: Header, read: CameraReading = NO_CAMERA) -> Frame:
    """Return the frame of which other stages have seen the pixels, with what became of its camera_info."""
    return Frame(_NO_IMAGE, header.stamp_ns, header.frame_id, read.camera, read.reason, read.remarks)


def unusable(read: CameraReading) -> tuple[str, ...]:
    """Return the remark that a camera_info cannot be used; empty when it can, or there is none."""
    return (f"uncalibrated: {read.reason}; homographies, no poses",) if read.reason else ()


_NO_IMAGE = RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO))
