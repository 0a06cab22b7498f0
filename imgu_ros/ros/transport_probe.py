# SPDX-License-Identifier: Apache-2.0
"""Whether large images get from one process of this machine to another: what `imgu doctor` tries."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.middleware import set_profile
from imgu_ros.ros.qos import image_qos

_TYPE = "sensor_msgs/msg/Image"
#: Of a 1280x720 colour picture: what a camera sends.
_SHAPE = (720, 1280, 3)
_FRAMES, _PERIOD_S = 30, 0.02
#: Discovery takes so long on a busy machine.
_PATIENCE_S = 10.0


@dataclass(frozen=True, slots=True)
class Transport:
    """Of `sent` images of `megabytes` each arrived `received`; none when the processes did not find each other."""

    received: int
    sent: int
    megabytes: float


def probe_transport() -> Transport:
    """Have another process send colour pictures of 1280x720 px, and count what arrives."""
    set_profile()
    heard: list[bytes] = []
    topic = f"imgu_doctor_{time.time_ns()}"
    context = Context()
    context.init(args=[])
    try:
        node = Node("doctor", context=context, enable_rosout=False, start_parameter_services=False)
        node.create_subscription(message_class(_TYPE), topic, heard.append, image_qos(), raw=True)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        sender = subprocess.Popen(
            [sys.executable, "-m", __name__, topic], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            end = time.monotonic() + 2 * _PATIENCE_S
            while len(heard) < _FRAMES and time.monotonic() < end and sender.poll() is None:
                executor.spin_once(timeout_sec=0.05)
        finally:
            sender.kill()
            sender.wait()
        executor.shutdown()
        node.destroy_node()
    finally:
        context.try_shutdown()
    return Transport(len(heard), _FRAMES, float(np.prod(_SHAPE)) / 1e6)


def _send(topic: str) -> None:
    set_profile()
    context = Context()
    context.init(args=[])
    node = Node("doctor_sender", context=context, enable_rosout=False, start_parameter_services=False)
    publisher = node.create_publisher(message_class(_TYPE), topic, 10)
    end = time.monotonic() + _PATIENCE_S
    while not publisher.get_subscription_count() and time.monotonic() < end:
        time.sleep(0.02)
    time.sleep(0.3)  # a matched writer may still be unknown to the reader
    message = image_message(make_message, Header(0, "camera"), np.zeros(_SHAPE, np.uint8), "bgr8")
    for _ in range(_FRAMES):
        publisher.publish(message)
        time.sleep(_PERIOD_S)
    time.sleep(1.0)
    context.try_shutdown()


if __name__ == "__main__":
    _send(sys.argv[1])
