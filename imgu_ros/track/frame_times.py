# SPDX-License-Identifier: Apache-2.0
"""Times of frames for predicting motion: their stamps where these rise, else evenly spaced."""

from __future__ import annotations

#: From one frame to the next where no two stamps have told it.
_USUAL_PERIOD_NS = 33_000_000
#: What is longer is a gap, not the time from one frame to the next.
_LONGEST_PERIOD_NS = 2_000_000_000


class FrameTimes:
    """Gives every frame a later time than the one before it, whatever the stamps are.

    A camera whose stamps are all 0, repeated, or set back for a moment takes its frames at its rate all the same.
    """

    def __init__(self) -> None:
        self._stamp_ns: int | None = None
        self._time_ns = 0
        self._period_ns = _USUAL_PERIOD_NS

    def of(self, stamp_ns: int) -> int:
        """Return the next frame's time: as much later as its stamp, or by the last interval where that is not later."""
        if self._stamp_ns is None:
            self._time_ns = stamp_ns
        else:
            passed_ns = stamp_ns - self._stamp_ns
            if 0 < passed_ns < _LONGEST_PERIOD_NS:
                self._period_ns = passed_ns
            self._time_ns += passed_ns if passed_ns > 0 else self._period_ns
        self._stamp_ns = stamp_ns
        return self._time_ns
