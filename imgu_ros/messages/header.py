# SPDX-License-Identifier: Apache-2.0
"""Stamps and frames: std_msgs/Header, rosgraph_msgs/Clock."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

from imgu_ros.errors import EncodingError
from imgu_ros.messages.factory import MessageFactory

#: Characters of a frame_id that goes on as it is.
LONGEST_FRAME_ID = 1024
_KEPT = 100
_PIECE = 1 << 20

_SECOND_NS = 1_000_000_000
_INT32 = range(-(2**31), 2**31)


@dataclass(frozen=True, slots=True)
class Header:
    """When and where: the stamp in nanoseconds and the name of the coordinate frame."""

    stamp_ns: int
    frame_id: str


def decode_header(message: Any) -> Header:
    """Read the header of `message` (any message with a `header` field).

    A part of a second that is a second and more, which no clock gives, counts as the second's last nanosecond. A
    leading slash, as ROS 1 wrote it, is not part of a frame's name: tf2 refuses names that have one.
    """
    stamp = message.header.stamp
    part_ns = min(int(stamp.nanosec), _SECOND_NS - 1)
    return Header(int(stamp.sec) * _SECOND_NS + part_ns, frame_name(str(message.header.frame_id)))


def frame_name(given: str) -> str:
    """Return a frame's name without leading slashes; of an endless one its two ends, its length and its CRC-32.

    What differs stays apart, and no message, table or log gets a name of a hundred megabytes.
    """
    if len(given) <= LONGEST_FRAME_ID:
        return given.lstrip("/")
    checksum = 0
    for start in range(0, len(given), _PIECE):  # no second copy of a name that is as long as that
        checksum = zlib.crc32(given[start : start + _PIECE].encode("utf-8", "surrogatepass"), checksum)
    return f"{given[:_KEPT].lstrip('/')}...({len(given)} characters, CRC-32 {checksum:08x})...{given[-_KEPT:]}"


def header_message(make: MessageFactory, header: Header) -> Any:
    """Return a std_msgs/Header.

    Raises
    ------
    EncodingError
        If the seconds do not fit the message's 32-bit field.
    """
    seconds, nanoseconds = divmod(header.stamp_ns, _SECOND_NS)
    if seconds not in _INT32:
        raise EncodingError(f"stamp: {header.stamp_ns} ns; need seconds that fit 32 bits ({_INT32[0]} to {_INT32[-1]})")
    stamp = make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=header.frame_id)


def clock_message(make: MessageFactory, time_ns: int) -> Any:
    """Return a rosgraph_msgs/Clock that shows `time_ns`."""
    return make("rosgraph_msgs/msg/Clock", clock=header_message(make, Header(time_ns, "")).stamp)
