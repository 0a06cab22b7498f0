# SPDX-License-Identifier: Apache-2.0
"""Meters of rates and latencies over the last seconds."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np

#: Maximum number of simultaneous events that a window keeps.
_MOST_AT_ONCE = 1000


class RateMeter:
    """Counts events, and their rate over a sliding window. Thread-safe.

    Parameters
    ----------
    window_s : length of the window
    """

    def __init__(self, window_s: float = 5.0) -> None:
        self._window_s = window_s
        self._lock = threading.Lock()
        self._times: deque[float] = deque()
        self._count = 0

    @property
    def count(self) -> int:
        """Events since the start."""
        return self._count

    def tick(self, now_s: float, events: int = 1) -> None:
        """Count an event, or several at once, at `now_s` (monotonic)."""
        with self._lock:
            self._count += events
            self._times.extend([now_s] * min(events, _MOST_AT_ONCE))
            self._forget(now_s)

    def recent(self, now_s: float) -> int:
        """Return how many events lie in the window that ends at `now_s`."""
        with self._lock:
            self._forget(now_s)
            return len(self._times)

    def rate_hz(self, now_s: float) -> float:
        """Return events per second in the window that ends at `now_s`; 0 with fewer than two."""
        with self._lock:
            self._forget(now_s)
            if len(self._times) < 2:
                return 0.0
            span = self._times[-1] - self._times[0]
            return (len(self._times) - 1) / span if span > 0 else 0.0

    def _forget(self, now_s: float) -> None:
        while self._times and self._times[0] < now_s - self._window_s:
            self._times.popleft()


class LatencyMeter:
    """Keeps the last latencies. Thread-safe.

    Parameters
    ----------
    size : how many are kept
    """

    def __init__(self, size: int = 200) -> None:
        self._lock = threading.Lock()
        self._values: deque[float] = deque(maxlen=size)

    def add(self, seconds: float) -> None:
        """Add a latency."""
        with self._lock:
            self._values.append(seconds)

    def percentiles_ms(self, wanted: tuple[float, ...] = (50.0, 95.0, 100.0)) -> list[float]:
        """Return percentiles in ms; empty when there are no values."""
        with self._lock:
            values = list(self._values)
        return [float(v) * 1e3 for v in np.percentile(values, wanted)] if values else []
