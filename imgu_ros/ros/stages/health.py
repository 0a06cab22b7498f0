# SPDX-License-Identifier: Apache-2.0
"""What /diagnostics says about a stage node."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from imgu_ros.messages.diagnostics import HealthEntry, Level
from imgu_ros.ros.meters import LatencyMeter, RateMeter
from imgu_ros.ros.stages.input import StageInput


@dataclass(frozen=True, slots=True)
class StageState:
    """What a stage node knows about itself: full name, lifecycle state, whether paused, whether listened to, domain."""

    name: str
    lifecycle: str
    paused: bool
    listened: bool
    domain: str

    @property
    def works(self) -> bool:
        """Whether the node is to take its inputs."""
        return self.lifecycle == "active" and not self.paused and self.listened

    @property
    def rest(self) -> str:
        """Why the node does not work; empty when it does."""
        if self.lifecycle != "active":
            return f"lifecycle state: {self.lifecycle}"
        if self.paused:
            return "paused: call ~/pause with false to go on"
        return "" if self.listened else f"idle: no subscribers in {self.domain}"


class StageFigures:
    """What became of the frames. Thread-safe."""

    def __init__(self) -> None:
        self.done = RateMeter()
        self.latency = LatencyMeter()
        self.rejections = 0
        self.reason = ""

    def worked(self, received_s: float, now_s: float) -> None:
        """Count a frame that came, with the last of its messages, at `received_s` and is published now."""
        self.done.tick(now_s)
        self.latency.add(now_s - received_s)
        self.reason = ""

    def rejected(self, reason: str) -> None:
        """Count a frame that could not be worked on."""
        self.rejections += 1
        self.reason = reason


def stage_health(
    state: StageState,
    figures: StageFigures,
    source: StageInput,
    skipped: int,
    unmatched_subscribers: int,
    remarks: Sequence[str],
) -> list[HealthEntry]:
    """Return the entries of /diagnostics.

    Parameters
    ----------
    state, figures, source : of the node
    skipped : frames that gave way to newer ones
    unmatched_subscribers : listeners that cannot be served, for their QoS does not fit
    remarks : what people should know of the last frame
    """
    now = time.monotonic()
    rest = state.rest
    reason = ""
    if not rest:
        rejected = f"rejected: {figures.reason}" if figures.reason else ""
        reason = source.why_silent() or rejected or "; ".join(remarks)
    names = ("latency_p50_ms", "latency_p95_ms", "latency_max_ms")
    output: dict[str, object] = {
        "lifecycle_state": state.lifecycle,
        "rate_hz": figures.done.rate_hz(now),
        "frames": figures.done.count,
        **dict(zip(names, figures.latency.percentiles_ms(), strict=False)),
        "subscribers_with_incompatible_qos": unmatched_subscribers,
    }
    taken: dict[str, object] = {f"{feed.name}_topic": feed.topic for feed in source.topics.feeds}
    if source.topics.camera_info:
        taken["camera_info_topic"] = source.topics.camera_info
    taken |= {
        "rate_hz": source.arrivals.rate_hz(now),
        "frames": source.arrivals.count,
        "lost": source.counters.lost,
        "skipped": skipped,
        "incomplete": source.incomplete,
        "rejected": figures.rejections,
        "absent": ", ".join(sorted(source.absent)),
        "publishers_with_incompatible_qos": source.counters.incompatible,
    }
    level = Level.WARN if reason else Level.OK
    return [
        HealthEntry(f"{state.name}: output", level, rest or reason or "works", output),
        HealthEntry(f"{state.name}: input", level, "not subscribed" if rest else reason or "frames come in", taken),
    ]
