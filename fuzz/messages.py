# SPDX-License-Identifier: Apache-2.0
"""The messages that the seeds hold, serialised by rosbags: a picture with its camera, and types of all shapes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

WIDTH, HEIGHT = 32, 24
_CUSTOM = """\
string name
uint8[4] fixed
float64[] numbers
my_msgs/Part[] parts
my_msgs/Part[2] pair
string<=8[<=3] words
================================================================================
MSG: my_msgs/Part
int16 a
bool b
string c
"""


@dataclass(frozen=True, slots=True)
class Recorded:
    """A message of a seed: topic, type, the type's definition and its MD5 sum, time in ns, and the serialised bytes."""

    topic: str
    type_name: str
    definition: str
    digest: str
    time_ns: int
    data: bytes


def recorded(count: int, ros: int = 2) -> tuple[Recorded, ...]:
    """Return messages of six topics, `count` of each, serialised as ROS `ros` does."""
    return tuple(_make(topic, i, ros) for i in range(count) for topic in _TOPICS if ros == 2 or topic != "/custom")


@cache
def _store(ros: int) -> Any:
    store = get_typestore(Stores.ROS2_JAZZY if ros == 2 else Stores.ROS1_NOETIC)
    if ros == 2:
        store.register(get_types_from_msg(_CUSTOM, "my_msgs/msg/Shape"))
    return store


@cache
def _make(topic: str, i: int, ros: int) -> Recorded:
    store = _store(ros)
    types = store.types
    type_name = _TOPICS[topic]
    rng = np.random.default_rng(i)
    pixels = rng.integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    sequence = {"seq": i} if ros == 1 else {}
    stamp = types["builtin_interfaces/msg/Time"](sec=100 + i, nanosec=5)
    header = types["std_msgs/msg/Header"](**sequence, stamp=stamp, frame_id="camera")
    matrix = {"K": np.array([30.0, 0, 16, 0, 30, 12, 0, 0, 1]), "D": np.zeros(5), "R": np.eye(3).ravel()}
    matrix["P"] = np.array([30.0, 0, 16, 0, 0, 30, 12, 0, 0, 0, 1, 0])
    fields: dict[str, dict[str, Any]] = {
        "/camera/image_raw": {
            "header": header, "height": HEIGHT, "width": WIDTH, "encoding": "bayer_rggb8", "is_bigendian": 0,
            "step": WIDTH, "data": pixels.ravel(),
        },
        "/camera/camera_info": {
            "header": header, "height": HEIGHT, "width": WIDTH, "distortion_model": "plumb_bob", "binning_x": 0,
            "binning_y": 0, "roi": types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
            **{name if ros == 1 else name.lower(): value for name, value in matrix.items()},
        },
        "/other/compressed": {
            "header": header, "format": "jpeg",
            "data": np.asarray(cv2.imencode(".jpg", pixels)[1], np.uint8).ravel(),
        },
        "/text": {"data": f"message {i}"},
        "/pose": {
            "header": header, "pose": types["geometry_msgs/msg/Pose"](
                position=types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
                orientation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            ),
        },
    }  # fmt: skip
    if topic == "/custom":
        part = types["my_msgs/msg/Part"](a=-3, b=True, c="part")
        fields[topic] = {
            "name": "shape", "fixed": np.arange(4, dtype=np.uint8), "numbers": np.arange(5.0), "parts": [part] * i,
            "pair": [part, part], "words": ["a", "bc"],
        }  # fmt: skip
    message = types[type_name](**fields[topic])
    data = store.serialize_cdr(message, type_name) if ros == 2 else store.serialize_ros1(message, type_name)
    definition, digest = store.generate_msgdef(type_name, ros_version=ros)
    return Recorded(topic, type_name, definition, digest, (100 + i) * 10**9 + len(topic), bytes(data))


_TOPICS = {
    "/camera/image_raw": "sensor_msgs/msg/Image",
    "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
    "/other/compressed": "sensor_msgs/msg/CompressedImage",
    "/text": "std_msgs/msg/String",
    "/pose": "geometry_msgs/msg/PoseStamped",
    "/custom": "my_msgs/msg/Shape",
}
