# SPDX-License-Identifier: Apache-2.0
"""Publishes map -> root of the robot's frame tree on /tf, from the camera's pose in the map."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from imgu_ros.errors import FrameError
from imgu_ros.messages.geometry import decode_tf_message
from imgu_ros.pose.frame_tree import FrameTree, StampedTransform
from imgu_ros.ros.messages import message_class
from imgu_ros.ros.qos import QosCounters, latched_qos, output_qos
from imgu_ros.vision.camera.rigid import RigidTransform

TF_TYPE = "tf2_msgs/msg/TFMessage"
TF_TOPIC = "/tf"
_STATIC_TOPIC = "/tf_static"
_TF_DEPTH = 100

#: Transforms that are latched have arrived by then.
_SETTLED_S = 1.0
#: A camera's place in the map waits so long for the robot's transforms at its stamp: wheel odometry comes later.
_PATIENCE_S = 1.0
_MOST_WAITING = 64
#: A child of the map that another node publishes counts as taken for so long.
_FORGOTTEN_S = 5.0
#: Stamps of our own transforms, by which they are known when they come back.
_MOST_SENT = 1024


class MapToRootPublisher:
    """Makes map -> root of the camera's poses in the map.

    A frame has one parent (REP-105). So when the camera belongs to a robot, what hangs from the map is the root of the
    robot's tree, as published on /tf and /tf_static; when the root has another parent already, nothing is published.

    Subscriptions are made, served and destroyed in the executor's thread, `add` and `take` are called in the worker's.

    Parameters
    ----------
    node : creates the subscriptions
    map_frame : name of the map
    root_frame : root of the robot's tree; "": the camera's own frame
    """

    def __init__(self, node: Node, map_frame: str, root_frame: str) -> None:
        self._node = node
        self._map = map_frame
        self._root = root_frame
        self._lock = threading.Lock()
        self._tree = FrameTree()
        self._waiting: deque[_Waiting] = deque(maxlen=_MOST_WAITING)
        self._sent: deque[int] = deque(maxlen=_MOST_SENT)
        self._others: dict[str, float] = {}
        self._problem = ""
        self._settled_s = time.monotonic() + _SETTLED_S
        self._subscriptions = [
            node.create_subscription(
                message_class(TF_TYPE), topic, callback, qos, event_callbacks=QosCounters().subscription_callbacks()
            )
            for topic, callback, qos in (
                (_STATIC_TOPIC, self._on_static, latched_qos(_TF_DEPTH)),
                (TF_TOPIC, self._on_moving, output_qos(_TF_DEPTH)),
            )
        ]

    @property
    def frames(self) -> tuple[str, str]:
        """Names of the map and of the root, as given."""
        return self._map, self._root

    @property
    def problem(self) -> str:
        """Why the last pose in the map did not become map -> root; empty when it did."""
        return self._problem

    def add(self, stamp_ns: int, camera_frame: str, map_from_camera: RigidTransform) -> None:
        """Take the camera's pose in the map at an image's stamp; `camera_frame` is the image's."""
        with self._lock:
            if self._waiting and stamp_ns < self._waiting[-1].stamp_ns:
                self._waiting.clear()
            root = self._root or camera_frame
            self._waiting.append(_Waiting(stamp_ns, camera_frame, root, map_from_camera, time.monotonic()))

    def take(self) -> list[StampedTransform]:
        """Return map -> root for the poses whose other transforms are known by now, in order; to be called often."""
        now = time.monotonic()
        out: list[StampedTransform] = []
        with self._lock:
            while self._waiting and now >= self._settled_s:
                pose = self._waiting[0]
                try:
                    out.append(self._from_root(pose, now))
                    self._problem = ""
                except FrameError as error:
                    if now - pose.since_s < _PATIENCE_S and not self._second_parent(pose, now):
                        break
                    self._problem = f"tf: {error}"
                self._waiting.popleft()
        return out

    def forget(self) -> None:
        """Forget moving frames and what waits: time has jumped."""
        with self._lock:
            self._tree.forget_moving()
            self._waiting.clear()

    def destroy(self) -> None:
        """Drop the subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def _from_root(self, pose: _Waiting, now: float) -> StampedTransform:
        refused = self._second_parent(pose, now)
        if refused:
            raise FrameError(refused)
        root_from_camera = self._tree.lookup(pose.root, pose.camera_frame, pose.stamp_ns)
        self._sent.append(pose.stamp_ns)
        map_from_root = pose.map_from_camera.after(root_from_camera.inverse())
        return StampedTransform(pose.stamp_ns, self._map, pose.root, map_from_root)

    def _second_parent(self, pose: _Waiting, now: float) -> str:
        """Return which other parent the root has; empty when it has none."""
        parent = self._tree.parent(pose.root)
        if parent:
            top = self._tree.root(pose.camera_frame)
            return (
                f"{pose.root}: hangs from {parent!r} already; need a root of the robot's tree (tf.root_frame: {top!r})"
            )
        if now < self._others.get(pose.root, -math.inf):
            return f"{pose.root}: another node publishes {self._map} -> {pose.root}; need one publisher of it"
        return ""

    def _on_static(self, message: Any) -> None:
        self._add(message, fixed=True)

    def _on_moving(self, message: Any) -> None:
        self._add(message, fixed=False)

    def _add(self, message: Any, *, fixed: bool) -> None:
        with self._lock:
            for transform in decode_tf_message(message):
                if transform.parent != self._map:
                    self._tree.add(transform, fixed=fixed)
                elif transform.stamp_ns not in self._sent:
                    self._others[transform.child] = math.inf if fixed else time.monotonic() + _FORGOTTEN_S


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
    """A pose of the camera in the map, what is to hang from the map, and since when it waits (monotonic seconds)."""

    stamp_ns: int
    camera_frame: str
    root: str
    map_from_camera: RigidTransform
    since_s: float
