# SPDX-License-Identifier: Apache-2.0
"""What the nodes need of rclpy's events executor, and what they need of the one that stands in for it."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from imgu_ros.ros.messages import message_class
from imgu_ros.ros.process import make_executor
from imgu_ros.ros.qos import image_qos, output_qos

TYPE = "std_msgs/msg/String"


class Spun:
    """A node in an executor, with a publisher of its own to a subscription that takes raw bytes."""

    def __init__(self, domain: int, kind: str) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = Node("spun", context=self.context)
        self.executor = (
            make_executor(self.context) if kind == "events" else SingleThreadedExecutor(context=self.context)
        )
        self.executor.add_node(self.node)
        self.got: list[bytes] = []
        self.publisher = self.node.create_publisher(message_class(TYPE), "frames", output_qos(50))
        self.subscription = self.node.create_subscription(
            message_class(TYPE), "frames", self.got.append, output_qos(50), raw=True
        )
        self.until(self.publisher.get_subscription_count)

    def publish(self, text: str) -> None:
        self.publisher.publish(message_class(TYPE)(data=text))

    def until(self, condition: Callable[[], object], timeout_s: float = 15.0) -> None:
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end
            self.executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self.executor.remove_node(self.node)
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture(params=["events", "single-threaded"])
def spun(ros_domain: int, request: pytest.FixtureRequest) -> Iterator[Spun]:
    made = Spun(ros_domain, request.param)
    yield made
    made.close()


def test_messages_timers_and_services_in_turn(spun: Spun) -> None:
    ticks: list[float] = []
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    timer = spun.node.create_timer(0.02, lambda: ticks.append(time.monotonic()), clock=steady)
    served: list[int] = []
    spun.node.create_service(Trigger, "serve", lambda _, response: served.append(1) or response)
    client = spun.node.create_client(Trigger, "serve")
    spun.until(client.service_is_ready)
    call = client.call_async(Trigger.Request())
    for index in range(50):
        spun.publish(f"{index:03}")
    spun.until(lambda: len(spun.got) == 50 and call.done())
    assert [bytes(data)[-4:-1] for data in spun.got] == [f"{index:03}".encode() for index in range(50)]
    assert all(isinstance(data, bytes) for data in spun.got)
    assert served == [1]
    count = len(ticks)
    spun.until(lambda: len(ticks) >= count + 5)
    # The period of a timer may change.
    timer.timer_period_ns = 200_000_000
    spun.until(lambda: ticks[-1] - ticks[-2] > 0.15)


def test_an_error_in_a_callback_is_raised_and_the_next_callbacks_are_called(spun: Spun) -> None:
    def fail(*_: object) -> None:
        raise ValueError("callback")

    other = spun.node.create_subscription(message_class(TYPE), "frames", fail, output_qos(50))
    spun.until(lambda: spun.publisher.get_subscription_count() == 2)
    spun.publish("a")
    with pytest.raises(ValueError, match="callback"):
        spun.until(lambda: False, timeout_s=5)
    spun.node.destroy_subscription(other)
    spun.publish("b")
    spun.until(lambda: len(spun.got) >= 2)
    spun.node.create_service(Trigger, "failing", fail)
    client = spun.node.create_client(Trigger, "failing")
    spun.until(client.service_is_ready)
    client.call_async(Trigger.Request())
    with pytest.raises(ValueError, match="callback"):
        spun.until(lambda: False, timeout_s=5)
    spun.publish("c")
    spun.until(lambda: len(spun.got) >= 3)


def test_a_task_of_another_thread_ends_a_wait(spun: Spun) -> None:
    """So a signal ends the node's wait, and a service's work is finished in the executor's thread."""
    spun.executor.spin_once(timeout_sec=0.01)
    called: list[int] = []
    threading.Timer(0.2, lambda: spun.executor.create_task(lambda: called.append(threading.get_ident()))).start()
    started = time.monotonic()
    while not called:
        spun.executor.spin_once(timeout_sec=20)
    assert time.monotonic() - started < 10
    assert called == [threading.get_ident()]


def test_subscriptions_come_and_go_while_messages_do(spun: Spun) -> None:
    """In a callback, as the nodes do, while another thread publishes."""
    done = threading.Event()

    def pump() -> None:
        while not done.is_set():
            spun.publish("x" * 10_000)
            time.sleep(0.001)

    subscriptions = [spun.subscription]
    toggles: list[int] = []

    def toggle() -> None:
        toggles.append(1)
        if subscriptions:
            spun.node.destroy_subscription(subscriptions.pop())
        else:
            subscriptions.append(
                spun.node.create_subscription(message_class(TYPE), "frames", spun.got.append, output_qos(50), raw=True)
            )

    timer = spun.node.create_timer(0.02, toggle)
    pumping = threading.Thread(target=pump)
    pumping.start()
    try:
        spun.until(lambda: len(toggles) >= 60)
    finally:
        done.set()
        pumping.join(10)
    spun.node.destroy_timer(timer)
    assert spun.got
    for subscription in subscriptions:
        spun.node.destroy_subscription(subscription)
    spun.until(lambda: not spun.publisher.get_subscription_count())


def test_events_of_a_subscription_are_told(spun: Spun) -> None:
    told: list[str] = []
    publisher = spun.node.create_publisher(message_class(TYPE), "sparse", image_qos())
    spun.node.create_subscription(
        message_class(TYPE), "sparse", lambda _: None, output_qos(5),
        event_callbacks=SubscriptionEventCallbacks(incompatible_qos=lambda _: told.append("incompatible")),
    )  # fmt: skip
    spun.until(lambda: told)
    assert publisher.get_subscription_count() == 0


def test_a_clock_of_its_own(spun: Spun) -> None:
    """With use_sim_time the node's clock follows /clock."""
    publisher = spun.node.create_publisher(ClockMessage, "/clock", output_qos(5))
    spun.node.set_parameters([Parameter("use_sim_time", value=True)])
    message = ClockMessage()
    message.clock.sec = 100
    spun.until(publisher.get_subscription_count)

    def follows() -> bool:
        publisher.publish(message)
        return bool(spun.node.get_clock().now().nanoseconds == 100_000_000_000)

    spun.until(follows)


def test_the_single_threaded_executor_stands_in(ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the events executor in an older rclpy, and with a closed stderr, which its faulthandler refuses."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain)
    try:
        assert not isinstance(make_executor(context), SingleThreadedExecutor)
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, "rclpy.experimental", None)
            assert isinstance(make_executor(context), SingleThreadedExecutor)
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stderr", None)
            assert isinstance(make_executor(context), SingleThreadedExecutor)
    finally:
        context.try_shutdown()
