# SPDX-License-Identifier: Apache-2.0
"""Processor time of a perception node's main thread in rclpy's two executors, idle and at 30 and 60 images a second.

    ROS_DOMAIN_ID=42 python benchmarks/executors.py [--seconds 6]

A process publishes images of 320x240 with camera_info and subscribes to `status`. The node has no target, so that what
is measured is the executor and the callbacks that hand messages over, alternately in both executors.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from imgu_ros.messages.header import Header, header_message
from imgu_ros.messages.image import image_message
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.perception import PerceptionNode
from imgu_ros.ros.process import init_ros, make_executor
from imgu_ros.ros.qos import image_qos, output_qos
from imgu_ros.ros.stopping import StopSignal

_SETTLE_S = 4.0


def main() -> None:
    """Run the benchmark, or one of its processes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--part", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.part is None:
        for rate in ("60", "30", "0"):
            for kind in ("events", "single-threaded"):
                part = [sys.executable, __file__, "--seconds", str(arguments.seconds), "--part"]
                camera = subprocess.Popen([*part, "camera", rate], stderr=subprocess.DEVNULL)
                subprocess.run([*part, kind, rate], stderr=subprocess.DEVNULL, check=True)
                camera.wait()
    elif arguments.part[0] == "camera":
        publish(float(arguments.part[1]), arguments.seconds + 2 * _SETTLE_S)
    else:
        measure(*arguments.part, arguments.seconds)


def publish(rate_hz: float, seconds: float) -> None:
    """Publish images as a driver does."""
    rclpy.init()
    node = Node("camera", start_parameter_services=False, enable_rosout=False)
    images = node.create_publisher(message_class("sensor_msgs/msg/Image"), "image_raw", image_qos())
    infos = node.create_publisher(message_class("sensor_msgs/msg/CameraInfo"), "camera_info", image_qos())
    status = message_class("diagnostic_msgs/msg/DiagnosticArray")
    node.create_subscription(status, "status", lambda _: None, output_qos(10))
    pixels = np.zeros((240, 320), np.uint8)
    started = time.monotonic()
    count = 0
    while time.monotonic() - started < seconds:
        if not rate_hz:
            time.sleep(0.1)
            continue
        header = Header(time.time_ns(), "camera")
        infos.publish(make_message("sensor_msgs/msg/CameraInfo", header=header_message(make_message, header)))
        images.publish(image_message(make_message, header, pixels, "mono8"))
        count += 1
        time.sleep(max(0.0, started + count / rate_hz - time.monotonic()))


def measure(kind: str, rate: str, seconds: float) -> None:
    """Print the processor time of the main thread."""
    with StopSignal() as stop:
        init_ros([])
        node = PerceptionNode(stop)
        executor = make_executor() if kind == "events" else SingleThreadedExecutor()
        executor.add_node(node)
        node.start()
        _spin_for(executor, _SETTLE_S)
        images, used, started = node._input.arrivals.count, time.thread_time(), time.monotonic()
        _spin_for(executor, seconds)
        share = (time.thread_time() - used) / (time.monotonic() - started)
        images = node._input.arrivals.count - images
        print(f"{rate:>2} Hz, {kind}: {share:.2%} of a processor, {images} images", flush=True)
    os._exit(0)


def _spin_for(executor: rclpy.executors.Executor, seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.2)


if __name__ == "__main__":
    main()
