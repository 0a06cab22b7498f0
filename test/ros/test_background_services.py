# SPDX-License-Identifier: Apache-2.0
"""Services whose work runs in a thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from imgu_ros.errors import ImguError
from imgu_ros.ros.background_services import _MOST_WAITING, BackgroundAction, BackgroundServices
from imgu_ros.ros.messages import message_class
from imgu_ros.ros.process import make_executor
from imgu_ros.ros.qos import output_qos

PATIENCE_S = 20.0


class Rig:
    """A node with a slow service, a client of it, and frames from a publisher."""

    def __init__(self, node: Node, executor: Any) -> None:
        self.node = node
        self.executor = executor
        executor.add_node(node)
        self.services = BackgroundServices(node)
        self.work: Callable[[], str] = str
        self.finish: Callable[[str], str] = str
        self.begun = 0
        self.frames = threading.Semaphore(0)
        self.frame = message_class("std_msgs/msg/String")()
        self.publisher = node.create_publisher(type(self.frame), "frames", output_qos(10))
        node.create_subscription(type(self.frame), "frames", lambda _: self.frames.release(), output_qos(10))
        self.services.create("slow", self._begin)
        self.client = node.create_client(Trigger, "slow")
        self.until(self.client.service_is_ready)

    def _begin(self) -> BackgroundAction:
        self.begun += 1
        return BackgroundAction(self.work, self.finish)

    def until(self, condition: Callable[[], object]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end
            self.executor.spin_once(timeout_sec=PATIENCE_S / 4)

    def call(self) -> Any:
        answer = self.client.call_async(Trigger.Request())
        self.until(answer.done)
        return answer.result()


@pytest.fixture(params=["events", "single-threaded"])
def rig(ros_domain: int, request: pytest.FixtureRequest) -> Iterator[Rig]:
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain)
    node = Node("slow", context=context)
    executor = make_executor(context) if request.param == "events" else SingleThreadedExecutor(context=context)
    made = Rig(node, executor)
    yield made
    executor.remove_node(node)
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()


def test_callbacks_are_called_while_a_service_works(rig: Rig) -> None:
    """The work ends only when frames come during it; its result is finished in the executor's thread."""
    threads: list[int] = []

    def work() -> str:
        threads.append(threading.get_ident())
        for _ in range(3):
            rig.publisher.publish(rig.frame)
            if not rig.frames.acquire(timeout=PATIENCE_S / 4):
                return "no frame came"
        return "three frames came"

    def finish(result: str) -> str:
        threads.append(threading.get_ident())
        return f"{result}, finished"

    rig.work, rig.finish = work, finish
    answer = rig.call()
    assert (answer.success, answer.message) == (True, "three frames came, finished")
    assert threads[0] != threads[1] == threading.get_ident()


def test_errors_become_the_response(rig: Rig) -> None:
    def fail(*_: object) -> str:
        raise ImguError("poster.png: no such file")

    def break_down(*_: object) -> str:
        raise ValueError("no text\nfor people")

    for rig.work, rig.finish, message in (
        (fail, str, "poster.png: no such file"),
        (str, fail, "poster.png: no such file"),
        (break_down, str, "ValueError: no text for people"),
    ):
        answer = rig.call()
        assert (answer.success, answer.message) == (False, message)
    rig.work, rig.finish = (lambda: "well"), str
    assert rig.call().message == "well"


def test_a_request_that_cannot_begin_is_answered_and_the_next_one_works(rig: Rig) -> None:
    """Also one that waits, whose turn comes in a task: rclpy's events executor does not survive a task that raises."""
    free = threading.Event()
    rig.work = lambda: str(free.wait(PATIENCE_S))
    first = rig.client.call_async(Trigger.Request())
    rig.until(lambda: rig.begun)

    def refuse() -> BackgroundAction:
        raise MemoryError("no memory")

    waiting = rig.client.call_async(Trigger.Request())
    rig.until(lambda: rig.services._waiting)
    request = rig.services._waiting.popleft()
    rig.services._waiting.append(replace(request, begin=refuse))
    free.set()
    rig.until(lambda: first.done() and waiting.done())
    assert (waiting.result().success, waiting.result().message) == (False, "MemoryError: no memory")
    rig.work = lambda: "well"
    assert rig.call().message == "well"


def test_requests_wait_in_order_and_too_many_are_refused(rig: Rig) -> None:
    free = threading.Event()
    rig.work = lambda: str(free.wait(PATIENCE_S))
    first = rig.client.call_async(Trigger.Request())
    rig.until(lambda: rig.begun)
    answers = []
    for count in range(1, _MOST_WAITING + 1):
        answers.append(rig.client.call_async(Trigger.Request()))
        rig.until(lambda count=count: len(rig.services._waiting) == count)
    answers.append(rig.client.call_async(Trigger.Request()))
    rig.until(answers[0].done)
    assert not any(answer.done() for answer in answers[1:])
    refused = answers.pop(0).result()
    assert (refused.success, refused.message) == (False, "slow: 10 newer requests wait; call again later")
    assert rig.begun == 1
    free.set()
    rig.until(lambda: all(answer.done() for answer in (first, *answers)))
    assert rig.begun == 1 + _MOST_WAITING
    assert all(answer.result().success for answer in answers)


def test_close_tells_whether_the_work_has_ended(rig: Rig) -> None:
    assert rig.services.close(0)
    free = threading.Event()
    rig.work = lambda: str(free.wait(PATIENCE_S))
    answer = rig.client.call_async(Trigger.Request())
    rig.until(lambda: rig.begun)
    assert not rig.services.close(0.01)
    free.set()
    assert rig.services.close(PATIENCE_S)
    rig.until(answer.done)
    assert answer.result().message == "True"
