# SPDX-License-Identifier: Apache-2.0
"""Messages from the bytes that a subscription delivers: in place by rosbags, else by rclpy.

rclpy's own conversion copies an image's pixels twice more, 2 ms of 1920x1080. A ROS installation from apt has nothing
else: no distribution packages rosbags.
"""

from __future__ import annotations

from typing import Any

from rclpy.serialization import deserialize_message

from imgu_ros.errors import BagError
from imgu_ros.ros.messages import message_class

try:
    from imgu_ros.bags.decoding import message_from_cdr
    from imgu_ros.bags.messages import typestore
except BagError:
    _HAS_ROSBAGS = False
else:
    _HAS_ROSBAGS = True


def prepare(type_name: str) -> None:
    """Make what a message of this type needs before the first one comes."""
    if _HAS_ROSBAGS:
        typestore().get_msgdef(type_name)


def message_from_bytes(type_name: str, data: bytes) -> Any:
    """Return the message that CDR with its encapsulation holds; with rosbags, its arrays are views of `data`.

    Parameters
    ----------
    type_name : "package/msg/Name"
    data : as it comes from the middleware

    Raises
    ------
    BagError
        If the bytes are none of this type.
    """
    return message_from_cdr(type_name, data) if _HAS_ROSBAGS else message_by_rclpy(type_name, data)


def message_by_rclpy(type_name: str, data: bytes) -> Any:
    """Return the same as rclpy makes it."""
    try:
        return deserialize_message(bytes(data), message_class(type_name))
    except Exception as error:  # which ones depends on the middleware
        raise BagError(f"{type_name}: {' '.join(str(error).split())}; need bytes of this type") from None
