# SPDX-License-Identifier: Apache-2.0
"""Output topics: the table of all of them, and the function of each that makes its message from a frame's Result.

Topics are named relative to the node, as in `docs/interfaces.md`. A function returns None where the frame has nothing
for its topic: a rejected frame has no images, a lost target no outline. `ResultConverter` runs the table, for the live
nodes and for replay alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from imgu_ros.messages.annotations import annotations_message
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.compressed_image import compressed_image_message
from imgu_ros.messages.detections import detections_message
from imgu_ros.messages.encodings import encoding_for
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.features import homographies_message, keypoints_message, matches_message
from imgu_ros.messages.geometry import PathHistory, odometry_message, outline_message, pose_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.messages.markers import markers_message
from imgu_ros.messages.output_topic import OutputContext, OutputTopic, Recording, Scope
from imgu_ros.messages.status import status_message
from imgu_ros.pose.frame_tree import StampedTransform
from imgu_ros.result import Result
from imgu_ros.types import Image
from imgu_ros.vision.camera.pose import Pose


def result_header(result: Result) -> Header:
    """Return the input's header, which every output carries."""
    return Header(result.frame.stamp_ns, result.frame.frame_id)


def picture_message(make: MessageFactory, result: Result, pixels: Image) -> Any:
    """Return an image, (H, W) grey or (H, W, 3) RGB, with the result's header."""
    encoding = encoding_for(pixels.dtype, 1 if pixels.ndim == 2 else pixels.shape[-1])
    return image_message(make, result_header(result), pixels, encoding)


def compressed_picture_message(
    make: MessageFactory, result: Result, pixels: Image, file_format: str, jpeg_quality: int, png_level: int
) -> Any:
    """Return an image with the result's header, compressed; 16 bits become PNG whatever is asked for.

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


def result_status_message(make: MessageFactory, result: Result) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray with the status of every target."""
    return status_message(make, result_header(result), result)


def target_transforms(result: Result, target_prefix: str) -> list[StampedTransform]:
    """Return camera -> target for each target with a pose, for /tf."""
    stamp_ns, camera_frame = result.frame.stamp_ns, result.frame.frame_id
    return [
        StampedTransform(stamp_ns, camera_frame, target_prefix + target.name, target.pose.transform)
        for target in result
        if target.pose is not None
    ]


def _color(context: OutputContext) -> Any | None:
    """rgb8, or rgb16 when the input has 16 bit."""
    developed = context.frame.result.developed
    return None if developed is None else _picture(context, developed.color())


def _compressed_color(context: OutputContext) -> Any | None:
    developed = context.frame.result.developed
    return None if developed is None else _compressed(context, developed.color())


def _mono(context: OutputContext) -> Any | None:
    developed = context.frame.result.developed
    return None if developed is None else _picture(context, developed.grey)


def _compressed_mono(context: OutputContext) -> Any | None:
    developed = context.frame.result.developed
    return None if developed is None else _compressed(context, developed.grey)


def _debug_image(context: OutputContext) -> Any:
    return _picture(context, context.frame.drawn)


def _compressed_debug_image(context: OutputContext) -> Any:
    return _compressed(context, context.frame.drawn)


def _pyramid_level(context: OutputContext) -> Any | None:
    pyramid = context.frame.result.pyramid
    if pyramid is None or context.level >= len(pyramid.levels):
        return None
    return _picture(context, pyramid.levels[context.level].image)


def _picture(context: OutputContext, pixels: Image) -> Any:
    return picture_message(context.frame.make, context.frame.result, pixels)


def _compressed(context: OutputContext, pixels: Image) -> Any:
    frame, options = context.frame, context.frame.parameters.compressed
    return compressed_picture_message(
        frame.make, frame.result, pixels, options.format, options.jpeg_quality, options.png_level
    )


def _keypoints(context: OutputContext) -> Any | None:
    frame, result = context.frame, context.frame.result
    if result.keypoints is None:
        return None
    return keypoints_message(frame.make, frame.header, result.keypoints, result.descriptors)


def _matches(context: OutputContext) -> Any | None:
    frame, result = context.frame, context.frame.result
    if all(target.matches is None for target in result):
        return None
    return matches_message(frame.make, frame.header, result)


def _homography(context: OutputContext) -> Any | None:
    """Without rows when no target was found, None when the frame was rejected."""
    frame, result = context.frame, context.frame.result
    if result.reason:
        return None
    calibrated = result.frame.camera is not None
    return homographies_message(frame.make, frame.header, result, calibrated=calibrated)


def _status(context: OutputContext) -> Any:
    return result_status_message(context.frame.make, context.frame.result)


def _outline(context: OutputContext) -> Any | None:
    frame, outline = context.frame, context.found.outline
    return None if outline is None else outline_message(frame.make, frame.header, outline)


def _pose(context: OutputContext) -> Any | None:
    frame, pose = context.frame, context.found.pose
    return None if pose is None else pose_message(frame.make, frame.header, pose)


def _odometry(context: OutputContext) -> Any | None:
    frame, pose = context.frame, context.found.pose
    return None if pose is None else odometry_message(frame.make, frame.header, context.target_frame, pose)


def _path(context: OutputContext) -> Any | None:
    return _continued_path(context, context.found.pose, context.target_frame)


def _map_odometry(context: OutputContext) -> Any | None:
    frame, pose = context.frame, context.frame.camera_from_map
    return None if pose is None else odometry_message(frame.make, frame.header, frame.parameters.frames.map, pose)


def _map_path(context: OutputContext) -> Any | None:
    return _continued_path(context, context.frame.camera_from_map, context.frame.parameters.frames.map)


def _of_result(message: Callable[[MessageFactory, Header, Result], Any]) -> Callable[[OutputContext], Any | None]:
    """Return the function of a row whose message is of the whole result, also when nothing was found."""

    def made(context: OutputContext) -> Any | None:
        frame = context.frame
        return None if frame.result.reason else message(frame.make, frame.header, frame.result)

    return made


_annotations = _of_result(annotations_message)
_detections = _of_result(detections_message)
_markers = _of_result(markers_message)


def _camera_info(context: OutputContext) -> Any | None:
    frame, camera = context.frame, context.frame.result.frame.camera
    return None if frame.result.reason or camera is None else camera_info_message(frame.make, frame.header, camera)


def _continued_path(context: OutputContext, pose: Pose | None, frame_name: str) -> Any | None:
    if pose is None:
        return None
    history: PathHistory = context.state
    history.use(frame_name, context.frame.parameters.path.max_length)
    return history.add(context.frame.header.stamp_ns, pose)


_IMAGE = "sensor_msgs/msg/Image"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_CLOUD = "sensor_msgs/msg/PointCloud2"
_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_ODOMETRY = "nav_msgs/msg/Odometry"
_PATH = "nav_msgs/msg/Path"
_ANNOTATIONS = "foxglove_msgs/msg/ImageAnnotations"
_DETECTIONS = "vision_msgs/msg/Detection2DArray"

#: Every output topic but /tf, which depends on the other transforms there (`ros/outputs.py`). A new output is one row.
OUTPUTS: tuple[OutputTopic, ...] = (
    OutputTopic("homography", _CLOUD, _homography, recording=Recording.ALWAYS),
    OutputTopic("status", "diagnostic_msgs/msg/DiagnosticArray", _status, recording=Recording.ALWAYS),
    OutputTopic("outline", "geometry_msgs/msg/PolygonStamped", _outline, Scope.TARGET, Recording.ALWAYS),
    OutputTopic("pose", _POSE, _pose, Scope.TARGET, Recording.ALWAYS),
    OutputTopic("odom", _ODOMETRY, _odometry, Scope.TARGET, Recording.ALWAYS),
    OutputTopic("path", _PATH, _path, Scope.TARGET, state=PathHistory),
    OutputTopic("map/odom", _ODOMETRY, _map_odometry, Scope.MAP, Recording.ALWAYS),
    OutputTopic("map/path", _PATH, _map_path, Scope.MAP, state=PathHistory),
    OutputTopic("annotations", _ANNOTATIONS, _annotations, recording=Recording.ALWAYS, is_optional=True),
    OutputTopic("detections", _DETECTIONS, _detections, recording=Recording.ALWAYS, is_optional=True),
    OutputTopic("markers", "visualization_msgs/msg/MarkerArray", _markers, recording=Recording.ALWAYS),
    # The camera that was used. A live node has it unless it is a topic that the node reads.
    OutputTopic("camera_info", "sensor_msgs/msg/CameraInfo", _camera_info, recording=Recording.ALWAYS),
    OutputTopic("keypoints", _CLOUD, _keypoints, needs_keypoints=True),
    OutputTopic("matches", _CLOUD, _matches),
    OutputTopic("image_color", _IMAGE, _color),
    OutputTopic("image_color/compressed", _COMPRESSED, _compressed_color),
    OutputTopic("image_mono", _IMAGE, _mono),
    OutputTopic("image_mono/compressed", _COMPRESSED, _compressed_mono),
    OutputTopic("debug_image", _IMAGE, _debug_image),
    OutputTopic("debug_image/compressed", _COMPRESSED, _compressed_debug_image),
    OutputTopic("pyramid/level_", _IMAGE, _pyramid_level, Scope.LEVEL, needs_keypoints=True),
)


def needs_keypoints(topics: Iterable[str]) -> bool:
    """Return whether one of these outputs can only be made when keypoints are detected in every frame."""
    needing = [row for row in OUTPUTS if row.needs_keypoints]
    return any(
        topic.startswith(row.name) if row.scope is Scope.LEVEL else topic == row.name
        for topic in topics
        for row in needing
    )
