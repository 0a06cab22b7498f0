# SPDX-License-Identifier: Apache-2.0
"""Input of a stage node: the messages of one stamp from several topics, and the camera_info that goes with them."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from imgu_ros.config.parameters import DEFAULT_LIMITS
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.pairing import Pair, Pairing
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.graph_checks import Wanted, why_not_offered
from imgu_ros.ros.messages import message_class
from imgu_ros.ros.meters import RateMeter
from imgu_ros.ros.qos import QosCounters, camera_info_qos, overridable, override_names
from imgu_ros.ros.reach import another_user, has_no_names
from imgu_ros.ros.standstill import Standstill

CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"

#: What has not come by then is gone on without: where somebody publishes camera_info, and where nobody.
_PATIENCE_S = 1.0
_SHORT_PATIENCE_S = 0.3
#: A topic that nobody has published for so long is absent.
_ABSENT_S = 2.0
_DISCOVERY_S = 1.0
#: Between two warnings of messages that are too large.
_REPEAT_S = 10.0
#: Stamps whose messages are waited for; a picture may be some megabytes.
_MOST_WAITING = 12


@dataclass(frozen=True, slots=True)
class Feed:
    """A topic that a stage takes.

    Attributes
    ----------
    name : as the stage calls it, and what is to be remapped for another topic
    topic : resolved
    type_name : "package/msg/Name"
    qos : of the subscription
    """

    name: str
    topic: str
    type_name: str
    qos: QoSProfile


@dataclass(frozen=True, slots=True)
class StageTopics:
    """What a stage takes: its feeds, and the resolved topic of camera_info, "" for none."""

    feeds: tuple[Feed, ...]
    camera_info: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class StageJob:
    """Messages of one stamp, by the names of their feeds, their camera_info or None, and when the last one came."""

    messages: Mapping[str, Any]
    camera_info: Any | None
    received_s: float


#: Whether messages, by the names of their feeds, are all that there will be; the second: feeds that nobody publishes.
IsComplete = Callable[[Mapping[str, Any], Set[str]], bool]


class StageInput:
    """Subscribes while it is open, and puts the newest complete set of messages into a slot.

    All methods are for the executor's thread.

    Parameters
    ----------
    node : creates the subscriptions
    topics : what is subscribed
    is_complete : tells when a set can be worked on
    slot : where the worker takes from
    standstill : whether the process stood still; what is from before is skipped

    Attributes
    ----------
    arrivals : complete sets
    counters : lost messages and incompatible QoS
    group : of the subscriptions' callbacks
    topics : as given
    limits : `message_mb` bounds the data of a message
    """

    def __init__(
        self,
        node: Node,
        topics: StageTopics,
        is_complete: IsComplete,
        slot: FrameQueue[StageJob],
        standstill: Standstill,
    ) -> None:
        self.arrivals = RateMeter()
        self.counters = QosCounters()
        self.group = MutuallyExclusiveCallbackGroup()
        self.topics = topics
        self.limits = DEFAULT_LIMITS
        self._node = node
        self._is_complete = is_complete
        self._slot = slot
        self.standstill = standstill
        self._subscriptions: list[Subscription] = []
        self._waiting: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self._pairing: Pairing[StageJob, Any] = Pairing(expects_camera_info=bool(topics.camera_info))
        self._incomplete = 0
        self._was_overdue = False
        self._opened_s = 0.0
        self._last_s = 0.0
        self._came_s: dict[str, float] = {}
        self._absent: frozenset[str] = frozenset()

    @property
    def is_open(self) -> bool:
        """Whether the topics are subscribed."""
        return bool(self._subscriptions)

    @property
    def incomplete(self) -> int:
        """Stamps that were given up, as a newer one was complete before them."""
        return self._incomplete

    @property
    def absent(self) -> Set[str]:
        """The feeds that nobody publishes."""
        return self._absent

    def qos_override_names(self) -> list[str]:
        """Return the parameters that override the QoS of the inputs."""
        topics = [feed.topic for feed in self.topics.feeds]
        topics += [self.topics.camera_info] if self.topics.camera_info else []
        return [name for topic in topics for name in override_names(topic, "subscription")]

    def open(self) -> None:
        """Subscribe."""
        if self._subscriptions:
            return
        self._opened_s = time.monotonic()
        self.standstill.begin()
        self._came_s = {}
        self._absent = frozenset()
        self._pairing = Pairing(expects_camera_info=bool(self.topics.camera_info))
        # The small topics first: their subscriptions should be ready when the first large message comes.
        if self.topics.camera_info:
            self._subscribe(CAMERA_INFO_TYPE, self.topics.camera_info, self._on_camera_info, camera_info_qos())
        for feed in self.topics.feeds:
            self._subscribe(feed.type_name, feed.topic, self._receiver(feed.name), feed.qos)

    def close(self) -> None:
        """Drop the subscriptions and what waits."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self.standstill.end()
        self._waiting.clear()
        self._slot.clear()

    def check_waiting(self) -> None:
        """Go on without what does not come; to be called a few times a second."""
        if not self._subscriptions:
            return
        if held_up := self.standstill.news():
            self._node.get_logger().warning(held_up)
        now = time.monotonic()
        if now - self._opened_s > _ABSENT_S:
            absent = frozenset(f.name for f in self.topics.feeds if not self._node.count_publishers(f.topic))
            if absent != self._absent:
                self._absent = absent
                for stamp_ns in list(self._waiting):
                    self._complete(stamp_ns, now)
        if not self.topics.camera_info:
            return
        expected = self._node.count_publishers(self.topics.camera_info) > 0
        since_s = now - (_PATIENCE_S if expected else _SHORT_PATIENCE_S)
        overdue = self._pairing.is_any(lambda job: job.received_s < since_s)
        # Twice in a row: timers come first when the process was held up, and the camera_info may be there already.
        if overdue and self._was_overdue:
            self._hand_over(self._pairing.flush(lambda job: job.received_s < since_s))
        self._was_overdue = overdue

    def why_silent(self) -> str:
        """Return why there is nothing to work on; empty when there is, or may still be."""
        now = time.monotonic()
        if not self._subscriptions or now - max(self._opened_s, self._last_s, self.standstill.ended_s) < _DISCOVERY_S:
            return ""
        silent = [feed for feed in self.topics.feeds if now - self._came_s.get(feed.name, 0.0) > _DISCOVERY_S]
        for feed in silent:
            cause = why_not_offered(self._node, Wanted(feed.topic, feed.type_name, feed.qos, feed.name))
            if cause is not None:
                return cause.text
        if silent:
            said = f"nothing comes on {', '.join(feed.topic for feed in silent)}, although there is a publisher"
            nameless = has_no_names(self._node.get_publishers_info_by_topic(silent[0].topic))
            why = another_user(nameless=True) if nameless else ""
            return f"{said}: {why}" if why else said
        return f"stamps of {', '.join(feed.topic for feed in self.topics.feeds)} do not pair; need equal ones"

    def _subscribe(self, type_name: str, topic: str, receive: Callable[..., None], qos: QoSProfile) -> None:
        self._subscriptions.append(
            self._node.create_subscription(
                message_class(type_name),
                topic,
                receive,
                qos,
                callback_group=self.group,
                event_callbacks=self.counters.subscription_callbacks(),
                qos_overriding_options=overridable(),
            )
        )

    def _receiver(self, name: str) -> Callable[[Any, Mapping[str, Any]], None]:
        is_first = name == self.topics.feeds[0].name

        def receive(message: Any, info: Mapping[str, Any]) -> None:
            if self.standstill.is_old(info["source_timestamp"]):
                if is_first:
                    self._slot.skip()
                return
            size = len(getattr(message, "data", ()))
            if size > 1_000_000 * self.limits.message_mb:
                need = f"need at most {self.limits.message_mb} (limits.message_mb)"
                self._node.get_logger().warning(f"{name}: {size / 1e6:.1f} MB; {need}", throttle_duration_sec=_REPEAT_S)
                return
            now = time.monotonic()
            self._came_s[name] = now
            stamp_ns = decode_header(message).stamp_ns
            self._waiting.setdefault(stamp_ns, {})[name] = message
            self._complete(stamp_ns, now)
            while len(self._waiting) > _MOST_WAITING:
                self._waiting.popitem(last=False)
                self._incomplete += 1

        return receive

    def _complete(self, stamp_ns: int, now: float) -> None:
        """Hand a stamp's messages over when all are there; what came before them is not waited for any more."""
        messages = self._waiting.get(stamp_ns)
        if messages is None or not self._is_complete(messages, self._absent):
            return
        while self._waiting:
            oldest, _ = self._waiting.popitem(last=False)
            if oldest == stamp_ns:
                break
            self._incomplete += 1
        self.arrivals.tick(now)
        self._last_s = now
        frame_id = decode_header(next(iter(messages.values()))).frame_id
        self._hand_over(self._pairing.add_image(stamp_ns, StageJob(messages, None, now), frame_id))

    def _on_camera_info(self, message: Any) -> None:
        header = decode_header(message)
        self._hand_over(self._pairing.add_camera_info(header.stamp_ns, message, header.frame_id))

    def _hand_over(self, pairs: list[Pair[StageJob, Any]]) -> None:
        for pair in pairs:
            self._slot.put(StageJob(pair.image.messages, pair.camera_info, pair.image.received_s))
