from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from imgu_ros.codec.header import Header
from imgu_ros.codec.image import image_message
from imgu_ros.ros.input import ImageInput, input_topics
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.qos import image_qos
from imgu_ros.simulate.texture import procedural_texture


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


def test_callbacks_hand_over_the_newest_and_count(make_node, monkeypatch):
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
        source._on_camera_info(info)
        source._on_image(image)
    assert source.slot.skipped == 2
    job = source.slot.take()
    assert job is not None
    assert job.image.header.stamp.nanosec == 30
    assert job.camera_info is info
    assert source.arrivals.count == 3
    assert source.unmatched == 0
    # An image whose camera_info never comes is not held for ever.
    source._on_image(image_message(make_message, Header(40, "cam"), pixels, "mono8"))
    source.check_waiting()
    source._last_s -= 10
    source.check_waiting()
    source.check_waiting()
    job = source.slot.take()
    assert job is not None
    assert job.image.header.stamp.nanosec == 40
    assert source.unmatched == 1
    source.close()
    assert not source.is_open


def test_why_no_image_comes(make_node):
    node, driver = make_node(), make_node()
    source = ImageInput(node, "raw")
    assert source.why_silent() == ""
    source.open()
    assert source.why_silent() == ""  # not yet
    source._opened_s -= 10
    assert source.why_silent() == "no publisher on /image_raw"
    publisher = driver.create_publisher(message_class("sensor_msgs/msg/Image"), "image_raw", image_qos())
    end = time.monotonic() + 5
    while source.why_silent() == "no publisher on /image_raw" and time.monotonic() < end:
        time.sleep(0.02)
    assert source.why_silent() == "no images on /image_raw for 10 s"
    source.counters._lost = 3
    assert source.why_silent().startswith("no images on /image_raw for 10 s: 3 lost on the way; ")
    driver.destroy_publisher(publisher)


def test_incompatible_qos_is_said(make_node, tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text(
        "/**: {ros__parameters: {qos_overrides: {/image_raw: {subscription: {reliability: reliable, depth: 7}}}}}\n"
    )
    node, driver = make_node(arguments=["--params-file", str(file)]), make_node()
    source = ImageInput(node, "raw")
    driver.create_publisher(message_class("sensor_msgs/msg/Image"), "image_raw", image_qos())
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    source.open()
    source._opened_s -= 10
    end = time.monotonic() + 5
    while not source.counters.incompatible and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    assert source.why_silent() == "only publishers with incompatible QoS on /image_raw (reliability)"
    executor.shutdown()
