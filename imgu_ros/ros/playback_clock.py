# SPDX-License-Identifier: Apache-2.0
"""When recorded messages are to be published."""

from __future__ import annotations

import time
from collections.abc import Callable

#: Of the time between two recorded messages, what must pass between them when the player is late. A hold-up that ends
#: in all that is late at once overruns subscribers that are as fast as they need to be.
_HURRY = 0.5


class PlaybackClock:
    """The timing of a recording, from the first message on; what was held up is made good at twice the speed.

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
