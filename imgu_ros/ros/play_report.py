# SPDX-License-Identifier: Apache-2.0
"""What was played, and how well the timing was kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


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
