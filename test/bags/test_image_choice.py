# SPDX-License-Identifier: Apache-2.0
"""Which image topic is read when nobody names one: recordings as drivers and their launch files make them."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.recorded_images import choose_image_topic, recorded_images
from imgu_ros.bags.writing import BagWriter
from imgu_ros.config.components import RecordedFramesParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ParameterError
from imgu_ros.messages.encodings import encoding_named
from imgu_ros.replay.frame_source import FrameSource

INFO = "camera_info"
WIDTH, HEIGHT = 32, 24


def image(encoding: str):
    """An Image, or a CompressedImage of a format such as "16UC1; compressedDepth png"."""
    if ";" in encoding or encoding in ("jpeg", "h264"):
        pixels = np.zeros((HEIGHT, WIDTH), np.uint8)
        data = b"\0" * 12 + b"\x89PNG" if "Depth" in encoding else cv2.imencode(".jpg", pixels)[1].tobytes()
        data = b"\0\0\0\1\x67" if encoding == "h264" else data
        return make_message("sensor_msgs/msg/CompressedImage", format=encoding, data=np.frombuffer(data, np.uint8))
    step = WIDTH * (1 if encoding == "nv12" else encoding_named(encoding).pixel_bytes if encoding != "bad" else 1)
    rows = HEIGHT * 3 // 2 if encoding == "nv12" else HEIGHT
    data = np.zeros(step * rows, np.uint8)
    fields = {"width": WIDTH, "height": HEIGHT, "step": step, "encoding": encoding, "data": data}
    return make_message("sensor_msgs/msg/Image", **fields)


def write(path, topics: dict[str, str], infos=()):
    with BagWriter(path) as writer:
        for time_ns in (1, 2):
            for name, encoding in topics.items():
                writer.write(name, image(encoding), time_ns)
            for name in infos:
                writer.write(name, make_message("sensor_msgs/msg/CameraInfo"), time_ns)
    return path


#: Image topics by encoding; the one to be read is the last. Then those with a camera_info.
RECORDINGS = {
    "realsense": (
        {
            "/camera/depth/image_rect_raw": "16UC1",
            "/camera/aligned_depth_to_color/image_raw": "16UC1",
            "/camera/aligned_depth_to_color/image_raw/compressed": "16UC1; jpeg compressed ",
            "/camera/depth/image_rect_raw/compressedDepth": "16UC1; compressedDepth png",
            "/camera/infra1/image_rect_raw": "mono8",
            "/camera/color/image_raw/compressed": "rgb8; jpeg compressed bgr8",
            "/camera/color/image_raw": "rgb8",
        },
        ["/camera/depth", "/camera/aligned_depth_to_color", "/camera/infra1", "/camera/color"],
    ),
    "zed": (
        {
            "/zed/zed_node/confidence/confidence_map": "32FC1",
            "/zed/zed_node/depth/depth_registered": "32FC1",
            "/zed/zed_node/disparity/disparity_image": "32FC1",
            "/zed/zed_node/left/image_rect_color": "bgra8",
            "/zed/zed_node/left_raw/image_raw_color": "bgra8",
        },
        ["/zed/zed_node/depth", "/zed/zed_node/left", "/zed/zed_node/left_raw"],
    ),
    "kinect": ({"/depth/image_raw": "16UC1", "/ir/image_raw": "mono16", "/rgb/image_raw": "bgra8"}, ["/depth", "/rgb"]),
    "float depth": ({"/a/image": "32FC1", "/b/image": "mono8"}, ["/a"]),
    "depth in a grey disguise": ({"/camera/depth/image": "mono16", "/camera/view/image": "mono8"}, ["/camera/depth"]),
    "depth in color": ({"/a/depth/image_colored": "bgr8", "/b/image_raw": "mono8"}, ["/a/depth"]),
    "a camera called depth": ({"/depth_camera/depth/image": "32FC1", "/depth_camera/image": "rgb8"}, ["/depth_camera"]),
    "thermal": ({"/thermal/image_raw": "mono16", "/visible/image_raw": "mono8"}, ["/thermal", "/visible"]),
    "masks": (
        {
            "/yolo/mask": "mono8",
            "/semantic/labels": "8UC1",
            "/yolo/debug_image": "bgr8",
            "/camera/image_annotated": "rgb8",
            "/camera/image": "rgb8",
        },
        [],
    ),
    "generic 8 bits": ({"/a/image": "8UC1", "/b/image": "mono8"}, []),
    "generic color before depth": ({"/a/image": "16UC1", "/b/image": "8UC3"}, ["/a"]),
    "own camera_info": ({"/a/image_raw": "rgb8", "/b/image_raw": "mono8"}, ["/b"]),
    "raw before rectified": ({"/a/image_rect": "rgb8", "/a/image_raw": "mono8"}, ["/a"]),
    "mosaic before its grey": ({"/a/image_mono": "mono8", "/a/image_raw": "bayer_rggb8"}, ["/a"]),
    "color before grey": ({"/a/image_raw": "mono8", "/b/image_raw": "yuv422_yuy2"}, ["/a", "/b"]),
    "planes": ({"/a/image_raw": "mono8", "/b/image_raw": "nv12"}, ["/a", "/b"]),
    "stereo": ({"/stereo/right/image": "mono8", "/stereo/left/image": "mono8"}, ["/stereo/left", "/stereo/right"]),
    "unreadable": ({"/a/image_raw": "bad", "/b/image_raw/compressed": "h264", "/depth": "16UC1"}, ["/a", "/b"]),
    "compressed alone": ({"/depth/image": "16UC1", "/a/image_raw/compressed": "jpeg"}, ["/depth"]),
}  # fmt: skip


@pytest.mark.parametrize("recording", RECORDINGS)
def test_the_picture_of_the_scene_is_read_and_the_others_are_named(tmp_path, recording):
    topics, infos = RECORDINGS[recording]
    *others, expected = topics
    orders = [list(topics), list(topics)[::-1]]
    if len(topics) <= 3:
        orders = [list(order) for order in itertools.permutations(topics)]
    for number, order in enumerate(orders):  # the order of the recording does not matter
        path = write(tmp_path / str(number), {name: topics[name] for name in order}, [f"{i}/{INFO}" for i in infos])
        with open_bag([path]) as bag:
            choice = choose_image_topic(bag)
            assert choice.topic.name == expected
            encoding = " ".join(topics[expected].split())
            assert f"several image topics: reading {expected} ({encoding}), not " in choice.remark
            assert all(other in choice.remark for other in others)
            assert choice.remark.endswith("; set -p image_topic:=NAME")


def test_replay_and_calibrate_read_the_same(tmp_path):
    path = write(tmp_path / "x", {"/depth/image": "16UC1", "/rgb/image": "rgb8"})
    with open_bag([path]) as bag:
        source = FrameSource(bag, RecordedFramesParameters.of(Parameters()))
        assert source.image_topic.name == "/rgb/image"
        said = "several image topics: reading /rgb/image (rgb8), not /depth/image (16UC1); set -p image_topic:=NAME"
        assert source.warnings == [said]
        pictures = list(recorded_images(bag))
        assert [picture.image.pixels.ndim for picture in pictures] == [3, 3]
        assert [picture.remarks for picture in pictures] == [(said,), ()]


def test_what_is_named_is_read(tmp_path):
    path = write(tmp_path / "x", {"/depth/image": "16UC1", "/rgb/image": "rgb8"})
    with open_bag([path]) as bag:
        choice = choose_image_topic(bag, "/depth/image")
        assert (choice.topic.name, choice.remark) == ("/depth/image", "")
        with pytest.raises(ParameterError, match="nearest: /depth/image"):
            choose_image_topic(bag, "/Depth/Image")


def test_one_topic_is_no_choice(tmp_path):
    path = write(tmp_path / "x", {"/depth/image": "16UC1"})
    with open_bag([path]) as bag:
        assert choose_image_topic(bag).topic.name == "/depth/image"
        assert choose_image_topic(bag).remark == ""


def test_a_damaged_first_message_does_not_decide(tmp_path):
    with BagWriter(tmp_path / "x") as writer:
        for time_ns in range(3):
            broken = make_message("sensor_msgs/msg/Image", width=9, height=9, encoding="rgb8")
            writer.write("/rgb/image", broken if time_ns == 0 else image("rgb8"), time_ns)
            writer.write("/depth/image", image("16UC1"), time_ns)
    with open_bag([tmp_path / "x"]) as bag:
        assert choose_image_topic(bag).topic.name == "/rgb/image"


def test_many_topics_are_listed_in_part(tmp_path):
    path = write(tmp_path / "x", {f"/camera_{i:02}/image_raw": "mono8" for i in range(12)})
    with open_bag([path]) as bag:
        choice = choose_image_topic(bag)
    assert choice.topic.name == "/camera_00/image_raw"
    assert choice.remark.endswith("/camera_08/image_raw (mono8) and 3 more; set -p image_topic:=NAME")
