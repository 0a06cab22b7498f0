# SPDX-License-Identifier: Apache-2.0
"""Callbacks of frames and of everything else, from one thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.node import Node
from std_srvs.srv import Trigger

from imgu_ros.ros.messages import message_class
from imgu_ros.ros.qos import output_qos
from imgu_ros.ros.spinning import Spinner

TYPE = "std_msgs/msg/String"


@pytest.fixture
def node(ros_domain: int) -> Iterator[Node]:
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain)
    made = Node("spun", context=context)
    yield made
    made.destroy_node()
    context.try_shutdown()


class Spun:
    """A spinner with a subscription in a group, fed by a publisher of the same node."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.spinner = Spinner(node)
        self.group = MutuallyExclusiveCallbackGroup()
        self.got: list[str] = []
        self.publisher = node.create_publisher(message_class(TYPE), "frames", output_qos(50))
        self.subscription = node.create_subscription(
            message_class(TYPE), "frames", lambda m: self.got.append(m.data), output_qos(50), callback_group=self.group
        )

    def until(self, condition: Callable[[], object], *, with_group: bool = True, timeout_s: float = 15.0) -> None:
        end = time.monotonic() + timeout_s
        timer = self.node.create_timer(0.05, lambda: None)  # without a group a spin waits for something
        while not condition():
            assert time.monotonic() < end
            self.spinner.spin_once(self.group if with_group else None)
        self.node.destroy_timer(timer)


@pytest.fixture
def spun(node: Node) -> Iterator[Spun]:
    made = Spun(node)
    yield made
    made.spinner.close()


@pytest.mark.parametrize("with_group", [True, False])
def test_frames_come_in_order_and_nothing_else_waits_long(spun: Spun, with_group: bool) -> None:
    ticks: list[float] = []
    spun.node.create_timer(0.02, lambda: ticks.append(time.monotonic()))
    served: list[int] = []
    spun.node.create_service(Trigger, "serve", lambda _, response: served.append(1) or response)
    client = spun.node.create_client(Trigger, "serve")
    spun.until(spun.publisher.get_subscription_count, with_group=with_group)
    spun.until(client.service_is_ready, with_group=with_group)
    call = client.call_async(Trigger.Request())
    sent = [str(index) for index in range(100)]
    for text in sent:
        spun.publisher.publish(message_class(TYPE)(data=text))
        if int(text) % 10 == 0:
            spun.until(lambda last=text: last in spun.got, with_group=with_group)
    spun.until(lambda: len(spun.got) == 100, with_group=with_group)
    assert spun.got == sent
    spun.until(call.done, with_group=with_group)
    assert served == [1]
    count = len(ticks)
    spun.until(lambda: len(ticks) >= count + 5, with_group=with_group)


def test_without_the_group_a_destroyed_subscription_is_gone(spun: Spun) -> None:
    spun.until(spun.publisher.get_subscription_count)
    spun.publisher.publish(message_class(TYPE)(data="a"))
    spun.until(lambda: spun.got)
    spun.node.destroy_subscription(spun.subscription)
    spun.until(lambda: not spun.publisher.get_subscription_count(), with_group=False)
    assert spun.got == ["a"]


def test_what_a_callback_raises_is_raised(spun: Spun) -> None:
    def fail(message: object) -> None:
        raise ValueError("callback")

    spun.node.create_subscription(message_class(TYPE), "frames", fail, output_qos(50), callback_group=spun.group)
    spun.until(lambda: spun.publisher.get_subscription_count() == 2)
    spun.publisher.publish(message_class(TYPE)(data="a"))
    with pytest.raises(ValueError, match="callback"):
        spun.until(lambda: False, timeout_s=5)


def test_a_wake_ends_a_wait_and_does_no_harm_afterwards(spun: Spun) -> None:
    for _ in range(200):
        waiting = threading.Thread(target=spun.spinner.spin_once, args=(spun.group,))
        waiting.start()
        spun.spinner.wake()
        waiting.join(10)
        assert not waiting.is_alive()
    stop = threading.Event()

    def keep_waking() -> None:
        while not stop.is_set():
            spun.spinner.wake()

    waking = threading.Thread(target=keep_waking)
    waking.start()
    try:
        timer = spun.node.create_timer(0.001, lambda: None)
        for index in range(200):
            spun.spinner.spin_once(spun.group if index % 2 else None)
        assert waking.is_alive()
    finally:
        stop.set()
        waking.join(10)
        spun.node.destroy_timer(timer)


def test_a_group_may_lose_and_get_subscriptions_while_it_is_waited_for(spun: Spun) -> None:
    spun.until(spun.publisher.get_subscription_count)
    others: list[str] = []
    other = spun.node.create_subscription(
        message_class(TYPE), "others", lambda m: others.append(m.data), output_qos(50), callback_group=spun.group
    )
    publisher = spun.node.create_publisher(message_class(TYPE), "others", output_qos(50))
    spun.until(publisher.get_subscription_count)
    publisher.publish(message_class(TYPE)(data="a"))
    spun.until(lambda: others)
    spun.node.destroy_subscription(other)
    spun.publisher.publish(message_class(TYPE)(data="b"))
    spun.until(lambda: spun.got)
    spun.node.destroy_subscription(spun.subscription)
    spun.spinner.spin_once(spun.group)  # of an empty group only time ends the wait
    assert (others, spun.got) == (["a"], ["b"])
