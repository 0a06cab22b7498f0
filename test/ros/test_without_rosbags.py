# SPDX-License-Identifier: Apache-2.0
"""A ROS installation from apt, which has no rosbags: the node works, and what reads recordings says what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from rclpy.serialization import serialize_message

from imgu_ros.errors import BagError
from imgu_ros.messages.camera_info import camera_info_message, decode_camera_info
from imgu_ros.messages.geometry import pose_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import decode_image, image_message
from imgu_ros.messages.results import result_header
from imgu_ros.ros.message_bytes import message_by_rclpy, message_from_bytes
from imgu_ros.ros.messages import make_message

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
IMAGE = "sensor_msgs/msg/Image"
INFO = "sensor_msgs/msg/CameraInfo"
BLOCKED = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"rosbags", "lz4", "backports", "av"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocker())
from imgu_ros.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "blocked.py"
    path.write_text(BLOCKED)
    return path


def test_both_ways_read_the_same(world):
    frame = world.frames[0]
    header = Header(frame.stamp_ns, frame.frame_id)
    image = serialize_message(image_message(make_message, header, frame.image.pixels, "bayer_rggb8"))
    in_place, copied = message_from_bytes(IMAGE, image), message_by_rclpy(IMAGE, image)
    assert np.array_equal(decode_image(in_place).pixels, frame.image.pixels)
    assert np.array_equal(decode_image(copied).pixels, frame.image.pixels)
    info = serialize_message(camera_info_message(make_message, header, frame.camera))
    size = (frame.camera.width, frame.camera.height)
    cameras = [
        decode_camera_info(read(INFO, info), rectified=False, image_size=size)
        for read in (message_from_bytes, message_by_rclpy)
    ]
    assert all(np.array_equal(reading.camera.K, frame.camera.K) for reading in cameras)


@pytest.mark.parametrize("cut", [0, 3, 20, 60])
def test_cut_bytes_are_no_message(world, cut):
    frame = world.frames[0]
    header = Header(frame.stamp_ns, frame.frame_id)
    image = serialize_message(image_message(make_message, header, frame.image.pixels, "bayer_rggb8"))
    with pytest.raises(BagError, match=r"sensor_msgs/msg/Image: .*need bytes of this type"):
        message_by_rclpy(IMAGE, image[:cut])


def test_the_node_gives_poses(environment, world, peer, make_camera, script):
    arguments = ["node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw"]
    node = subprocess.Popen([sys.executable, str(script), *arguments], env=environment, stderr=subprocess.DEVNULL)
    try:
        peer.hear("/pose", POSE)
        peer.wait(peer.has_publishers, "discovery")
        camera = make_camera(peer)
        camera.wait_for_node()
        peer.wait(lambda: peer.heard["/pose"], "a pose", again=lambda: camera.send(world.frames[0]))
        result = world.results[0]
        expected = pose_message(make_message, result_header(result), result.first.pose)
        assert peer.heard["/pose"][0].pose.pose == expected.pose.pose
    finally:
        node.terminate()
        try:
            node.wait(20)
        finally:
            node.kill()


@pytest.mark.parametrize("command", [["replay", "BAG", "--out", "out"], ["play", "BAG"]])
def test_what_reads_recordings_says_what_to_install(environment, script, tmp_path, command):
    (tmp_path / "BAG").mkdir()
    done = subprocess.run(
        [sys.executable, str(script), *command],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("imgu: error: rosbags: not installed") and line.endswith("pip install rosbags")
