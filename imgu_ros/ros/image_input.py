# SPDX-License-Identifier: Apache-2.0
"""Image input of a node: images of one topic, each with its camera_info."""

from __future__ import annotations

import time
from dataclasses import dataclass

from rclpy.node import Node
from rclpy.subscription import Subscription

from imgu_ros.messages.header import decode_header
from imgu_ros.messages.header_checks import HeaderChecks
from imgu_ros.messages.image import data_bytes
from imgu_ros.messages.pairing import Pairing
from imgu_ros.ros.frame_input import CAMERA_INFO_TYPE, FrameInput
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.graph_checks import Wanted
from imgu_ros.ros.middleware import large_message_warnings
from imgu_ros.ros.qos import QosCounters, image_qos

#: Name of the image in `FrameMessages`.
IMAGE = "image_raw"
_IMAGE_TYPES = {"raw": "sensor_msgs/msg/Image", "compressed": "sensor_msgs/msg/CompressedImage"}


@dataclass(frozen=True, slots=True)
class InputTopics:
    """Resolved topic names, the image's type, and what is to be remapped for another image topic."""

    image: str
    camera_info: str
    image_type: str
    image_remap: str = "image_raw"


class ImageInput(FrameInput):
    """Subscribes to images, and to camera_info unless the camera is known from a file.

    Parameters
    ----------
    node : creates the subscriptions
    transport : "raw" or "compressed"

    Attributes
    ----------
    topics : the topics that are subscribed
    headers : what is odd about the headers of images and camera_info, since the topics were subscribed last
    unread : image messages that could not be read
    unreadable : why the last image message could not be read; "" when it could
    """

    def __init__(self, node: Node, transport: str) -> None:
        self.topics = input_topics(node, transport)
        super().__init__(node, self.topics.camera_info)
        self.headers = HeaderChecks(self.topics.image, self.topics.camera_info)
        self.unread = 0
        self.unreadable = ""
        self._unmatched_before = 0
        self._warned_of_size = False

    @property
    def input_topics(self) -> list[str]:
        """See `FrameInput.input_topics`."""
        return [self.topics.image]

    @property
    def expects_camera_info(self) -> bool:
        """Whether camera_info is subscribed with the images."""
        return self._expects_camera_info

    @property
    def camera_info_topic(self) -> str:
        """The topic that the camera comes from; empty when it comes from a file."""
        return self.topics.camera_info if self._expects_camera_info else ""

    @property
    def looks_rectified(self) -> bool:
        """Whether the image topic's name says that its images are rectified."""
        return any("rect" in part for part in self.topics.image.split("/")[-2:])

    @property
    def unmatched(self) -> int:
        """Images that left without a camera_info of their own stamp."""
        return self._unmatched_before + self._pairing.unmatched

    def expect_camera_info(self, expected: bool) -> None:
        """Pair images with camera_info, or let each pass at once, alone: when the camera is known from a file."""
        if expected == self._expects_camera_info:
            return
        self._expects_camera_info = expected
        if not self.is_open:
            return
        self._hand_over(self._pairing.flush())
        self._unmatched_before += self._pairing.unmatched
        self._pairing = Pairing(expects_camera_info=expected)
        if expected:
            self._subscribe_camera_info()
        else:
            self._node.destroy_subscription(self._subscriptions.pop(self.topics.camera_info))

    def close(self) -> None:
        """See `FrameInput.close`."""
        super().close()
        self.unreadable = ""

    def wanted_images(self) -> Wanted:
        """Return what the image subscription asks for; RuntimeError while there is none."""
        return self._wanted(self.topics.image, self.topics.image_type, self.topics.image_remap)

    def wanted_camera_info(self) -> Wanted:
        """Return what the camera_info subscription asks for; RuntimeError while there is none."""
        return self._wanted(self.topics.camera_info, CAMERA_INFO_TYPE, "camera_info")

    def _wanted(self, topic: str, type_name: str, remapped: str) -> Wanted:
        subscription: Subscription | None = self._subscriptions.get(topic)
        if subscription is None:
            raise RuntimeError(f"{topic}: not subscribed")
        return Wanted(topic, type_name, subscription.qos_profile, remapped)

    def _begin(self) -> None:
        self._unmatched_before += self._pairing.unmatched
        self.headers = HeaderChecks(self.topics.image, self.topics.camera_info)

    def _subscribe_inputs(self) -> None:
        self._subscribe(self.topics.image, self.topics.image_type, self._on_image, image_qos(), self.counters)

    def _info_counters(self) -> QosCounters:
        return QosCounters()  # `counters` are those of images

    def _note_camera_info(self, message: object) -> None:
        self.headers.add_camera_info(message)

    def _on_image(self, data: bytes) -> None:
        message, self.unreadable = self._read_input(self.topics.image, self.topics.image_type, data)
        if message is None:
            self.unread += 1
            return
        header = decode_header(message)
        if self.standstill.is_old(header.stamp_ns):
            self.queue.skip()
            return
        if not self._warned_of_size:
            self._warned_of_size = True
            for warning in large_message_warnings(len(data_bytes(message))):
                self._node.get_logger().warning(warning)
        self.headers.add_image(message)
        self._pair(header.stamp_ns, FrameMessages({IMAGE: message}, None, time.monotonic(), header.frame_id))


def input_topics(node: Node, transport: str) -> InputTopics:
    """Return the topics to subscribe, after remapping.

    camera_info is taken from beside the image topic (`/cam/image_raw` -> `/cam/camera_info`) unless it is remapped
    itself. With compressed transport the image topic's name is that of the raw one with `/compressed`, as in
    image_transport, unless that is remapped itself.
    """
    base = node.resolve_topic_name("image_raw")
    image, remap = base, "image_raw"
    if transport == "compressed":
        own = node.resolve_topic_name("image_raw/compressed")
        unmapped = node.resolve_topic_name("image_raw/compressed", only_expand=True)
        image = own if own != unmapped else f"{base}/compressed"
        remap = "image_raw/compressed"
    camera_info = node.resolve_topic_name("camera_info")
    if camera_info == node.resolve_topic_name("camera_info", only_expand=True):
        camera_info = base.rpartition("/")[0] + "/camera_info"
    return InputTopics(image, camera_info, _IMAGE_TYPES[transport], remap)
