# SPDX-License-Identifier: Apache-2.0
"""Source of a node's frames: subscriptions on demand, pairing with camera_info, and a queue to the worker."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from imgu_ros.config.parameters import DEFAULT_LIMITS
from imgu_ros.errors import BagError
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.pairing import Pair, Pairing
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.message_bytes import message_from_bytes, prepare
from imgu_ros.ros.messages import message_class
from imgu_ros.ros.meters import RateMeter
from imgu_ros.ros.qos import QosCounters, camera_info_qos, overridable, override_names
from imgu_ros.ros.standstill import Standstill

CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"

#: A frame waits so long for its camera_info: where camera_info has a publisher, and where it has none.
_PATIENCE_S = 1.0
_SHORT_PATIENCE_S = 0.3
#: No camera_info is larger; those of some time are kept.
_INFO_BYTES = 16_384
#: Interval of the warnings of messages that cannot be read.
_REPEAT_S = 10.0


class FrameInput:
    """Subscribes while it is open and puts frames with their camera_info into a queue.

    All methods are for the executor's thread; the worker takes from `queue`. A derived class subscribes in
    `_subscribe_inputs` and gives complete frames to `_pair`.

    Parameters
    ----------
    node : creates the subscriptions
    camera_info_topic : resolved; empty when frames go without camera_info

    Attributes
    ----------
    queue : where the worker takes from
    standstill : whether the process was suspended; messages from before are skipped
    limits : `message_mb` bounds a message
    arrivals, infos : complete frames and camera_info delivered
    counters : lost messages and incompatible QoS
    """

    def __init__(self, node: Node, camera_info_topic: str) -> None:
        self.standstill = Standstill()
        self.queue: FrameQueue[FrameMessages] = FrameQueue(
            is_old=lambda frame: self.standstill.precedes(frame.received_s), sender=lambda frame: frame.frame_id
        )
        self.limits = DEFAULT_LIMITS
        self.arrivals = RateMeter()
        self.infos = RateMeter()
        self.counters = QosCounters()
        self._node = node
        #: What others publish for the node, by full names, and it may not publish itself.
        self.taken_topics = (camera_info_topic,) if camera_info_topic else ()
        self._info_topic = camera_info_topic
        self._expects_camera_info = bool(camera_info_topic)
        self._pairing: Pairing[FrameMessages, Any] = Pairing(expects_camera_info=self._expects_camera_info)
        self._subscriptions: dict[str, Subscription] = {}
        self._was_overdue = False
        self._opened_s = 0.0
        #: Since when somebody has offered the frames' topic, s; None: nobody does.
        self.offered_since_s: float | None = None
        self._last_s = 0.0

    @property
    def is_open(self) -> bool:
        """Whether the topics are subscribed."""
        return bool(self._subscriptions)

    @property
    def pairing(self) -> Pairing[FrameMessages, Any]:
        """The pairs made since the topics were subscribed last."""
        return self._pairing

    @property
    def input_topics(self) -> list[str]:
        """The topics that are subscribed beside camera_info."""
        raise NotImplementedError

    def qos_override_names(self) -> list[str]:
        """Return the parameters that override the QoS of the inputs."""
        topics = [*self.input_topics, *filter(None, [self._info_topic])]
        return [name for topic in topics for name in override_names(topic, "subscription")]

    def open(self) -> None:
        """Subscribe."""
        if self._subscriptions:
            return
        self._begin()
        self._pairing = Pairing(expects_camera_info=self._expects_camera_info)
        self._opened_s = time.monotonic()
        self.standstill.begin()
        # The small topic first: its subscription should be ready when the first large message comes.
        if self._expects_camera_info:
            self._subscribe_camera_info()
        self._subscribe_inputs()

    def close(self) -> None:
        """Drop the subscriptions and the frames that wait."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self.standstill.end()
        self.queue.clear()

    def check_waiting(self) -> None:
        """Let a frame go that has waited too long for its camera_info; to be called a few times a second."""
        if not self._subscriptions:
            return
        if held_up := self.standstill.news():
            self._node.get_logger().warning(held_up)
        if not self._expects_camera_info:
            return
        expected = self._node.count_publishers(self._info_topic) > 0
        since_s = time.monotonic() - (_PATIENCE_S if expected else _SHORT_PATIENCE_S)
        overdue = self._pairing.is_any(lambda frame: frame.received_s < since_s)
        # Twice in a row: timers come first when the process was held up, and the camera_info may be there already.
        if overdue and self._was_overdue:
            self._hand_over(self._pairing.flush(lambda frame: frame.received_s < since_s))
        self._was_overdue = overdue

    def open_s(self, now_s: float) -> float:
        """Return for how long the topics have been subscribed; 0 while they are not."""
        return now_s - self._opened_s if self.is_open else 0.0

    def silent_s(self, now_s: float) -> float:
        """Return for how long no frame has come although the topics are subscribed."""
        return now_s - max(self._opened_s, self._last_s, self.standstill.ended_s) if self.is_open else 0.0

    def _begin(self) -> None:
        """Drop what was known of the topics before they are subscribed again."""

    def _subscribe_inputs(self) -> None:
        """Subscribe to the topics beside camera_info."""
        raise NotImplementedError

    def _subscribe(
        self, topic: str, type_name: str, receive: Callable[[bytes], None], qos: QoSProfile, counters: QosCounters
    ) -> None:
        prepare(type_name)  # for which no frame should wait
        self._subscriptions[topic] = self._node.create_subscription(
            message_class(type_name),
            topic,
            receive,
            qos,
            event_callbacks=counters.subscription_callbacks(),
            qos_overriding_options=overridable(),
            raw=True,
        )

    def _subscribe_camera_info(self) -> None:
        self._subscribe(
            self._info_topic, CAMERA_INFO_TYPE, self._on_camera_info, camera_info_qos(), self._info_counters()
        )

    def _info_counters(self) -> QosCounters:
        """Return what counts the events of the subscription to camera_info."""
        return self.counters

    def _on_camera_info(self, data: bytes) -> None:
        message, _ = self._read(self._info_topic, CAMERA_INFO_TYPE, data, _INFO_BYTES)
        if message is None:
            return
        self.infos.tick(time.monotonic())
        self._note_camera_info(message)
        header = decode_header(message)
        self._hand_over(self._pairing.add_camera_info(header.stamp_ns, message, header.frame_id))

    def _note_camera_info(self, message: Any) -> None:
        """Take note of a camera_info before it is paired."""

    def _read_input(self, topic: str, type_name: str, data: bytes) -> tuple[Any | None, str]:
        """Return an input's message, or None and why its bytes are none of its type; see `_read`."""
        return self._read(topic, type_name, data, 1_000_000 * self.limits.message_mb, " (limits.message_mb)")

    def _read(
        self, topic: str, type_name: str, data: bytes, most_bytes: int, limit: str = ""
    ) -> tuple[Any | None, str]:
        """Return a message, or None and why its bytes are none of its type.

        A subscription that converts by itself drops what it cannot read without a message.
        """
        try:
            if len(data) > most_bytes:
                raise BagError(f"{len(data) / 1e6:.1f} MB; need at most {most_bytes / 1e6:g}{limit}")
            return message_from_bytes(type_name, data), ""
        except BagError as error:
            said = f"{topic}: {error}"
            self._node.get_logger().warning(said, throttle_duration_sec=_REPEAT_S)
            return None, said

    def _pair(self, stamp_ns: int, frame: FrameMessages) -> None:
        """Take a complete frame."""
        self.arrivals.tick(frame.received_s)
        self._last_s = frame.received_s
        self._hand_over(self._pairing.add_image(stamp_ns, frame, frame.frame_id))

    def _hand_over(self, pairs: list[Pair[FrameMessages, Any]]) -> None:
        for pair in pairs:
            self.queue.put(replace(pair.image, camera_info=pair.camera_info))
