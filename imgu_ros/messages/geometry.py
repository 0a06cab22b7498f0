# SPDX-License-Identifier: Apache-2.0
"""Outlines, poses, odometry, paths and transforms -> messages; transforms back again."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from imgu_ros.errors import ParameterError, ShapeError
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, decode_header, frame_name, header_message
from imgu_ros.pose.frame_tree import StampedTransform
from imgu_ros.types import Floats, Matrix3, Points
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import rigid_transform
from imgu_ros.vision.camera.rotation import quaternion

#: Variance that says "unknown" in nav_msgs/Odometry.
UNKNOWN_VARIANCE = 1e6
_UNKNOWN_COVARIANCE = np.diag(np.full(6, UNKNOWN_VARIANCE)).reshape(36)

_PATH_PERIOD_NS = 1_000_000_000
_STANDING_POSES = 30


def outline_message(make: MessageFactory, header: Header, outline: Points) -> Any:
    """Return a geometry_msgs/PolygonStamped of points in the image, (N, 2) px, with z = 0."""
    points = [make("geometry_msgs/msg/Point32", x=float(x), y=float(y), z=0.0) for x, y in outline]
    polygon = make("geometry_msgs/msg/Polygon", points=points)
    return make("geometry_msgs/msg/PolygonStamped", header=header_message(make, header), polygon=polygon)


def decode_outline(message: Any) -> Points:
    """Read a message of `outline_message`, (N, 2) px."""
    return np.array([(point.x, point.y) for point in message.polygon.points], np.float64).reshape(-1, 2)


def pose_message(make: MessageFactory, header: Header, pose: Pose) -> Any:
    """Return a geometry_msgs/PoseWithCovarianceStamped; the pose's destination is the header's frame."""
    return make(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        header=header_message(make, header),
        pose=pose_with_covariance(make, pose),
    )


def odometry_message(make: MessageFactory, header: Header, target_frame: str, camera_from_target: Pose) -> Any:
    """Return a nav_msgs/Odometry of the camera in the target's frame.

    Parameters
    ----------
    header : the image's: its frame, the camera's, becomes the child frame
    target_frame : becomes the header's frame
    camera_from_target : is inverted, its covariance with it; the twist is unknown: zero, with variances of 1e6
    """
    zero = vector(make, np.zeros(3))
    return make(
        "nav_msgs/msg/Odometry",
        header=header_message(make, Header(header.stamp_ns, target_frame)),
        child_frame_id=header.frame_id,
        pose=pose_with_covariance(make, camera_from_target.inverse()),
        twist=make(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=make("geometry_msgs/msg/Twist", linear=zero, angular=zero),
            covariance=_UNKNOWN_COVARIANCE.copy(),
        ),
    )


class PathHistory:
    """The camera's path, as nav_msgs/Path at most once a second of the frames' stamps.

    While stamps do not change (all 0) it is published with every thirtieth pose. When stamps jump back by more than a
    second it restarts.
    """

    def __init__(self, make: MessageFactory) -> None:
        self._make = make
        self._frame = ""
        self._poses: deque[Any] = deque(maxlen=1)
        self._last_ns: int | None = None
        self._sent_ns: int | None = None
        self._standing = 0

    def use(self, frame: str, max_length: int) -> None:
        """Give poses in this frame, the latest `max_length` of them (>= 1); in another frame the path restarts."""
        if max_length < 1:
            raise ParameterError(f"path.max_length: {max_length}; need at least 1")
        if frame != self._frame:
            self.clear()
            self._frame = frame
        if self._poses.maxlen != max_length:
            self._poses = deque(self._poses, maxlen=max_length)

    def clear(self) -> None:
        """Drop all poses."""
        self._poses.clear()
        self._last_ns = self._sent_ns = None

    def add(self, stamp_ns: int, camera_from_target: Pose) -> Any | None:
        """Add the camera's pose; return the nav_msgs/Path when one is due, else None."""
        if self._last_ns is not None and stamp_ns < self._last_ns - _PATH_PERIOD_NS:
            if stamp_ns == 0:
                return None  # no stamp, or the first of a recording that restarts: the next one shows which
            self.clear()
        self._last_ns = stamp_ns
        make, header = self._make, Header(stamp_ns, self._frame)
        target_from_camera = camera_from_target.inverse()
        self._poses.append(
            make(
                "geometry_msgs/msg/PoseStamped",
                header=header_message(make, header),
                pose=pose_of(make, target_from_camera.R, target_from_camera.t),
            )
        )
        self._standing = self._standing + 1 if stamp_ns == self._sent_ns else 0
        due = self._sent_ns is None or stamp_ns >= self._sent_ns + _PATH_PERIOD_NS
        if not due and self._standing < _STANDING_POSES:
            return None
        self._sent_ns, self._standing = stamp_ns, 0
        return make("nav_msgs/msg/Path", header=header_message(make, header), poses=list(self._poses))


def tf_message(make: MessageFactory, transforms: Sequence[StampedTransform]) -> Any:
    """Return a tf2_msgs/TFMessage."""
    messages = [
        make(
            "geometry_msgs/msg/TransformStamped",
            header=header_message(make, Header(transform.stamp_ns, transform.parent)),
            child_frame_id=transform.child,
            transform=make(
                "geometry_msgs/msg/Transform",
                translation=vector(make, transform.parent_from_child.t),
                rotation=_quaternion(make, transform.parent_from_child.R),
            ),
        )
        for transform in transforms
    ]
    return make("tf2_msgs/msg/TFMessage", transforms=messages)


def decode_tf_message(message: Any) -> list[StampedTransform]:
    """Read a tf2_msgs/TFMessage; invalid transforms (a zero quaternion, NaN, a frame without a name) are left out.

    A leading slash of a frame's name, as ROS 1 wrote it, is not part of the name.
    """
    transforms = []
    for one in message.transforms:
        header, moved, turned = decode_header(one), one.transform.translation, one.transform.rotation
        numbers = [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w]
        parent, child = header.frame_id, frame_name(str(one.child_frame_id))
        if parent and child and parent != child:
            with suppress(ShapeError):
                transforms.append(StampedTransform(header.stamp_ns, parent, child, rigid_transform(numbers)))
    return transforms


def pose_with_covariance(make: MessageFactory, pose: Pose) -> Any:
    """Return a geometry_msgs/PoseWithCovariance."""
    covariance = np.array(pose.covariance, np.float64).reshape(36)
    return make("geometry_msgs/msg/PoseWithCovariance", pose=pose_of(make, pose.R, pose.t), covariance=covariance)


def pose_of(make: MessageFactory, R: Matrix3, t: Floats) -> Any:
    """Return a geometry_msgs/Pose of a rotation and a place, (3,) m."""
    x, y, z = (float(value) for value in t)
    position = make("geometry_msgs/msg/Point", x=x, y=y, z=z)
    return make("geometry_msgs/msg/Pose", position=position, orientation=_quaternion(make, R))


def vector(make: MessageFactory, values: Floats) -> Any:
    """Return a geometry_msgs/Vector3 of (3,) numbers."""
    x, y, z = (float(value) for value in values)
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _quaternion(make: MessageFactory, R: Matrix3) -> Any:
    x, y, z, w = (float(value) for value in quaternion(R))
    return make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
