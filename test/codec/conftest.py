"""Both kinds of messages: every test that makes messages runs on rclpy's classes and on rosbags'."""

from __future__ import annotations

import pytest


@pytest.fixture(params=["ros", "bags"], scope="session")
def make(request):
    """A message factory."""
    if request.param == "ros":
        pytest.importorskip("sensor_msgs.msg", reason="the `ros` extra is not installed")
        from imgu_ros.ros.messages import make_message
    else:
        from imgu_ros.bags.messages import make_message
    return make_message
