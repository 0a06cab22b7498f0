# SPDX-License-Identifier: Apache-2.0
"""Input of a stage node: the messages of one frame from several topics, and the camera_info that belongs to them."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from imgu_ros.messages.header import Header, decode_header
from imgu_ros.ros.frame_input import FrameInput
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.graph_checks import Wanted, why_not_offered
from imgu_ros.ros.reach import another_user, has_no_names

#: A topic that has had no publisher for so long is absent.
_ABSENT_S = 2.0
_DISCOVERY_S = 1.0
#: Frames whose messages are waited for; an image may be some megabytes.
_MOST_WAITING = 12


@dataclass(frozen=True, slots=True)
class Feed:
    """A topic that a stage subscribes to.

    Attributes
    ----------
    name : as the stage calls it; the left side of a remap rule
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
    """Inputs of a stage: its feeds, and the resolved topic of camera_info, "" for none."""

    feeds: tuple[Feed, ...]
    camera_info: str = ""


#: Returns whether the messages of a frame, by the names of their feeds, are complete; the second: absent feeds.
IsComplete = Callable[[Mapping[str, Any], Set[str]], bool]


class StageInput(FrameInput):
    """Subscribes to the feeds of a stage and collects the messages of each frame: equal stamp, equal frame_id.

    Parameters
    ----------
    node : creates the subscriptions
    topics : what is subscribed
    is_complete : tells when a frame can be processed

    Attributes
    ----------
    topics : as given
    """

    def __init__(self, node: Node, topics: StageTopics, is_complete: IsComplete) -> None:
        super().__init__(node, topics.camera_info)
        self.topics = topics
        self._is_complete = is_complete
        self._waiting: OrderedDict[Header, dict[str, Any]] = OrderedDict()
        self._incomplete = 0
        self._came_s: dict[str, float] = {}
        self._absent: frozenset[str] = frozenset()

    def change(self, topics: StageTopics) -> None:
        """Take other topics from the next `open` on."""
        self.close()
        self.topics = topics
        self._info_topic, self._expects_camera_info = topics.camera_info, bool(topics.camera_info)

    @property
    def input_topics(self) -> list[str]:
        """See `FrameInput.input_topics`."""
        return [feed.topic for feed in self.topics.feeds]

    @property
    def incomplete(self) -> int:
        """Frames that were given up because a newer one of the same camera was complete before them."""
        return self._incomplete

    @property
    def absent(self) -> Set[str]:
        """The feeds that have no publisher."""
        return self._absent

    def close(self) -> None:
        """See `FrameInput.close`."""
        super().close()
        self._waiting.clear()

    def check_waiting(self) -> None:
        """Process frames without messages that do not come; to be called a few times a second."""
        now = time.monotonic()
        if self.open_s(now) > _ABSENT_S:
            absent = frozenset(f.name for f in self.topics.feeds if not self._node.count_publishers(f.topic))
            if absent != self._absent:
                self._absent = absent
                for header in list(self._waiting):
                    self._complete(header, now)
        super().check_waiting()

    def why_silent(self) -> str:
        """Return why there is nothing to work on; empty when there is, or may still be."""
        now = time.monotonic()
        if self.silent_s(now) < _DISCOVERY_S:
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
        topics = ", ".join(feed.topic for feed in self.topics.feeds)
        return f"stamps and frame_ids of {topics} do not pair; need equal ones"

    def _begin(self) -> None:
        self._came_s = {}
        self._absent = frozenset()

    def _subscribe_inputs(self) -> None:
        for feed in self.topics.feeds:
            self._subscribe(feed.topic, feed.type_name, partial(self._on_message, feed), feed.qos, self.counters)

    def _on_message(self, feed: Feed, data: bytes) -> None:
        message, _ = self._read_input(feed.topic, feed.type_name, data)
        if message is None:
            return
        header = decode_header(message)
        if self.standstill.is_old(header.stamp_ns):
            if feed is self.topics.feeds[0]:
                self.queue.skip()
            return
        now = time.monotonic()
        self._came_s[feed.name] = now
        self._waiting.setdefault(header, {})[feed.name] = message
        self._complete(header, now)
        while len(self._waiting) > _MOST_WAITING:
            self._waiting.popitem(last=False)
            self._incomplete += 1

    def _complete(self, header: Header, now: float) -> None:
        """Hand a frame over when all its messages are there; earlier ones of its camera are not waited for any more."""
        messages = self._waiting.get(header)
        if messages is None or not self._is_complete(messages, self._absent):
            return
        for earlier in [one for one in self._waiting if one.frame_id == header.frame_id]:
            del self._waiting[earlier]
            if earlier == header:
                break
            self._incomplete += 1
        self._pair(header.stamp_ns, FrameMessages(messages, None, now, header.frame_id))
