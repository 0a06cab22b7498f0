# SPDX-License-Identifier: Apache-2.0
"""Messages of one stamp from several topics find each other, whatever the order in which they come."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="needs the ros extra")

from rclpy.serialization import serialize_message

from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.messages.header import Header, decode_header, header_message
from imgu_ros.ros.frame_input import CAMERA_INFO_TYPE
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.qos import output_qos
from imgu_ros.ros.stages import input as stage_input
from imgu_ros.ros.stages.input import Feed, StageInput, StageTopics

CLOUD = "sensor_msgs/msg/PointCloud2"


class Node:
    """Stands for a node: keeps the callbacks of its subscriptions."""

    def __init__(self) -> None:
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.unpublished: set[str] = set()

    def create_subscription(self, _: Any, topic: str, callback: Callable[[Any], None], __: Any, **___: Any) -> str:
        self.callbacks[topic] = callback
        return topic

    def destroy_subscription(self, topic: str) -> None:
        del self.callbacks[topic]

    def count_publishers(self, topic: str) -> int:
        return int(topic not in self.unpublished)


class Rig:
    """An input of topics a and b, and what it hands over."""

    def __init__(self, camera_info: str = "", b_may_lack: bool = False) -> None:
        self.node = Node()
        feeds = tuple(Feed(name, f"/{name}", CLOUD, output_qos()) for name in "ab")
        complete = lambda got, absent: "a" in got and ("b" in got or (b_may_lack and "b" in absent))  # noqa: E731
        topics = StageTopics(feeds, camera_info)
        self.input = StageInput(self.node, topics, complete)  # type: ignore[arg-type]
        self.input.queue = FrameQueue(patience_s=1e9, sender=lambda frame: frame.frame_id)
        self.input.open()

    def tell(self, name: str, stamp_ns: int, frame_id: str = "camera") -> list[int]:
        """Let a message come; return the stamps of what was handed over."""
        type_name = CAMERA_INFO_TYPE if name == "info" else CLOUD
        header = header_message(make_message, Header(stamp_ns, frame_id))
        self.node.callbacks[f"/{name}"](serialize_message(make_message(type_name, header=header)))
        return [decode_header(job.messages["a"]).stamp_ns for job in self.taken()]

    def taken(self) -> list[FrameMessages]:
        jobs = [job for sender in self.input.queue._senders.values() for job in sender.waiting]
        self.input.queue.clear()
        return jobs


@given(st.permutations([(name, stamp) for name in "ab" for stamp in range(5)]))
def test_each_stamp_is_handed_over_once_unless_a_newer_one_overtook_it(order):
    rig, seen, done = Rig(), set(), []
    for name, stamp in order:
        seen.add((name, stamp))
        given_out = rig.tell(name, stamp)
        assert given_out in ([], [stamp])
        assert all({("a", s), ("b", s)} <= seen for s in given_out)
        done += given_out
    assert len(set(done)) == len(done)
    assert done, "the last message completes something, or did before"
    assert rig.input.arrivals.count == len(done)


def test_stamps_that_jump_back_begin_anew():
    rig = Rig()
    rig.tell("a", 100)
    assert rig.tell("b", 100) == [100]
    rig.tell("a", 5)
    assert rig.tell("b", 5) == [5]


def test_what_never_becomes_complete_is_forgotten():
    rig = Rig()
    for stamp in range(100):
        rig.tell("b", stamp)
    assert rig.input.incomplete == 100 - stage_input._MOST_WAITING
    assert rig.tell("a", 50) == []
    assert rig.tell("a", 99) == [99]


def test_cameras_are_told_apart_by_frame_id():
    """Equal stamps of two cameras are two frames; a complete frame gives up earlier ones of its own camera alone."""
    rig = Rig()
    assert rig.tell("a", 1, "left") == []
    assert rig.tell("b", 1, "right") == []
    rig.tell("a", 2, "right")
    assert rig.tell("b", 2, "right") == [2]
    assert rig.input.incomplete == 1
    assert rig.tell("b", 1, "left") == [1]
    assert rig.input.incomplete == 1


def test_other_topics_from_the_next_opening_on():
    rig = Rig()
    topics = StageTopics((Feed("a", "/elsewhere", CLOUD, output_qos()),), "/info")
    rig.input.change(topics)
    assert not rig.node.callbacks
    rig.input.open()
    assert rig.node.callbacks.keys() == {"/elsewhere", "/info"}


def test_camera_info_goes_with_its_stamp():
    rig = Rig("/info")
    rig.tell("info", 1)
    rig.tell("a", 1)
    rig.tell("b", 1)
    rig.tell("a", 2)
    assert rig.tell("b", 2) == []
    assert rig.tell("info", 2) == [2]


def test_a_topic_that_nobody_publishes_is_done_without_where_that_may_be(monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(stage_input.time, "monotonic", lambda: now[0])
    rig = Rig(b_may_lack=True)
    rig.node.unpublished.add("/b")
    rig.input.check_waiting()
    assert rig.tell("a", 1) == [], "its publisher may still be found"
    now[0] += 3.0
    rig.input.check_waiting()
    assert [decode_header(job.messages["a"]).stamp_ns for job in rig.taken()] == [1]
    assert rig.tell("a", 2) == [2]
    rig.node.unpublished.clear()
    rig.input.check_waiting()
    assert rig.tell("a", 3) == []
    assert rig.tell("b", 3) == [3]


def test_a_closed_input_holds_nothing():
    rig = Rig("/info")
    rig.tell("a", 1)
    rig.input.close()
    assert not rig.input.is_open
    assert not rig.node.callbacks
    assert not rig.taken()
    assert rig.input.why_silent() == ""


def test_a_message_that_is_too_large_is_passed_over_and_said() -> None:
    rig, said = Rig(), []
    rig.node.get_logger = lambda: SimpleNamespace(warning=lambda text, **_: said.append(text))  # type: ignore[attr-defined]
    rig.input.limits = LimitsParameters(message_mb=1)
    header = header_message(make_message, Header(1, "camera"))
    for size in (1_000_001, 999_000):
        assert rig.input.queue.skipped == 0
        cloud = make_message(CLOUD, header=header, data=np.zeros(size, np.uint8))
        rig.node.callbacks["/a"](serialize_message(cloud))
    assert said == ["/a: 1.0 MB; need at most 1 (limits.message_mb)"]
    assert rig.tell("b", 1) == [1]
