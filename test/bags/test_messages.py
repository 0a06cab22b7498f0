# SPDX-License-Identifier: Apache-2.0
"""make_message against the interface definitions, and through rosbags' own serialiser."""

from __future__ import annotations

import numpy as np
import pytest

from imgu_ros.bags.messages import make_message, typestore
from imgu_ros.errors import BagError, ShapeError


def test_fields_left_out_get_the_types_defaults() -> None:
    info = make_message("sensor_msgs/msg/CameraInfo", width=4)
    assert (info.width, info.height, info.distortion_model, info.roi.do_rectify) == (4, 0, "", False)
    assert info.k.shape == (9,) and info.k.dtype == np.float64 and not info.k.any()
    assert info.d.shape == (0,) and info.d.dtype == np.float64
    assert (info.header.stamp.sec, info.header.frame_id) == (0, "")


def test_a_quaternion_is_the_identity_as_in_ros() -> None:
    orientation = make_message("geometry_msgs/msg/Pose").orientation
    assert (orientation.x, orientation.y, orientation.z, orientation.w) == (0.0, 0.0, 0.0, 1.0)
    assert make_message("geometry_msgs/msg/Quaternion", w=0.5).w == 0.5


def test_fixed_arrays_of_messages_have_their_length() -> None:
    assert make_message("geometry_msgs/msg/PoseWithCovariance").covariance.shape == (36,)
    assert make_message("geometry_msgs/msg/PolygonStamped").polygon.points == []


def test_every_default_message_survives_serialisation() -> None:
    names = (
        "sensor_msgs/msg/PointCloud2",
        "nav_msgs/msg/Odometry",
        "nav_msgs/msg/Path",
        "tf2_msgs/msg/TFMessage",
        "diagnostic_msgs/msg/DiagnosticArray",
        "sensor_msgs/msg/CompressedImage",
        "std_msgs/msg/Empty",
    )
    for name in names:
        raw = bytes(typestore().serialize_cdr(make_message(name), name))
        again = typestore().deserialize_cdr(raw, name)
        assert bytes(typestore().serialize_cdr(again, name)) == raw


def test_image_bytes_are_those_of_the_cdr_definition() -> None:
    pixels = np.arange(6, dtype=np.uint8)
    stamp = make_message("builtin_interfaces/msg/Time", sec=1, nanosec=2)
    header = make_message("std_msgs/msg/Header", stamp=stamp, frame_id="cam")
    image = make_message(
        "sensor_msgs/msg/Image", header=header, height=2, width=3, encoding="mono8", step=3, data=pixels
    )
    expected = (
        b"\x00\x01\x00\x00"
        + b"\x01\0\0\0\x02\0\0\0"
        + b"\x04\0\0\0cam\0"
        + b"\x02\0\0\0\x03\0\0\0"
        + b"\x06\0\0\0mono8\0"
        + b"\x00"
        + b"\0"
        + b"\x03\0\0\0"
        + b"\x06\0\0\0"
        + bytes(range(6))
    )
    raw = bytes(typestore().serialize_cdr(image, "sensor_msgs/msg/Image"))
    assert raw.rstrip(b"\0") == expected.rstrip(b"\0")


def test_arrays_are_not_copied_when_they_fit() -> None:
    pixels = np.arange(6, dtype=np.uint8)
    assert make_message("sensor_msgs/msg/Image", data=pixels).data is pixels


@pytest.mark.parametrize(
    ("type_name", "fields", "error", "text"),
    [
        ("sensor_msgs/msg/Imag", {}, BagError, "nearest known: sensor_msgs/msg/Image"),
        ("sensor_msgs/msg/Image", {"colour": 1}, BagError, "no field 'colour'"),
        ("sensor_msgs/msg/CameraInfo", {"k": np.zeros(8)}, ShapeError, r"k: shape \(8,\); need \(9,\)"),
        ("sensor_msgs/msg/Image", {"data": np.zeros((2, 3), np.uint8)}, ShapeError, r"data: shape \(2, 3\)"),
        ("sensor_msgs/msg/Image", {"data": np.zeros(3)}, ShapeError, "data: data type float64; need uint8"),
    ],
)
def test_wrong_type_field_or_array_is_an_error(type_name, fields, error, text):
    with pytest.raises(error, match=text) as caught:
        make_message(type_name, **fields)
    assert "\n" not in str(caught.value)
