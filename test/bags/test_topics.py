# SPDX-License-Identifier: Apache-2.0
"""Which topic is the image topic, and which camera_info belongs to it."""

from __future__ import annotations

import pytest

from imgu_ros.bags.reading import BagTopic
from imgu_ros.bags.topics import find_camera_info_topic, find_image_topic
from imgu_ros.errors import BagError, ParameterError

IMAGE = "sensor_msgs/msg/Image"
INFO = "sensor_msgs/msg/CameraInfo"
TOPICS = (
    BagTopic("/imu", "sensor_msgs/msg/Imu", 100),
    BagTopic("/silent/image_raw", IMAGE, 0),
    BagTopic("/left/image_raw", IMAGE, 10),
    BagTopic("/right/image_raw/compressed", "sensor_msgs/msg/CompressedImage", 10),
    BagTopic("/right/camera_info", INFO, 10),
    BagTopic("/left/camera_info", INFO, 10),
)


def test_the_first_image_topic_with_messages_is_taken():
    assert find_image_topic(TOPICS).name == "/left/image_raw"
    assert find_image_topic(TOPICS[:2]).name == "/silent/image_raw"
    assert find_image_topic(TOPICS, "/right/image_raw/compressed").name == "/right/image_raw/compressed"
    assert find_image_topic(TOPICS, "left/image_raw").name == "/left/image_raw"


def test_the_sibling_camera_info_is_found():
    assert find_camera_info_topic(TOPICS, "/left/image_raw").name == "/left/camera_info"
    assert find_camera_info_topic(TOPICS, "/right/image_raw/compressed").name == "/right/camera_info"
    assert find_camera_info_topic(TOPICS, "/silent/image_raw") is None
    assert find_camera_info_topic(TOPICS, "/silent/image_raw", "/left/camera_info").name == "/left/camera_info"
    root = (BagTopic("/image_raw", IMAGE, 1), BagTopic("/camera_info", INFO, 1))
    assert find_camera_info_topic(root, "/image_raw").name == "/camera_info"


def test_errors_say_what_there_is():
    with pytest.raises(BagError, match=r"no image topic among /imu \(sensor_msgs/msg/Imu\); need one of type"):
        find_image_topic(TOPICS[:1])
    with pytest.raises(BagError, match="it has none"):
        find_image_topic(())
    with pytest.raises(ParameterError, match="image_topic: /left/image is not in the bag; nearest: /left/image_raw"):
        find_image_topic(TOPICS, "/left/image")
    with pytest.raises(ParameterError, match="the bag has no topics"):
        find_image_topic((), "/left/image")
    with pytest.raises(ParameterError, match="/imu is of type sensor_msgs/msg/Imu; need sensor_msgs/msg/Image"):
        find_image_topic(TOPICS, "/imu")
    with pytest.raises(ParameterError, match="camera_info_topic: /imu is of type"):
        find_camera_info_topic(TOPICS, "/left/image_raw", "/imu")
