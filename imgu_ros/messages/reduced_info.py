# SPDX-License-Identifier: Apache-2.0
"""camera_info of a reduced image: its frame's size, the part that it shows, and the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imgu_ros.errors import EncodingError
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message
from imgu_ros.vision.camera.intrinsics import Camera


@dataclass(frozen=True, slots=True)
class Covered:
    """Width and height, px, of the part of a frame that an image shows, from the frame's top left corner."""

    width: int
    height: int


def reduced_info_message(
    make: MessageFactory, header: Header, camera: Camera | None, frame: Covered, covered: Covered, size: Covered
) -> Any:
    """Return the sensor_msgs/CameraInfo of a reduced image.

    It speaks of the frame's pixels as of a sensor's: `width`, `height`, K and D are the frame's, `roi` the part that
    the picture shows, `binning` the pixels that make one of the picture's, rounded.

    Parameters
    ----------
    camera : of the frame; None: not calibrated, K is all zero
    frame : the frame's size
    covered : the part that is shown
    size : the reduced picture's
    """
    if camera is None:
        message = make("sensor_msgs/msg/CameraInfo", header=header_message(make, header), **_UNCALIBRATED)
    else:
        message = camera_info_message(make, header, camera)
    message.width, message.height = frame.width, frame.height
    _set_reduction(message, covered, size)
    return message


def reduced_info_from(make: MessageFactory, header: Header, info: Any, covered: Covered, size: Covered) -> Any:
    """Return the camera_info of a further reduced image.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo of the image that was reduced, of rclpy or of rosbags
    header, covered, size : as for `reduced_info_message`
    """
    message = make(
        "sensor_msgs/msg/CameraInfo",
        header=header_message(make, header),
        height=int(info.height),
        width=int(info.width),
        distortion_model=str(info.distortion_model),
        roi=make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=int(info.roi.x_offset),
            y_offset=int(info.roi.y_offset),
            do_rectify=bool(info.roi.do_rectify),
        ),
        **{name: np.array(getattr(info, name), np.float64) for name in ("d", "k", "r", "p")},
    )
    _set_reduction(message, covered, size)
    return message


def _set_reduction(message: Any, covered: Covered, size: Covered) -> None:
    message.roi.width, message.roi.height = covered.width, covered.height
    message.binning_x, message.binning_y = round(covered.width / size.width), round(covered.height / size.height)


_UNCALIBRATED = {"k": np.zeros(9), "r": np.eye(3).reshape(9), "p": np.zeros(12)}


def decode_covered(message: Any, size: Covered) -> Covered:
    """Return the part of a frame that an image shows, by its camera_info.

    Parameters
    ----------
    message : sensor_msgs/CameraInfo; with neither binning nor window the picture is the frame itself
    size : the picture's

    Raises
    ------
    EncodingError
        If the picture would be larger than what it shows, or is not what binning makes of it.
    """
    window = camera_info_size(message)
    factors = max(1, int(message.binning_x)), max(1, int(message.binning_y))
    shown = (window.width, window.height)
    for full, small, factor in zip(shown, (size.width, size.height), factors, strict=True):
        if not small <= full or not -factor < full - small * factor < factor:
            raise EncodingError(
                f"camera_info: {shown[0]} x {shown[1]} px binned {factors[0]} x {factors[1]}, picture "
                f"{size.width} x {size.height} px; need the same size"
            )
    return window


def camera_info_size(message: Any) -> Covered:
    """Return width and height of the window that a camera_info speaks of, px of the sensor."""
    roi = message.roi
    width = int(roi.width) or int(message.width) - int(roi.x_offset)
    height = int(roi.height) or int(message.height) - int(roi.y_offset)
    return Covered(width, height)


def image_size(message: Any) -> Covered:
    """Return the size of the image that a camera_info belongs to, px.

    Raises
    ------
    EncodingError
        If it tells none.
    """
    window = camera_info_size(message)
    size = Covered(window.width // max(1, int(message.binning_x)), window.height // max(1, int(message.binning_y)))
    if size.width < 1 or size.height < 1:
        raise EncodingError(f"camera_info: size {size.width} x {size.height} px; need the image's size")
    return size
