# SPDX-License-Identifier: Apache-2.0
"""Detects that the process was suspended (SIGSTOP, a sleeping laptop, no processor time), and which messages are older.

The middleware keeps the last messages from before and those that came meanwhile. When the process continues they would
be processed first.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

#: An interval between calls from which the process was suspended.
_STANDSTILL_S = 1.0
#: A message sent so shortly before the end is not old.
_FRESH_NS = 100_000_000
#: Stamps whose shortest delay changes by more, from the older half of the messages to the newer, follow another clock.
_DRIFT_NS = 500_000_000
#: The middleware delivers the last old message within this time.
_DELIVERED_S = 2.0
#: A standstill is reported for so long, the window of the rates.
_TOLD_S = 5.0
_DELAYS = 100


class Standstill:
    """Detects a standstill by the interval between its calls, which are many a second. Thread-safe.

    Parameters
    ----------
    elapsed_s : a clock that goes on while the machine sleeps
    now_s : the clock of `precedes`
    wall_ns : the clock of the stamps, but for an offset that may be any
    """

    def __init__(
        self,
        elapsed_s: Callable[[], float] = lambda: time.clock_gettime(time.CLOCK_BOOTTIME),
        now_s: Callable[[], float] = time.monotonic,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._elapsed_s, self._now_s, self._wall_ns = elapsed_s, now_s, wall_ns
        self._lock = threading.Lock()
        self._beat_s: float | None = None
        self._is_excused = False
        self._ended_s = self._ended_elapsed_s = -_TOLD_S
        self._ended_wall_ns = 0
        self._drifted = False
        self._lasted_s = 0.0
        self._delays_ns: deque[int] = deque(maxlen=_DELAYS)
        self._dropped = 0
        self._is_told = True

    @property
    def ended_s(self) -> float:
        """When the last standstill ended, by `now_s`; in the past when there was none."""
        return self._ended_s

    def begin(self) -> None:
        """Start: calls are expected from now on."""
        with self._lock:
            self._beat_s = self._elapsed_s()
            self._delays_ns.clear()

    def end(self) -> None:
        """Stop: no standstill is detected until `begin`."""
        with self._lock:
            self._beat_s = None

    @contextlib.contextmanager
    def excused(self) -> Iterator[None]:
        """Mark a delay by the node itself, such as a long frame: it is no standstill."""
        with self._lock:
            self._look()
            self._is_excused = True
        try:
            yield
        finally:
            with self._lock:
                self._is_excused = False
                if self._beat_s is not None:
                    self._beat_s = self._elapsed_s()

    def precedes(self, received_s: float) -> bool:
        """Return whether a message received at a time, by `now_s`, is from before the end of the last standstill."""
        with self._lock:
            self._look()
            is_old = received_s <= self._ended_s
            self._dropped += is_old
            return is_old

    def is_old(self, stamp_ns: int) -> bool:
        """Return whether a message that is delivered now is from before the end of a standstill that is just over.

        Where stamps clearly follow another clock (a simulation or a bag at two thirds of the rate or less, a loop) no
        message is taken for old; where they drift by less, some of the first two seconds are taken for the wrong kind.

        Parameters
        ----------
        stamp_ns : of the message's header; 0 or less where there is none
        """
        with self._lock:
            self._look()
            if stamp_ns <= 0:
                return False
            known = self._delays_ns
            if self._elapsed_s() - self._ended_elapsed_s > _DELIVERED_S or not known or self._drifted:
                known.append(self._wall_ns() - stamp_ns)
                return False
            # The stamps' clock may be another machine's: the shortest delay of a message is taken for the offset.
            is_old = stamp_ns + min(self._delays_ns) < self._ended_wall_ns - _FRESH_NS
            self._dropped += is_old
            return is_old

    def _drift(self) -> bool:
        """Return whether stamps drift or jump against the wall clock: a simulation, a bag at another rate."""
        known = list(self._delays_ns)
        middle = len(known) // 2
        return middle > 0 and abs(min(known[:middle]) - min(known[middle:])) > _DRIFT_NS

    def news(self) -> str:
        """Return a line about a standstill that is over, once, when the old messages have come; else nothing."""
        with self._lock:
            self._look()
            if self._is_told or self._elapsed_s() - self._ended_elapsed_s < 0.5 * _DELIVERED_S:
                return ""
            self._is_told = True
            return self._text()

    def lately(self) -> str:
        """Return the line for some seconds after the end; then nothing."""
        with self._lock:
            self._look()
            return self._text() if self._elapsed_s() - self._ended_elapsed_s < _TOLD_S else ""

    def _look(self) -> None:
        if self._beat_s is None or self._is_excused:
            return
        last_s, self._beat_s = self._beat_s, self._elapsed_s()
        if self._beat_s - last_s < _STANDSTILL_S:
            return
        self._lasted_s = self._beat_s - last_s
        self._ended_s, self._ended_elapsed_s = self._now_s(), self._beat_s
        self._ended_wall_ns = self._wall_ns()
        self._drifted = self._drift()
        self._dropped, self._is_told = 0, False

    def _text(self) -> str:
        dropped = f"{self._dropped} old frame{'' if self._dropped == 1 else 's'} dropped"
        return f"suspended, or without processor time, for {self._lasted_s:.1f} s: {dropped}"
