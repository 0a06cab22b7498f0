"""Whether a node's clock runs: with use_sim_time it stands still until /clock comes."""

from __future__ import annotations

from rclpy.node import Node

from imgu_ros.ros.cause import Cause, Kind

#: A /clock of 10 Hz that has not moved for so long stands still.
_STOPPED_S = 1.0


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
