# SPDX-License-Identifier: Apache-2.0
"""A logger that escapes text from outside; a file of its own, which rclpy skips when it looks for a line's caller."""

from __future__ import annotations

import os
from typing import Any

from rclpy.impl import rcutils_logger
from rclpy.impl.rcutils_logger import RcutilsLogger

from imgu_ros.shown_text import shown

# rclpy keeps the state of a throttled line by the line's caller, which is not this file. The list may not exist.
getattr(rcutils_logger, "_internal_callers", []).append(os.path.realpath(__file__))


class PlainLogger(RcutilsLogger):
    """A node's logger whose messages go through `shown`."""

    def log(self, message: str, severity: Any, **options: Any) -> bool:
        """Log a message; see rclpy."""
        return bool(super().log(shown(str(message)), severity, **options))
