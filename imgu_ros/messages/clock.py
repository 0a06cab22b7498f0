# SPDX-License-Identifier: Apache-2.0
"""rosgraph_msgs/Clock."""

from __future__ import annotations

from typing import Any

from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message


def clock_message(make: MessageFactory, time_ns: int) -> Any:
    """Return a rosgraph_msgs/Clock that shows `time_ns`."""
    return make("rosgraph_msgs/msg/Clock", clock=header_message(make, Header(time_ns, "")).stamp)
