# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import serialize_message

from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import decode_image, image_message
from imgu_ros.ros import frame_input as input_module
from imgu_ros.ros.causes import CauseKind
from imgu_ros.ros.image_input import ImageInput, input_topics
from imgu_ros.ros.input_causes import image_causes
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.simulate.texture import procedural_texture

#: Of a message that the middleware tells nothing about.


@pytest.fixture
def make_node(ros_domain: int) -> Iterator[Callable[..., Node]]:
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain)
    nodes: list[Node] = []

    def make(*remaps: str, arguments: Sequence[str] = ()) -> Node:
        given = [*arguments, *(word for rule in remaps for word in ("-r", rule))]
        given = ["--ros-args", *given] if given else []
        nodes.append(Node("perception", context=context, cli_args=given, enable_rosout=False))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


@pytest.mark.parametrize(
    ("transport", "remaps", "image", "info"),
    [
        ("raw", [], "/image_raw", "/camera_info"),
        ("raw", ["__ns:=/cam"], "/cam/image_raw", "/cam/camera_info"),
        ("raw", ["image_raw:=/left/image_rect"], "/left/image_rect", "/left/camera_info"),
        ("raw", ["image_raw:=/left/image", "camera_info:=/calib"], "/left/image", "/calib"),
        ("raw", ["__ns:=/r", "image_raw:=cam/image"], "/r/cam/image", "/r/cam/camera_info"),
        ("compressed", [], "/image_raw/compressed", "/camera_info"),
        ("compressed", ["image_raw:=/left/image"], "/left/image/compressed", "/left/camera_info"),
        ("compressed", ["image_raw/compressed:=/jpeg"], "/jpeg", "/camera_info"),
    ],
)
def test_topics_after_remapping(make_node, transport, remaps, image, info):
    topics = input_topics(make_node(*remaps), transport)
    assert (topics.image, topics.camera_info) == (image, info)
    assert topics.image_type.endswith("CompressedImage" if transport == "compressed" else "Image")
    assert message_class(topics.image_type)


@pytest.mark.parametrize(
    ("topic", "looks"), [("/cam/image_rect", True), ("/cam_rect/image", True), ("/rect/cam/image_raw", False)]
)
def test_a_name_that_says_rectified(make_node, topic, looks):
    assert ImageInput(make_node(f"image_raw:={topic}"), "raw").looks_rectified is looks


def test_callbacks_hand_over_and_count(make_node, monkeypatch):
    source = ImageInput(make_node(), "raw")
    source.open()
    assert source.is_open
    source.open()  # twice does nothing
    pixels = procedural_texture(64, 48)[:, :, 0]
    info = message_class("sensor_msgs/msg/CameraInfo")()
    stamps = (10, 20, 30)
    for stamp_ns in stamps:
        image = image_message(make_message, Header(stamp_ns, "cam"), pixels, "mono8")
        info.header = image.header
        source._on_camera_info(serialize_message(info))
        source._on_image(serialize_message(image))
    jobs = [source.queue.take() for _ in range(3 - source.queue.skipped)]
    assert jobs[-1] is not None
    assert jobs[-1].message.header.stamp.nanosec == 30
    assert jobs[-1].camera_info.header.stamp.nanosec == 30
    assert np.array_equal(decode_image(jobs[-1].message).pixels, pixels)
    assert source.arrivals.count == source.infos.count == 3
    assert source.unmatched == 0
    # An image whose camera_info never comes is not held for ever.
    source._on_image(serialize_message(image_message(make_message, Header(40, "cam"), pixels, "mono8")))
    source.check_waiting()
    monkeypatch.setattr(input_module, "_SHORT_PATIENCE_S", 0.0)
    source.check_waiting()
    source.check_waiting()
    job = source.queue.take()
    assert job is not None
    assert job.message.header.stamp.nanosec == 40
    assert source.unmatched == 1
    source.close()
    assert not source.is_open


def test_bytes_that_are_no_message_are_passed_over(make_node):
    node = make_node()
    source = ImageInput(node, "raw")
    whole = serialize_message(image_message(make_message, Header(1, "cam"), np.zeros((48, 64), np.uint8), "mono8"))
    for damaged in (b"", b"\0\1\0\0", whole[:40], whole[:-100], whole + bytes(100), b"\7" + whole[1:]):
        source._on_image(damaged)
        source._on_camera_info(damaged)
    assert source.arrivals.count == source.infos.count == 0
    (cause,) = image_causes(node, source, time.monotonic())
    assert cause.kind is CauseKind.REJECTED
    assert cause.text.startswith("/image_raw: sensor_msgs/msg/Image: ")
    assert cause.text.endswith("need bytes of this type")
    source._on_image(whole)
    assert source.arrivals.count == 1
    assert not list(image_causes(node, source, time.monotonic()))


def test_what_is_too_large_is_passed_over_and_counted(make_node):
    source = ImageInput(make_node(), "raw")
    source.limits = LimitsParameters(message_mb=1)
    small, large = (
        serialize_message(image_message(make_message, Header(1, "cam"), np.zeros((rows, 1000), np.uint8), "mono8"))
        for rows in (999, 1000)
    )
    source._on_image(small)
    assert (source.arrivals.count, source.unread) == (1, 0)
    source._on_image(large)
    assert source.unreadable == "/image_raw: 1.0 MB; need at most 1 (limits.message_mb)"
    assert (source.arrivals.count, source.unread) == (1, 1)
    info = message_class("sensor_msgs/msg/CameraInfo")()
    source._on_camera_info(serialize_message(info))
    info.d = [0.0] * 2100
    source._on_camera_info(serialize_message(info))
    assert source.infos.count == 1, "16 KB are no camera_info"
