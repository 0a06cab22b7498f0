# SPDX-License-Identifier: Apache-2.0
"""Image input of a node: subscriptions, and pairing with camera_info."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.subscription import Subscription

from imgu_ros.bags.decoding import message_from_cdr
from imgu_ros.bags.messages import typestore
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.header_checks import HeaderChecks
from imgu_ros.messages.image import data_bytes
from imgu_ros.messages.pairing import Pair, Pairing
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.graph_checks import Wanted
from imgu_ros.ros.messages import message_class
from imgu_ros.ros.meters import RateMeter
from imgu_ros.ros.middleware import large_message_warnings
from imgu_ros.ros.qos import QosCounters, camera_info_qos, image_qos, overridable, override_names
from imgu_ros.ros.standstill import Standstill

#: An image whose camera_info has not come by then goes without: where somebody publishes camera_info, and where nobody.
_PATIENCE_S = 1.0
_SHORT_PATIENCE_S = 0.3
#: More is no camera_info: those of some time are kept.
_INFO_BYTES = 16_384
#: Between two warnings of messages that cannot be read.
_REPEAT_S = 10.0

CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
_IMAGE_TYPES = {"raw": "sensor_msgs/msg/Image", "compressed": "sensor_msgs/msg/CompressedImage"}


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """An image message, its camera_info message or None, when the image came (monotonic seconds), and its frame_id."""

    image: Any
    camera_info: Any | None
    received_s: float
    frame_id: str = ""


@dataclass(frozen=True, slots=True)
class InputTopics:
    """Resolved topic names, the image's type, and what is to be remapped for another image topic."""

    image: str
    camera_info: str
    image_type: str
    image_remap: str = "image_raw"


class ImageInput:
    """Subscribes while it is open and puts the newest image with its camera_info into a slot.

    All methods are for the executor's thread; the worker reads `slot`.

    Parameters
    ----------
    node : creates the subscriptions
    transport : "raw" or "compressed"

    Attributes
    ----------
    slot : where the worker takes from
    standstill : whether the process stood still; what is from before is skipped
    limits : `message_mb` bounds an image
    arrivals, infos : images and camera_info delivered
    counters : lost messages and incompatible QoS
    unread : image messages that could not be read
    unreadable : why the last image message could not be read; "" when it could
    topics : what is subscribed
    headers : what is odd about the headers of images and camera_info, since the topics were subscribed last
    group : of the subscriptions' callbacks
    """

    def __init__(self, node: Node, transport: str) -> None:
        self.standstill = Standstill()
        self.slot: FrameQueue[Job] = FrameQueue(
            is_old=lambda job: self.standstill.precedes(job.received_s), sender=lambda job: job.frame_id
        )
        self.limits = LimitsParameters()
        self.arrivals = RateMeter()
        self.infos = RateMeter()
        self.counters = QosCounters()
        self.unreadable = ""
        self.unread = 0
        self.topics = input_topics(node, transport)
        self.headers = HeaderChecks(self.topics.image, self.topics.camera_info)
        self.group = MutuallyExclusiveCallbackGroup()
        self._node = node
        for type_name in (self.topics.image_type, CAMERA_INFO_TYPE):
            typestore().get_msgdef(type_name)  # made at the first use, for which no frame should wait
        self._expects_camera_info = True
        self._pairing: Pairing[Job, Any] = Pairing()
        self._unmatched_before = 0
        self._image: Subscription | None = None
        self._camera_info: Subscription | None = None
        self._was_overdue = False
        self._opened_s = 0.0
        self._last_s = 0.0
        self._warned_of_size = False

    @property
    def is_open(self) -> bool:
        """Whether the topics are subscribed."""
        return self._image is not None

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

    @property
    def pairing(self) -> Pairing[Job, Any]:
        """The pairs made since the topics were subscribed last."""
        return self._pairing

    def qos_override_names(self) -> list[str]:
        """Return the parameters that override the QoS of the inputs."""
        names = override_names(self.topics.image, "subscription")
        return names + override_names(self.topics.camera_info, "subscription")

    def open(self) -> None:
        """Subscribe."""
        if self._image is not None:
            return
        self._unmatched_before += self._pairing.unmatched
        self._pairing = Pairing(expects_camera_info=self._expects_camera_info)
        self.headers = HeaderChecks(self.topics.image, self.topics.camera_info)
        self._opened_s = time.monotonic()
        self.standstill.begin()
        # The small topic first: its subscription should be ready when the first image comes.
        if self._expects_camera_info:
            self._camera_info = self._subscribed_camera_info()
        self._image = self._node.create_subscription(
            message_class(self.topics.image_type),
            self.topics.image,
            cast(Any, self._on_image),  # rclpy gives the message's info to who takes two arguments
            image_qos(),
            callback_group=self.group,
            event_callbacks=self.counters.subscription_callbacks(),
            qos_overriding_options=overridable(),
            raw=True,
        )

    def expect_camera_info(self, expected: bool) -> None:
        """Pair images with camera_info, or let each pass at once, alone: when the camera is known from a file."""
        if expected == self._expects_camera_info:
            return
        self._expects_camera_info = expected
        if self._image is None:
            return
        self._hand_over(self._pairing.flush())
        self._unmatched_before += self._pairing.unmatched
        self._pairing = Pairing(expects_camera_info=expected)
        if expected:
            self._camera_info = self._subscribed_camera_info()
        elif self._camera_info is not None:
            self._node.destroy_subscription(self._camera_info)
            self._camera_info = None

    def close(self) -> None:
        """Drop the subscriptions and what waits."""
        for subscription in (self._image, self._camera_info):
            if subscription is not None:
                self._node.destroy_subscription(subscription)
        self._image = self._camera_info = None
        self.standstill.end()
        self.unreadable = ""
        self.slot.clear()

    def check_waiting(self) -> None:
        """Let an image go that has waited too long for its camera_info; to be called a few times a second."""
        if self._image is None:
            return
        if held_up := self.standstill.news():
            self._node.get_logger().warning(held_up)
        expected = self._node.count_publishers(self.topics.camera_info) > 0
        since_s = time.monotonic() - (_PATIENCE_S if expected else _SHORT_PATIENCE_S)
        overdue = self._pairing.is_any(lambda job: job.received_s < since_s)
        # Twice in a row: timers come first when the process was held up, and the camera_info may be there already.
        if overdue and self._was_overdue:
            self._hand_over(self._pairing.flush(lambda job: job.received_s < since_s))
        self._was_overdue = overdue

    def open_s(self, now_s: float) -> float:
        """Return for how long the topics have been subscribed; 0 while they are not."""
        return now_s - self._opened_s if self.is_open else 0.0

    def silent_s(self, now_s: float) -> float:
        """Return for how long no image has come although the topics are subscribed."""
        return now_s - max(self._opened_s, self._last_s, self.standstill.ended_s) if self.is_open else 0.0

    def wanted_images(self) -> Wanted:
        """Return what the image subscription asks for; RuntimeError while there is none."""
        return _wanted(self._image, self.topics.image, self.topics.image_type, self.topics.image_remap)

    def wanted_camera_info(self) -> Wanted:
        """Return what the camera_info subscription asks for; RuntimeError while there is none."""
        return _wanted(self._camera_info, self.topics.camera_info, CAMERA_INFO_TYPE, "camera_info")

    def _subscribed_camera_info(self) -> Subscription:
        return self._node.create_subscription(
            message_class(CAMERA_INFO_TYPE),
            self.topics.camera_info,
            self._on_camera_info,
            camera_info_qos(),
            callback_group=self.group,
            event_callbacks=QosCounters().subscription_callbacks(),
            qos_overriding_options=overridable(),
            raw=True,
        )

    def _on_image(self, data: bytes, info: Mapping[str, Any]) -> None:
        if self.standstill.is_old(info["source_timestamp"]):
            self.slot.skip()
            return
        most_bytes = 1_000_000 * self.limits.message_mb
        message, self.unreadable = self._read(
            self.topics.image, self.topics.image_type, data, most_bytes, " (limits.message_mb)"
        )
        if message is None:
            self.unread += 1
            return
        now = time.monotonic()
        self._last_s = now
        self.arrivals.tick(now)
        if not self._warned_of_size:
            self._warned_of_size = True
            for warning in large_message_warnings(len(data_bytes(message))):
                self._node.get_logger().warning(warning)
        self.headers.add_image(message)
        header = decode_header(message)
        self._hand_over(
            self._pairing.add_image(header.stamp_ns, Job(message, None, now, header.frame_id), header.frame_id)
        )

    def _on_camera_info(self, data: bytes) -> None:
        message, _ = self._read(self.topics.camera_info, CAMERA_INFO_TYPE, data, _INFO_BYTES)
        if message is None:
            return
        self.infos.tick(time.monotonic())
        self.headers.add_camera_info(message)
        header = decode_header(message)
        self._hand_over(self._pairing.add_camera_info(header.stamp_ns, message, header.frame_id))

    def _read(
        self, topic: str, type_name: str, data: bytes, most_bytes: int, limit: str = ""
    ) -> tuple[Any | None, str]:
        """Return a message, or None and why its bytes are none of its type.

        rclpy's own conversion copies an image's pixels twice more, and passes over what it cannot read without a word.
        """
        try:
            if len(data) > most_bytes:
                raise BagError(f"{len(data) / 1e6:.1f} MB; need at most {most_bytes / 1e6:g}{limit}")
            return message_from_cdr(type_name, data), ""
        except BagError as error:
            said = f"{topic}: {error}"
            self._node.get_logger().warning(said, throttle_duration_sec=_REPEAT_S)
            return None, said

    def _hand_over(self, pairs: list[Pair[Job, Any]]) -> None:
        for pair in pairs:
            self.slot.put(replace(pair.image, camera_info=pair.camera_info))


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


def _wanted(subscription: Subscription | None, topic: str, type_name: str, remapped: str) -> Wanted:
    if subscription is None:
        raise RuntimeError(f"{topic}: not subscribed")
    return Wanted(topic, type_name, subscription.qos_profile, remapped)
