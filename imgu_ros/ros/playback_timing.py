# SPDX-License-Identifier: Apache-2.0
"""Timing of playback: when recorded messages are published, and the report of what was played."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

#: Share of the recorded interval of two messages that passes between them while the player is late. Sending all late
#: messages at once would overrun subscribers.
_HURRY = 0.5


class PlaybackClock:
    """The timing of a recording, from the first message on; delays are made up at twice the speed.

    Parameters
    ----------
    rate : times the recorded speed, > 0
    clock : tells the time, s
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate = rate
        self._clock = clock
        self._first: tuple[int, float] | None = None
        self._last = (0, 0.0)

    @property
    def has_begun(self) -> bool:
        """Whether there was a message."""
        return self._first is not None

    def earliest(self, time_ns: int) -> float:
        """Return when, s of the clock, the message recorded at `time_ns` may be published; the first one: now."""
        if self._first is None:
            self._first = (time_ns, self._clock())
            self._last = self._first
        since_last_s = max(0, time_ns - self._last[0]) * 1e-9 / self._rate
        return max(self._due(time_ns), self._last[1] + _HURRY * since_last_s)

    def published(self, time_ns: int) -> float:
        """Note that the message recorded at `time_ns` is published now; return how late that is, s."""
        now = self._clock()
        self._last = (time_ns, now)
        return max(0.0, now - self._due(time_ns))

    def _due(self, time_ns: int) -> float:
        assert self._first is not None
        first_ns, origin = self._first
        return origin + (time_ns - first_ns) * 1e-9 / self._rate


@dataclass(frozen=True, slots=True, eq=False)
class PlayReport:
    """What was played.

    Attributes
    ----------
    published : messages by topic
    skipped_topics : topics whose message type is not installed
    recorded_s, took_s : time between first and last message: as recorded, and as published
    late_p99_ms, late_max_ms : how much later than due messages were handed to the middleware
    """

    published: Mapping[str, int]
    skipped_topics: tuple[str, ...]
    recorded_s: float
    took_s: float
    late_p99_ms: float
    late_max_ms: float

    @property
    def kept_rate(self) -> float:
        """Times the recorded speed that was reached; 0 when fewer than two messages were published."""
        return self.recorded_s / self.took_s if self.took_s > 0 else 0.0

    def lines(self) -> list[str]:
        """Return the report for people."""
        counts = ", ".join(f"{topic} {count}" for topic, count in self.published.items())
        speed = f"{self.recorded_s:.2f} s of the recording in {self.took_s:.2f} s: {self.kept_rate:.2f} x"
        late = f"late by {self.late_p99_ms:.1f} ms (p99), {self.late_max_ms:.1f} ms (most)"
        return [f"published {sum(self.published.values())} messages ({counts})", f"{speed}; {late}"]


class Span:
    """From when to when messages were recorded and published; rounds of a loop add up, their gaps do not."""

    def __init__(self) -> None:
        self.recorded_s = 0.0
        self.took_s = 0.0
        self._first: tuple[int, float] | None = None
        self._done = (0.0, 0.0)

    def add(self, time_ns: int, now_s: float) -> None:
        """Count a message."""
        if self._first is None:
            self._first = (time_ns, now_s)
        self.recorded_s = self._done[0] + (time_ns - self._first[0]) * 1e-9
        self.took_s = self._done[1] + now_s - self._first[1]

    def next_round(self) -> None:
        """Begin a round."""
        self._done = (self.recorded_s, self.took_s)
        self._first = None
