# SPDX-License-Identifier: Apache-2.0
"""Whether a node's clock runs: with use_sim_time it stands still until /clock comes."""

from __future__ import annotations

from collections.abc import Iterator

from rclpy.node import Node

from imgu_ros.ros.cause import Cause, Kind
from imgu_ros.ros.meters import LatencyMeter

#: A /clock of 10 Hz that has not moved for so long stands still.
_STOPPED_S = 1.0
#: No image is worked on so late.
_OTHER_CLOCK_S = 60.0


def other_clock(node: Node, ages: LatencyMeter) -> Iterator[Cause]:
    """Yield that the images' stamps are not of the clock that use_sim_time makes the node follow.

    Without it, stamps of another clock are those of a recording, which is played as it was.

    Parameters
    ----------
    node : whose clock it is
    ages : from an image's stamp to its results, by that clock
    """
    middle = ages.percentiles_ms((50.0,))
    if not middle or not node.get_parameter("use_sim_time").value or abs(middle[0]) / 1e3 < _OTHER_CLOCK_S:
        return
    side = "behind" if middle[0] > 0 else "ahead of"
    said = f"stamps of the images are {abs(middle[0]) / 1e3:.0f} s {side} /clock: they are of another clock"
    yield Cause(
        Kind.STAMPS, f"{said}; give the driver use_sim_time as well, or set it to false here", case="other_clock"
    )


class ClockWatch:
    """Watches a node's clock, by looking at it now and then.

    Parameters
    ----------
    node : whose clock it is
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._time_ns: int | None = None
        self._since_s = 0.0

    def cause(self, now_s: float) -> Cause | None:
        """Return that the clock stands still, and what to do; None when it runs. `now_s` is monotonic."""
        if not self._node.get_parameter("use_sim_time").value:
            self._time_ns = None
            return None
        time_ns = self._node.get_clock().now().nanoseconds
        if time_ns != self._time_ns:
            self._time_ns, self._since_s = time_ns, now_s
        stopped_s = now_s - self._since_s
        if stopped_s < _STOPPED_S:
            return None
        if time_ns:
            return Cause(Kind.CLOCK, f"clock stopped: /clock stands at {time_ns / 1e9:.3f} s for {stopped_s:.0f} s")
        publisher = "has a publisher and sends nothing" if self._node.count_publishers("/clock") else "has no publisher"
        fix = "play with a clock (imgu play, ros2 bag play --clock), or set use_sim_time to false"
        return Cause(Kind.CLOCK, f"clock stopped: use_sim_time is true and /clock {publisher}; {fix}")
