# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imgu_ros.errors import ParameterError
from imgu_ros.messages.geometry import (
    PathHistory,
    decode_tf_message,
    odometry_message,
    outline_message,
    pose_message,
    tf_message,
)
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.pose.frame_tree import StampedTransform
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform

HEADER = Header(10_250_000_000, "camera")
SECOND_NS = 1_000_000_000


def quaternion(message) -> np.ndarray:
    return np.array([message.x, message.y, message.z, message.w])


def xyz(message) -> np.ndarray:
    return np.array([message.x, message.y, message.z])


def some_pose(seed: int = 0) -> Pose:
    root = np.random.default_rng(seed).normal(size=(6, 6)) * 0.01
    return Pose(Rotation.random(random_state=seed).as_matrix(), np.array([0.1, -0.2, 1.5]), root @ root.T, 0.2)


def test_outline(make):
    message = outline_message(make, HEADER, np.array([[0.5, -3.25], [10, 0], [10, 20], [0, 20]]))
    assert [(p.x, p.y, p.z) for p in message.polygon.points] == [(0.5, -3.25, 0), (10, 0, 0), (10, 20, 0), (0, 20, 0)]
    assert decode_header(message) == HEADER


@pytest.mark.parametrize("seed", range(6))
def test_pose(make, seed):
    pose = some_pose(seed)
    message = pose_message(make, HEADER, pose)
    q = quaternion(message.pose.pose.orientation)
    assert q[3] >= 0
    assert np.linalg.norm(q) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), pose.R, atol=1e-12)
    np.testing.assert_array_equal(xyz(message.pose.pose.position), pose.t)
    np.testing.assert_array_equal(np.asarray(message.pose.covariance).reshape(6, 6), pose.covariance)
    assert decode_header(message) == HEADER


def test_odometry_is_the_camera_before_the_target(make):
    pose = some_pose(3)
    message = odometry_message(make, HEADER, "poster", pose)
    assert (message.header.frame_id, message.child_frame_id) == ("poster", "camera")
    assert decode_header(message).stamp_ns == HEADER.stamp_ns
    # The camera's centre is the point that the pose maps to the camera's origin.
    np.testing.assert_allclose(pose.R @ xyz(message.pose.pose.position) + pose.t, 0, atol=1e-12)
    R = Rotation.from_quat(quaternion(message.pose.pose.orientation)).as_matrix()
    np.testing.assert_allclose(R, pose.R.T, atol=1e-12)
    np.testing.assert_array_equal(np.asarray(message.pose.covariance).reshape(6, 6), pose.inverse().covariance)
    assert xyz(message.twist.twist.linear).tolist() == xyz(message.twist.twist.angular).tolist() == [0, 0, 0]
    np.testing.assert_array_equal(np.asarray(message.twist.covariance).reshape(6, 6), 1e6 * np.eye(6))


def path_history(make, max_length):
    history = PathHistory(make)
    history.use("poster", max_length)
    return history


def test_path_at_most_once_a_second(make):
    history = path_history(make, 1000)
    sent = [history.add(n * SECOND_NS // 10, some_pose()) for n in range(35)]
    due = [n for n, path in enumerate(sent) if path is not None]
    assert due == [0, 10, 20, 30]
    assert len(sent[30].poses) == 31
    assert sent[30].header.frame_id == "poster"
    assert decode_header(sent[30]).stamp_ns == 3 * SECOND_NS
    assert decode_header(sent[30].poses[7]).stamp_ns == 7 * SECOND_NS // 10
    np.testing.assert_allclose(xyz(sent[30].poses[0].pose.position), some_pose().inverse().t)


def test_path_is_bounded_and_starts_anew_after_a_jump(make):
    history = path_history(make, 5)
    for n in range(20):
        path = history.add(100 * SECOND_NS + n * SECOND_NS, some_pose())
    assert [decode_header(p).stamp_ns // SECOND_NS for p in path.poses] == [115, 116, 117, 118, 119]
    path = history.add(100 * SECOND_NS, some_pose())
    assert len(path.poses) == 1
    with pytest.raises(ParameterError, match=r"path\.max_length: 0"):
        path_history(make, 0)


def test_path_goes_out_although_no_frame_has_a_stamp(make):
    history = path_history(make, 1000)
    due = [n for n in range(95) if history.add(0, some_pose()) is not None]
    assert due == [0, 30, 60, 90]


def test_path_survives_a_single_frame_without_a_stamp(make):
    history = path_history(make, 1000)
    for stamp_ns in (50, 51, 0, 52):
        path = history.add(stamp_ns * SECOND_NS, some_pose())
    assert [decode_header(p).stamp_ns // SECOND_NS for p in path.poses] == [50, 51, 52]


def test_path_of_another_length_keeps_the_latest(make):
    history = path_history(make, 10)
    for n in range(8):
        history.add(n * SECOND_NS, some_pose())
    history.use("poster", 3)
    path = history.add(8 * SECOND_NS, some_pose())
    assert [decode_header(p).stamp_ns // SECOND_NS for p in path.poses] == [6, 7, 8]


def test_tf():
    from imgu_ros.bags.messages import make_message

    R = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    transform = StampedTransform(7, "camera", "poster", RigidTransform(R, np.array([1.0, 2.0, 3.0])))
    message = tf_message(make_message, [transform])
    (got,) = message.transforms
    assert (got.header.frame_id, got.child_frame_id) == ("camera", "poster")
    assert decode_header(got).stamp_ns == 7
    np.testing.assert_array_equal(xyz(got.transform.translation), [1, 2, 3])
    np.testing.assert_allclose(quaternion(got.transform.rotation), [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)
    (again,) = decode_tf_message(message)
    assert (again.stamp_ns, again.parent, again.child) == (7, "camera", "poster")
    np.testing.assert_allclose(again.parent_from_child.matrix, transform.parent_from_child.matrix, atol=1e-15)


def test_transforms_that_are_none_are_left_out():
    from imgu_ros.bags.messages import make_message

    def one(parent: str, child: str, **changes: float):
        (message,) = tf_message(
            make_message, [StampedTransform(7, parent, child, RigidTransform(np.eye(3), np.zeros(3)))]
        ).transforms
        for name, value in changes.items():
            part = message.transform.rotation if name == "w" else message.transform.translation
            object.__setattr__(part, name, value)
        return message

    transforms = [
        one("a", "b", w=0.0),
        one("a", "c", x=np.nan),
        one("", "d"),
        one("a", ""),
        one("a", "a"),
        one("/a", "/e"),
    ]
    message = make_message("tf2_msgs/msg/TFMessage", transforms=transforms)
    assert [(t.parent, t.child) for t in decode_tf_message(message)] == [("a", "e")]
