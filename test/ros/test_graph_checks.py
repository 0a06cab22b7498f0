# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from imgu_ros.ros.causes import CauseKind
from imgu_ros.ros.graph_checks import Wanted, is_latched, similar_topics, why_not_offered, why_not_served
from imgu_ros.ros.messages import message_class
from imgu_ros.ros.qos import image_qos, latched_qos, output_qos

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


@pytest.fixture
def nodes(ros_domain: int) -> Iterator[tuple[Node, Node]]:
    """A node that asks, and a driver."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain)
    made = tuple(Node(name, context=context, enable_rosout=False) for name in ("asking", "driver"))
    yield made
    for node in made:
        node.destroy_node()
    context.try_shutdown()


def until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def publish(node: Node, topic: str, type_name: str = IMAGE, qos: object = None) -> None:
    node.create_publisher(message_class(type_name), topic, qos or image_qos())


def test_topics_that_may_be_meant(nodes):
    asking, driver = nodes
    publish(asking, "/camera/image")  # one's own is never meant
    for topic in ("/far/away/picture", "/camera/image_raw", "/left/camera/image_raw", "/z"):
        publish(driver, topic)
    publish(driver, "/camera/image_row", COMPRESSED)
    publish(driver, "/imu", "sensor_msgs/msg/CameraInfo")
    until(lambda: len(asking.get_topic_names_and_types()) >= 7)
    until(lambda: len(similar_topics(asking, "/camera/image_raww", IMAGE)) == 3)
    found = similar_topics(asking, "/camera/image_raww", IMAGE)
    assert [offer.topic for offer in found][:2] == ["/camera/image_raw", "/left/camera/image_raw"]
    assert all(offer.types == (IMAGE,) for offer in found)
    of_other_type = similar_topics(asking, "/camera/image_row2", "sensor_msgs/msg/PointCloud2")
    assert of_other_type[0].topic == "/camera/image_row"
    cause = why_not_offered(asking, Wanted("/camera/image_raww", IMAGE, image_qos(), "image_raw"))
    assert cause is not None
    assert cause.kind is CauseKind.NO_PUBLISHER
    assert cause.text.endswith(": remap with -r image_raw:=/camera/image_raw")


def test_quality_of_service_on_either_side(nodes):
    asking, driver = nodes
    publish(driver, "/a", IMAGE, image_qos())
    publish(driver, "/b", IMAGE, output_qos())
    until(lambda: asking.count_publishers("/a") and asking.count_publishers("/b"))
    for topic, qos, said in (
        ("/a", image_qos(), None),
        ("/a", output_qos(), "set qos_overrides./a.subscription.reliability to best_effort"),
        ("/b", output_qos(), None),
        ("/b", latched_qos(), "set qos_overrides./b.subscription.durability to volatile"),
        ("/a", latched_qos(), "subscription.reliability to best_effort and qos_overrides./a.subscription.durability"),
    ):
        cause = why_not_offered(asking, Wanted(topic, IMAGE, qos, "image_raw"))
        assert (cause is None) == (said is None), (topic, cause)
        if cause is not None:
            assert cause.kind is CauseKind.QOS
            assert cause.text.startswith(f"only publishers with incompatible QoS on {topic}: /driver offers ")
            assert said in cause.text
    assert not why_not_served(driver, driver.publishers)
    asking.create_subscription(message_class(IMAGE), "/b", print, latched_qos())
    until(lambda: driver.count_subscribers("/b"))
    (cause,) = why_not_served(driver, driver.publishers)
    assert cause.kind is CauseKind.LISTENER
    assert "listener /asking of /b cannot be served" in cause.text
    assert "set qos_overrides./b.publisher.durability to transient_local" in cause.text


@pytest.mark.parametrize(
    ("wanted", "type_name", "there", "of_type", "transport"),
    [
        ("/cam/image_raw", IMAGE, "/cam/image_raw/compressed", COMPRESSED, "compressed"),
        ("/cam/image_raw/compressed", COMPRESSED, "/cam/image_raw", IMAGE, "raw"),
    ],
)
def test_the_same_images_under_another_transport(nodes, wanted, type_name, there, of_type, transport):
    """They are meant, not the images of another camera."""
    asking, driver = nodes
    publish(driver, "/other/image_raw", type_name)
    publish(driver, there, of_type)
    until(lambda: asking.get_publishers_info_by_topic(there) and similar_topics(asking, wanted, type_name))
    cause = why_not_offered(asking, Wanted(wanted, type_name, image_qos(), "image_raw"))
    assert cause is not None and cause.kind is CauseKind.NO_PUBLISHER
    assert cause.text == f"no publisher on {wanted}; {there} has one: set image_transport to {transport}"


def test_what_is_kept_for_late_subscribers(nodes):
    asking, driver = nodes
    publish(driver, "/kept", qos=latched_qos())
    publish(driver, "/gone")
    until(lambda: asking.get_publishers_info_by_topic("/kept") and asking.get_publishers_info_by_topic("/gone"))
    assert is_latched(asking, "/kept") and not is_latched(asking, "/gone") and not is_latched(asking, "/none")
