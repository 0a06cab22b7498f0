# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import array
import importlib.util
import time

import numpy as np
import pytest

from imgu_ros.errors import EncodingError, ImguError

pytest.importorskip("sensor_msgs.msg", reason="the `ros` extra is not installed")

from imgu_ros.ros.messages import make_message, message_class


def test_defaults_and_nested_messages():
    stamp = make_message("builtin_interfaces/msg/Time", sec=3, nanosec=4)
    image = make_message("sensor_msgs/msg/Image", header=make_message("std_msgs/msg/Header", stamp=stamp), width=7)
    assert (image.width, image.height, image.header.stamp.sec, image.header.frame_id) == (7, 0, 3, "")
    assert make_message("geometry_msgs/msg/Quaternion").w == 1.0


def test_a_large_image_is_copied_once_and_fast():
    """Assigning the numpy array would take more than 100 ms: rclpy checks it element by element."""
    data = np.random.default_rng(0).integers(0, 256, 1920 * 1080, np.uint8)
    durations = []
    for _ in range(5):
        start = time.perf_counter()
        image = make_message("sensor_msgs/msg/Image", data=data)
        durations.append(time.perf_counter() - start)
    assert min(durations) < 0.02
    assert isinstance(image.data, array.array)
    assert not np.shares_memory(np.frombuffer(image.data, np.uint8), data)
    np.testing.assert_array_equal(np.frombuffer(image.data, np.uint8), data)


def test_arrays_of_numbers():
    info = make_message("sensor_msgs/msg/CameraInfo", d=np.array([0.5, 0.25]), k=np.arange(9.0))
    assert info.d == array.array("d", [0.5, 0.25])
    np.testing.assert_array_equal(info.k, np.arange(9.0))
    assert make_message("sensor_msgs/msg/Image", data=np.zeros(0, np.uint8)).data == array.array("B")
    strided = np.arange(8, dtype=np.uint8)[::2]
    assert make_message("sensor_msgs/msg/Image", data=strided).data.tolist() == [0, 2, 4, 6]


def test_a_byte_is_given_as_a_number():
    assert make_message("diagnostic_msgs/msg/DiagnosticStatus", level=2).level == b"\x02"


def test_messages_that_rclpy_can_serialise():
    rclpy = pytest.importorskip("rclpy.serialization")
    status = make_message("diagnostic_msgs/msg/DiagnosticStatus", level=1, name="poster")
    info = make_message("sensor_msgs/msg/CameraInfo", d=np.array([0.5]), k=np.arange(9.0))
    for message in (status, info):
        again = rclpy.deserialize_message(rclpy.serialize_message(message), type(message))
        assert again == message if message is status else np.array_equal(again.k, info.k)


@pytest.mark.parametrize(
    ("type_name", "fields", "says"),
    [
        ("sensor_msgs/msg/Image", {"widht": 1}, "sensor_msgs/msg/Image: no field 'widht'; nearest known: width"),
        ("sensor_msgs/msg/CameraInfo", {"k": np.arange(8.0)}, "CameraInfo.k: 8 values; need 9"),
        ("sensor_msgs/msg/CameraInfo", {"k": np.arange(9)}, "CameraInfo.k: int64 of shape"),
        ("sensor_msgs/msg/Image", {"data": np.zeros(4, np.uint16)}, "Image.data: uint16 of shape"),
        ("sensor_msgs/msg/Image", {"data": np.zeros((2, 2), np.uint8)}, "need uint8 of shape"),
    ],
)
def test_fields_that_do_not_fit(type_name, fields, says):
    with pytest.raises(EncodingError) as caught:
        make_message(type_name, **fields)
    assert says in str(caught.value)


def test_missing_types():
    with pytest.raises(ImguError, match="sensor_msgs has no message 'Imagee'"):
        message_class("sensor_msgs/msg/Imagee")
    with pytest.raises(ImguError, match="cannot import no_such_msgs.msg"):
        make_message("no_such_msgs/msg/X")


@pytest.mark.skipif(importlib.util.find_spec("tf2_msgs") is not None, reason="tf2_msgs is installed")
def test_tf2_msgs_is_named_with_its_remedy():
    with pytest.raises(ImguError, match="tf2_msgs/msg/TFMessage.*pip does not have it.*ros-jazzy-tf2-msgs"):
        message_class("tf2_msgs/msg/TFMessage")
