"""A frame's Result -> the messages of every output topic.

Topics are named relative to the node, as in `docs/interfaces.md`. A function returns None where the frame has nothing
for its topic: a rejected frame has no pictures, a lost target no outline.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imgu_ros.codec.encodings import encoding_for
from imgu_ros.codec.factory import MessageFactory
from imgu_ros.codec.features import homographies_message, keypoints_message, matches_message
from imgu_ros.codec.geometry import StampedTransform, odometry_message, outline_message, pose_message, tf_message
from imgu_ros.codec.header import Header
from imgu_ros.codec.image import image_message
from imgu_ros.codec.status import status_message
from imgu_ros.perception.result import Result, TargetResult
from imgu_ros.types import Image
from imgu_ros.vision.camera.rigid import RigidTransform


@dataclass(frozen=True, slots=True)
class FrameOutput:
    """A topic with one message for each frame: its type, and the function that makes it."""

    type_name: str
    message: Callable[[MessageFactory, Result], Any | None]


@dataclass(frozen=True, slots=True)
class TargetOutput:
    """A topic with one message for each target seen: its type, and the function that makes it.

    The function's last argument is the name of the target's frame.
    """

    type_name: str
    message: Callable[[MessageFactory, Result, TargetResult, str], Any | None]


def result_header(result: Result) -> Header:
    """Return the input's header, which every output carries."""
    return Header(result.frame.stamp_ns, result.frame.frame_id)


def color_message(make: MessageFactory, result: Result) -> Any | None:
    """Return `image_color`: rgb8, or rgb16 when the input has 16 bit."""
    return None if result.developed is None else picture_message(make, result, result.developed.color())


def mono_message(make: MessageFactory, result: Result) -> Any | None:
    """Return `image_mono`."""
    return None if result.developed is None else picture_message(make, result, result.developed.grey)


def level_message(make: MessageFactory, result: Result, level: int) -> Any | None:
    """Return `pyramid/level_<level>`; None when the pyramid has no such level."""
    if result.pyramid is None or not 0 <= level < len(result.pyramid.levels):
        return None
    return picture_message(make, result, result.pyramid.levels[level].image)


def picture_message(make: MessageFactory, result: Result, pixels: Image) -> Any:
    """Return a picture with the result's header; (H, W) grey or (H, W, 3) RGB: also `debug_image`."""
    encoding = encoding_for(pixels.dtype, 1 if pixels.ndim == 2 else pixels.shape[-1])
    return image_message(make, result_header(result), pixels, encoding)


def result_keypoints_message(make: MessageFactory, result: Result) -> Any | None:
    """Return `keypoints`."""
    if result.keypoints is None:
        return None
    return keypoints_message(make, result_header(result), result.keypoints, result.descriptors)


def result_matches_message(make: MessageFactory, result: Result) -> Any | None:
    """Return `matches`, of all targets."""
    if all(target.matches is None for target in result.targets):
        return None
    return matches_message(make, result_header(result), result.targets)


def result_homographies_message(make: MessageFactory, result: Result) -> Any | None:
    """Return `homography`: empty when no target was seen, None when the frame was rejected."""
    return None if result.reason else homographies_message(make, result_header(result), result.targets)


def result_status_message(make: MessageFactory, result: Result) -> Any:
    """Return `status`."""
    return status_message(make, result_header(result), result)


def target_outline_message(make: MessageFactory, result: Result, target: TargetResult, _: str) -> Any | None:
    """Return `outline`."""
    return None if target.outline is None else outline_message(make, result_header(result), target.outline)


def target_pose_message(make: MessageFactory, result: Result, target: TargetResult, _: str) -> Any | None:
    """Return `pose`."""
    return None if target.pose is None else pose_message(make, result_header(result), target.pose)


def target_odometry_message(
    make: MessageFactory, result: Result, target: TargetResult, target_frame: str
) -> Any | None:
    """Return `odom`."""
    return None if target.pose is None else odometry_message(make, result_header(result), target_frame, target.pose)


@dataclass(frozen=True, slots=True, eq=False)
class MapFrame:
    """How targets with known places tie the camera, or its robot, to the map.

    Attributes
    ----------
    name : the map's frame
    map_from_target : for each target, in the order of `targets.images`
    root_frame : child of the map; "": the camera's own frame
    camera_from_root : from the robot's tree; None when it is not known (yet). Not needed for the camera's own frame
    """

    name: str
    map_from_target: Sequence[RigidTransform]
    root_frame: str = ""
    camera_from_root: RigidTransform | None = None


def result_tf_message(
    make: MessageFactory, result: Result, target_prefix: str, map_frame: MapFrame | None
) -> Any | None:
    """Return a TFMessage: camera -> each target with a pose, and map -> root when a map is given.

    The root is placed by the target whose camera position is the most certain. A target's only parent is the camera,
    and the root's only parent the map. None when no target has a pose.
    """
    camera_frame = result.frame.frame_id
    posed = [target for target in result.targets if target.pose is not None]
    transforms = [
        StampedTransform(camera_frame, target_prefix + target.name, target.pose.transform)
        for target in posed
        if target.pose is not None
    ]
    if posed and map_frame is not None:
        transforms += _map_transforms(posed, camera_frame, map_frame)
    return tf_message(make, result.frame.stamp_ns, transforms) if transforms else None


def _map_transforms(posed: Sequence[TargetResult], camera_frame: str, map_frame: MapFrame) -> list[StampedTransform]:
    camera_from_root = map_frame.camera_from_root
    root_frame = map_frame.root_frame or camera_frame
    if root_frame == camera_frame:
        camera_from_root = RigidTransform(np.eye(3), np.zeros(3))
    if camera_from_root is None:
        return []
    places = [(target.index, target.pose.inverse()) for target in posed if target.pose is not None]
    index, camera_place = min(places, key=lambda place: float(np.trace(place[1].covariance[:3, :3])))
    map_from_root = map_frame.map_from_target[index].after(camera_place.transform).after(camera_from_root)
    return [StampedTransform(map_frame.name, root_frame, map_from_root)]


#: Topics with one message a frame; beside them `pyramid/level_<k>` (`level_message`), `debug_image`
#: (`picture_message`) and /tf (`result_tf_message`).
FRAME_OUTPUTS: Mapping[str, FrameOutput] = {
    "image_color": FrameOutput("sensor_msgs/msg/Image", color_message),
    "image_mono": FrameOutput("sensor_msgs/msg/Image", mono_message),
    "keypoints": FrameOutput("sensor_msgs/msg/PointCloud2", result_keypoints_message),
    "matches": FrameOutput("sensor_msgs/msg/PointCloud2", result_matches_message),
    "homography": FrameOutput("sensor_msgs/msg/PointCloud2", result_homographies_message),
    "status": FrameOutput("diagnostic_msgs/msg/DiagnosticArray", result_status_message),
}

#: Topics of each target, under `targets/<name>/`, and of the first without it; beside them `path` (`PathHistory`).
TARGET_OUTPUTS: Mapping[str, TargetOutput] = {
    "outline": TargetOutput("geometry_msgs/msg/PolygonStamped", target_outline_message),
    "pose": TargetOutput("geometry_msgs/msg/PoseWithCovarianceStamped", target_pose_message),
    "odom": TargetOutput("nav_msgs/msg/Odometry", target_odometry_message),
}


def needs_keypoints(topics: Iterable[str]) -> bool:
    """Return whether one of these outputs can only be made when the chain detects keypoints in every frame."""
    return any(topic == "keypoints" or topic.startswith("pyramid/") for topic in topics)
