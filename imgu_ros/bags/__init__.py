# SPDX-License-Identifier: Apache-2.0
"""Recordings: read, written, and salvaged.

Raises
------
BagError
    Where rosbags is not installed: pip installs it with this package, and no ROS distribution packages it.
"""

from importlib import import_module

from imgu_ros.errors import BagError

try:
    import_module("rosbags")
except ModuleNotFoundError:
    raise BagError(
        "rosbags: not installed, and recordings cannot be read or written without; need: pip install rosbags"
    ) from None
