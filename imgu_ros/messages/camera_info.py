# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/CameraInfo <-> Camera."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from imgu_ros.errors import EncodingError
from imgu_ros.messages.camera_reading import CameraDescription, CameraReading, read_camera
from imgu_ros.messages.distortion_names import message_name
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message
from imgu_ros.vision.camera.intrinsics import Camera


def decode_camera_info(
    message: Any, *, rectified: bool, image_size: tuple[int, int] | None, covariance: tuple[float, ...] = ()
) -> CameraReading:
    """Read the camera that took an image of `image_size`; what keeps it from being used is the reading's reason.

    `roi.do_rectify` changes nothing: ROS's rectification uses the same window for the raw and for the rectified image.

    Parameters
    ----------
    message : sensor_msgs/CameraInfo
    rectified, image_size, covariance : see `read_camera`
    """
    try:
        description = camera_description(message)
    except EncodingError as error:
        return CameraReading(None, str(error))
    return read_camera(description, rectified=rectified, image_size=image_size, covariance=covariance)


def camera_description(message: Any, source: str = "camera_info") -> CameraDescription:
    """Return the fields of a sensor_msgs/CameraInfo; ROS 1 writes D, K, R and P in capitals.

    Raises
    ------
    EncodingError
        If a matrix does not hold numbers.
    """
    roi = message.roi
    return CameraDescription(
        source=source,
        K=_numbers(message, "k", source),
        D=_numbers(message, "d", source),
        R=_numbers(message, "r", source),
        P=_numbers(message, "p", source),
        model=str(message.distortion_model),
        width=int(message.width),
        height=int(message.height),
        binning=(max(1, int(message.binning_x)), max(1, int(message.binning_y))),
        roi=(int(roi.x_offset), int(roi.y_offset), int(roi.width), int(roi.height)),
    )


def camera_info_message(make: MessageFactory, header: Header, camera: Camera) -> Any:
    """Return the sensor_msgs/CameraInfo of a camera: K, D, R = identity, P = [K | 0], no binning, no window."""
    return make(
        "sensor_msgs/msg/CameraInfo",
        header=header_message(make, header),
        height=camera.height,
        width=camera.width,
        distortion_model=message_name(camera.model),
        d=np.array(camera.distortion, np.float64),
        k=np.array(camera.K, np.float64).reshape(9),
        r=np.eye(3).reshape(9),
        p=np.column_stack((camera.K, np.zeros(3))).reshape(12),
        binning_x=0,
        binning_y=0,
        roi=make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def _numbers(message: Any, name: str, source: str) -> tuple[float, ...]:
    values = getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())
    try:
        numbers = np.asarray(values, dtype=np.float64).ravel().tolist()
    except (TypeError, ValueError):
        raise EncodingError(f"{source}: {name.upper()} is {str(values)[:40]}; need numbers") from None
    # One object for every NaN: a NaN equals none but itself, and what was read before is to be found again.
    return tuple(math.nan if math.isnan(number) else number for number in numbers)
