# SPDX-License-Identifier: Apache-2.0
"""Long work beside an executor's thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.node import Node
from std_srvs.srv import Trigger

from imgu_ros.errors import ImguError
from imgu_ros.ros.background_call import BackgroundCall
from imgu_ros.ros.messages import message_class
from imgu_ros.ros.qos import output_qos
from imgu_ros.ros.spinning import Spinner

PATIENCE_S = 20.0


class Rig:
    """A node with a service that works beside its executor, a client of it, and frames from a publisher."""

    def __init__(self, node: Node) -> None:
        self.beside = BackgroundCall()
        self.spinner = Spinner(node)
        self.work: Callable[[], str] = str
        self.frames = threading.Semaphore(0)
        self.group = MutuallyExclusiveCallbackGroup()
        frame = message_class("std_msgs/msg/String")
        self.publisher = node.create_publisher(frame, "frames", output_qos(10))
        node.create_subscription(
            frame, "frames", lambda _: self.frames.release(), output_qos(10), callback_group=self.group
        )
        own = MutuallyExclusiveCallbackGroup()
        node.create_service(Trigger, "slow", self._on_request, callback_group=own)
        self.client = node.create_client(Trigger, "slow")
        self.frame = frame()

    async def _on_request(self, _: Any, response: Any) -> Any:
        try:
            response.message = await self.beside.do(self.work, self.spinner._all)
            response.success = True
        except ImguError as error:
            response.message = str(error)
        return response

    def call(self, group: MutuallyExclusiveCallbackGroup | None) -> Any:
        answer = self.client.call_async(Trigger.Request())
        end = time.monotonic() + PATIENCE_S
        while not answer.done():
            assert time.monotonic() < end
            self.spinner.spin_once(group)
        return answer.result()


@pytest.fixture
def rig(ros_domain: int) -> Iterator[Rig]:
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain)
    node = Node("beside", context=context)
    made = Rig(node)
    yield made
    made.spinner.close()
    node.destroy_node()
    context.try_shutdown()


@pytest.mark.parametrize("with_group", [True, False])
def test_callbacks_go_on_while_a_service_works(rig: Rig, with_group: bool) -> None:
    """The work ends only when frames come during it."""

    def work() -> str:
        for _ in range(3):
            rig.publisher.publish(rig.frame)
            if not rig.frames.acquire(timeout=PATIENCE_S / 4):
                return "no frame came"
        return "three frames came"

    rig.work = work
    answer = rig.call(rig.group if with_group else None)
    assert (answer.success, answer.message) == (True, "three frames came")


def test_an_answer_comes_when_nothing_else_happens(rig: Rig) -> None:
    """The executor waits without an end; the work's end wakes it."""
    rig.work = lambda: (time.sleep(0.1), "done")[1]
    assert rig.call(None).message == "done"


def test_what_work_raises_reaches_the_one_who_awaits_it(rig: Rig) -> None:
    def work() -> str:
        raise ImguError("poster.png: no such file")

    rig.work = work
    answer = rig.call(None)
    assert (answer.success, answer.message) == (False, "poster.png: no such file")


def test_close_tells_whether_the_work_has_ended(rig: Rig) -> None:
    assert rig.beside.close(0)
    go_on = threading.Event()
    rig.work = lambda: str(go_on.wait(PATIENCE_S))
    answer = rig.client.call_async(Trigger.Request())
    end = time.monotonic() + PATIENCE_S
    while rig.beside._thread is None:
        assert time.monotonic() < end
        rig.spinner.spin_once(rig.group)
    assert not rig.beside.close(0.01)
    go_on.set()
    assert rig.beside.close(PATIENCE_S)
    while not answer.done():
        assert time.monotonic() < end
        rig.spinner.spin_once(rig.group)
    assert answer.result().message == "True"
