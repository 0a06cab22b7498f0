"""An image message and its camera_info -> Frame."""

from __future__ import annotations

from typing import Any

from imgu_ros.codec.camera_info import decode_camera_info
from imgu_ros.codec.compressed_image import decode_compressed_image
from imgu_ros.codec.header import decode_header
from imgu_ros.codec.image import decode_image
from imgu_ros.errors import EncodingError
from imgu_ros.perception.frame import Frame


def decode_frame(image_message: Any, camera_info_message: Any | None, *, rectified: bool) -> Frame:
    """Read a sensor_msgs/Image or CompressedImage, and the camera_info that belongs to it.

    Parameters
    ----------
    image_message : of rclpy or of rosbags, ROS 2 or ROS 1
    camera_info_message : None when there is none; the frame's camera is then None
    rectified : see `decode_camera_info`

    Raises
    ------
    EncodingError
        If the image cannot be read; see `decode_image` and `decode_compressed_image`. A camera_info that cannot be
        used is the frame's `camera_reason`.
    """
    if hasattr(image_message, "encoding"):
        image = decode_image(image_message)
    elif hasattr(image_message, "format"):
        image = decode_compressed_image(image_message)
    else:
        raise EncodingError(f"image: {type(image_message).__name__}; need sensor_msgs/Image or CompressedImage")
    header = decode_header(image_message)
    if camera_info_message is None:
        return Frame(image, header.stamp_ns, header.frame_id, None)
    height, width = image.pixels.shape[:2]
    read = decode_camera_info(camera_info_message, rectified=rectified, image_size=(width, height))
    return Frame(image, header.stamp_ns, header.frame_id, read.camera, read.reason, read.remarks)
