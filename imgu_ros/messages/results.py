# SPDX-License-Identifier: Apache-2.0
"""A frame's Result -> the messages of every output topic.

Topics are named relative to the node, as in `docs/interfaces.md`. A function returns None where the frame has nothing
for its topic: a rejected frame has no pictures, a lost target no outline.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from imgu_ros.messages.compressed_image import compressed_image_message
from imgu_ros.messages.encodings import encoding_for
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.features import homographies_message, keypoints_message, matches_message
from imgu_ros.messages.geometry import odometry_message, outline_message, pose_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.messages.status import status_message
from imgu_ros.pose.frame_tree import StampedTransform
from imgu_ros.result import ReferenceResult, Result
from imgu_ros.types import Image


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
    message: Callable[[MessageFactory, Result, ReferenceResult, str], Any | None]


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


def compressed_picture_message(
    make: MessageFactory, result: Result, pixels: Image, file_format: str, jpeg_quality: int, png_level: int
) -> Any:
    """Return a picture with the result's header, compressed; what has 16 bits becomes PNG whatever is asked for.

    Parameters
    ----------
    pixels : (H, W) grey or (H, W, 3) RGB, uint8 or uint16
    file_format, jpeg_quality, png_level : as in `compressed_image_message`
    """
    encoding = encoding_for(pixels.dtype, 1 if pixels.ndim == 2 else pixels.shape[-1])
    kind = "png" if pixels.dtype.itemsize > 1 else file_format
    return compressed_image_message(
        make, result_header(result), pixels, encoding, file_format=kind, jpeg_quality=jpeg_quality, png_level=png_level
    )


def result_keypoints_message(make: MessageFactory, result: Result) -> Any | None:
    """Return `keypoints`."""
    if result.keypoints is None:
        return None
    return keypoints_message(make, result_header(result), result.keypoints, result.descriptors)


def result_matches_message(make: MessageFactory, result: Result) -> Any | None:
    """Return `matches`, of all targets."""
    if all(target.matches is None for target in result):
        return None
    return matches_message(make, result_header(result), result)


def result_homographies_message(make: MessageFactory, result: Result) -> Any | None:
    """Return `homography`: empty when no target was seen, None when the frame was rejected."""
    if result.reason:
        return None
    calibrated = result.frame.camera is not None
    return homographies_message(make, result_header(result), result, calibrated=calibrated)


def result_status_message(make: MessageFactory, result: Result) -> Any:
    """Return `status`."""
    return status_message(make, result_header(result), result)


def target_outline_message(make: MessageFactory, result: Result, target: ReferenceResult, _: str) -> Any | None:
    """Return `outline`."""
    return None if target.outline is None else outline_message(make, result_header(result), target.outline)


def target_pose_message(make: MessageFactory, result: Result, target: ReferenceResult, _: str) -> Any | None:
    """Return `pose`."""
    return None if target.pose is None else pose_message(make, result_header(result), target.pose)


def target_odometry_message(
    make: MessageFactory, result: Result, target: ReferenceResult, target_frame: str
) -> Any | None:
    """Return `odom`."""
    return None if target.pose is None else odometry_message(make, result_header(result), target_frame, target.pose)


def target_transforms(result: Result, target_prefix: str) -> list[StampedTransform]:
    """Return camera -> target for each target with a pose, for /tf."""
    stamp_ns, camera_frame = result.frame.stamp_ns, result.frame.frame_id
    return [
        StampedTransform(stamp_ns, camera_frame, target_prefix + target.name, target.pose.transform)
        for target in result
        if target.pose is not None
    ]


#: Topics with one message a frame; beside them `pyramid/level_<k>` (`level_message`), `debug_image`
#: (`picture_message`), `map/odom` (`odometry_message`), `map/path` (`PathHistory`) and /tf (`tf_message`).
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
