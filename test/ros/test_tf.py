# SPDX-License-Identifier: Apache-2.0
"""The node on /tf, over DDS: where ROS, and with it tf2_msgs, is installed."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")
pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not installed")

from scipy.spatial.transform import Rotation

from imgu_ros.messages.geometry import decode_tf_message, tf_message
from imgu_ros.pose.frame_tree import StampedTransform
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.qos import latched_qos
from imgu_ros.vision.camera.rigid import RigidTransform

TF = "tf2_msgs/msg/TFMessage"


def test_the_robots_root_hangs_from_the_map(imgu, world, make_camera, peer, prompt_s):
    map_from_poster = RigidTransform(Rotation.random(random_state=1).as_matrix(), np.array([3.0, -1.0, 0.5]))
    base_from_eye = RigidTransform(Rotation.random(random_state=2).as_matrix(), np.array([0.1, 0.0, 0.4]))
    odom_from_base = RigidTransform(Rotation.random(random_state=3).as_matrix(), np.array([7.0, 2.0, 0.0]))
    numbers = [float(value) for value in map_from_poster.numbers()]
    node = imgu(
        "node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw", "-p", "publish_tf:=true",
        "-p", f"targets.poses:={numbers}", "-p", "tf.root_frame:=odom",
    )  # fmt: skip
    node.wait_for_line("targets: poster")
    eye = world.frames[0].frame_id
    fixed = peer.publisher("/tf_static", TF, latched_qos())
    fixed.publish(tf_message(make_message, [StampedTransform(0, "base", eye, base_from_eye)]))
    moving = peer.publisher("/tf", TF)
    peer.hear("/tf", TF)
    camera = make_camera(peer)
    camera.wait_for_node()

    def send() -> None:
        for frame in world.frames:
            # The robot stands; its odometry ends before the images do.
            for shift_ns in (-50_000_000, 50_000_000):
                stamp_ns = frame.stamp_ns + shift_ns
                moving.publish(tf_message(make_message, [StampedTransform(stamp_ns, "odom", "base", odom_from_base)]))
            camera.send(frame)
            peer.spin(0.1)

    def heard(child: str) -> dict[int, StampedTransform]:
        transforms = [one for message in peer.heard["/tf"] for one in decode_tf_message(message)]
        return {one.stamp_ns: one for one in transforms if one.child == child}

    send()
    stamps = [frame.stamp_ns for frame in world.frames]
    peer.wait(lambda: heard("poster").keys() & heard("odom").keys() & set(stamps), "map -> odom", again=send)
    (stamp_ns, *_) = sorted(heard("poster").keys() & heard("odom").keys() & set(stamps))
    odom, poster = heard("odom")[stamp_ns], heard("poster")[stamp_ns]
    assert (odom.parent, poster.parent) == ("map", eye)
    # From the map to the target by way of the robot: where the target was said to be.
    chain = odom.parent_from_child.after(odom_from_base).after(base_from_eye).after(poster.parent_from_child)
    np.testing.assert_allclose(chain.matrix, map_from_poster.matrix, atol=1e-6)
    pose = world.results[stamps.index(stamp_ns)].targets[0].pose
    assert np.linalg.norm(poster.parent_from_child.t - pose.t) < 0.005
    assert node.stop() < prompt_s
    assert "Traceback" not in node.text
