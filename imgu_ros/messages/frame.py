# SPDX-License-Identifier: Apache-2.0
"""An image message and its camera_info -> Frame."""

from __future__ import annotations

from typing import Any

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import EncodingError
from imgu_ros.frame import Frame
from imgu_ros.messages.camera_info import decode_camera_info
from imgu_ros.messages.camera_reading import CameraDescription, CameraReading, read_camera
from imgu_ros.messages.compressed_image import decode_compressed_image
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.image import decode_image

#: Longer than the side of any sensor; a picture of two such rows is no scene, and would cost as much as a large one.
MAX_SIDE_PX = 65535


def decode_frame(
    image_message: Any,
    camera_info: Any | CameraDescription | None,
    *,
    rectified: bool,
    encoding: str = "",
    covariance: tuple[float, ...] = (),
    limits: LimitsParameters = DEFAULT_LIMITS,
) -> Frame:
    """Read a sensor_msgs/Image or CompressedImage, and the camera_info that belongs to it.

    Parameters
    ----------
    image_message : of rclpy or of rosbags, ROS 2 or ROS 1
    camera_info : the message, or what a calibration file says; None when there is none: the frame's camera is None
    rectified, covariance : see `read_camera`
    encoding : what the pixels are, instead of what the image says; empty: what it says
    limits : what decoding a CompressedImage may cost

    Raises
    ------
    EncodingError
        If the image cannot be read, or has a side of more than 65535 px; see `decode_image` and
        `decode_compressed_image`. A camera_info that cannot be used is the frame's `camera_reason`.
    """
    if hasattr(image_message, "encoding"):
        image = decode_image(image_message, encoding)
    elif hasattr(image_message, "format"):
        image = decode_compressed_image(image_message, encoding, limits=limits)
    else:
        raise EncodingError(f"image: {type(image_message).__name__}; need sensor_msgs/Image or CompressedImage")
    height, width = image.pixels.shape[:2]
    if max(height, width) > MAX_SIDE_PX:
        raise EncodingError(f"image: {width} x {height} px; need sides of at most {MAX_SIDE_PX}")
    header = decode_header(image_message)
    if camera_info is None:
        return Frame(image, header.stamp_ns, header.frame_id, None)
    read = read_camera_info(camera_info, rectified=rectified, image_size=(width, height), covariance=covariance)
    return Frame(image, header.stamp_ns, header.frame_id, read.camera, read.reason, read.remarks)


def read_camera_info(
    camera_info: Any | CameraDescription,
    *,
    rectified: bool,
    image_size: tuple[int, int] | None,
    covariance: tuple[float, ...] = (),
) -> CameraReading:
    """Read the camera of a camera_info message, or of a calibration file; see `read_camera`."""
    if isinstance(camera_info, CameraDescription):
        return read_camera(camera_info, rectified=rectified, image_size=image_size, covariance=covariance)
    return decode_camera_info(camera_info, rectified=rectified, image_size=image_size, covariance=covariance)
