# SPDX-License-Identifier: Apache-2.0
"""A frame's result -> vision_msgs/Detection2DArray: a box, a name and a pose with its covariance for each target."""

from __future__ import annotations

from typing import Any

import numpy as np

from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.geometry import UNKNOWN_VARIANCE, pose_with_covariance
from imgu_ros.messages.header import Header, header_message
from imgu_ros.result import PoseStatus, ReferenceResult, Result


def detections_message(make: MessageFactory, header: Header, result: Result) -> Any:
    """Return a vision_msgs/Detection2DArray with a detection for each target that was found.

    Its box, in raw px, encloses the target's outline. Its hypothesis has the target's name as class_id, the confirmed
    share as score (0 when nothing was compared), and the pose; of an ambiguous target there is one for each pose that
    fits. Where there is no pose, it is the identity with variances of 1e6.
    """
    detections = [_detection(make, header, found) for found in result if found.outline is not None]
    return make("vision_msgs/msg/Detection2DArray", header=header_message(make, header), detections=detections)


def _detection(make: MessageFactory, header: Header, found: ReferenceResult) -> Any:
    assert found.outline is not None
    low, high = found.outline.min(axis=0), found.outline.max(axis=0)
    (x, y), (width, height) = ((low + high) / 2).tolist(), (high - low).tolist()
    center = make("vision_msgs/msg/Pose2D", position=make("vision_msgs/msg/Point2D", x=x, y=y), theta=0.0)
    poses = found.solutions if found.pose_status is PoseStatus.AMBIGUOUS else ()
    if found.pose is not None:
        poses = (found.pose,)
    with_covariance = [pose_with_covariance(make, pose) for pose in poses] or [
        make(
            "geometry_msgs/msg/PoseWithCovariance",
            covariance=np.diag(np.full(6, UNKNOWN_VARIANCE)).reshape(36),
        )
    ]
    hypothesis = make(
        "vision_msgs/msg/ObjectHypothesis", class_id=found.name, score=float(found.confirmed_share or 0.0)
    )
    return make(
        "vision_msgs/msg/Detection2D",
        header=header_message(make, header),
        results=[
            make("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=hypothesis, pose=pose)
            for pose in with_covariance
        ],
        bbox=make("vision_msgs/msg/BoundingBox2D", center=center, size_x=width, size_y=height),
        id=found.name,
    )
