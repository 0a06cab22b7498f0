# SPDX-License-Identifier: Apache-2.0
"""Causes that keep poses from being published, and which of them have been logged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from rclpy.node import Node

from imgu_ros.ros.meters import LatencyMeter

#: A cause that was gone for so long is news when it comes back.
_FORGOTTEN_S = 60.0
#: A /clock of 10 Hz that has not moved for so long stands still.
_STOPPED_S = 1.0
#: No image is processed so late.
_OTHER_CLOCK_S = 60.0


class CauseKind(StrEnum):
    """Kinds of causes, in the order in which they are checked."""

    LIFECYCLE = "lifecycle"  #: the node is not active
    PAUSED = "paused"
    LISTENER = "listener"  #: a subscriber asks for a quality of service that its output does not offer
    IDLE = "idle"  #: no output has a subscriber
    CLOCK = "clock"  #: use_sim_time, and /clock stands still
    MEMORY = "shared_memory"  #: it is full
    NO_PUBLISHER = "no_publisher"
    WRONG_TYPE = "wrong_type"
    QOS = "qos"  #: the input's publishers offer less than is asked for
    HELD_UP = "held_up"  #: the process was suspended, or one frame occupies the worker
    LOST = "lost"  #: images are lost on the way
    SILENT = "silent"  #: a publisher, and no images
    REJECTED = "rejected"  #: images come and cannot be read
    NO_TARGETS = "no_targets"
    WAITING = "waiting"  #: for the first frame
    UNCALIBRATED = "uncalibrated"
    UNPAIRED = "unpaired"  #: no camera_info has an image's stamp
    NOT_SEEN = "not_seen"
    NO_POSE = "no_pose"  #: a target is seen, and its pose is ambiguous or its size unknown
    FRAMES = "frames"  #: there are poses, and no place for them among the frames of the map and of /tf
    PUBLISHERS = "publishers"  #: poses come out, and several cameras share a topic
    FRAME_ID = "frame_id"  #: poses come out, and the images' frame_id is no name of a frame
    STAMPS = "stamps"  #: poses come out, and the images' stamps do not rise, or are of another clock
    SIZE = "size"  #: poses come out, and a target is implausibly far for its width


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause that keeps poses from being published.

    Attributes
    ----------
    kind : what it is
    text : one line for people, with what to do
    is_logged : whether it is logged elsewhere
    case : which of its kind it is, when several can hold at once
    """

    kind: CauseKind
    text: str
    is_logged: bool = False
    case: str = ""


#: Normal states of a node, and causes that are logged where they occur.
_NOT_LOGGED = frozenset((CauseKind.IDLE, CauseKind.WAITING, CauseKind.REJECTED, CauseKind.FRAMES))


class CauseLog:
    """Selects the causes that are new, so that each kind, and each case of it, is logged once.

    A cause is logged again when it returns after a minute without it.
    """

    def __init__(self) -> None:
        self._seen_s: dict[tuple[CauseKind, str], float] = {}

    def news(self, causes: Iterable[Cause], now_s: float) -> Iterator[Cause]:
        """Yield the causes that have not been logged yet; `now_s` is monotonic."""
        for cause in causes:
            if cause.kind in _NOT_LOGGED or cause.is_logged:
                continue
            key = (cause.kind, cause.case)
            last_s = self._seen_s.get(key)
            self._seen_s[key] = now_s
            if last_s is None or now_s - last_s > _FORGOTTEN_S:
                yield cause

    def clear(self) -> None:
        """Log every cause again: the node was activated."""
        self._seen_s.clear()


def other_clock(node: Node, ages: LatencyMeter) -> Iterator[Cause]:
    """Yield a cause when the images' stamps are of another clock than the one that use_sim_time makes the node follow.

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
        CauseKind.STAMPS, f"{said}; give the driver use_sim_time as well, or set it to false here", case="other_clock"
    )


class ClockWatch:
    """Detects that a node's clock has stopped.

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
            return Cause(
                CauseKind.CLOCK, f"clock stopped: /clock stands at {time_ns / 1e9:.3f} s for {stopped_s:.0f} s"
            )
        publisher = "has a publisher and sends nothing" if self._node.count_publishers("/clock") else "has no publisher"
        fix = "play with a clock (imgu play, ros2 bag play --clock), or set use_sim_time to false"
        return Cause(CauseKind.CLOCK, f"clock stopped: use_sim_time is true and /clock {publisher}; {fix}")
