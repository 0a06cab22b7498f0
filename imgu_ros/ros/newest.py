"""Between the callbacks, which only hand over, and the worker, which takes the newest."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

#: So long an item may wait without giving way to a newer one: a hold-up of a few frames at 120 Hz costs none of them.
_PATIENCE_S = 0.02
#: More never wait: an image is some megabytes.
_MOST = 4


class NewestSlot(Generic[T]):
    """Holds what came last; what has waited too long gives way to what is newer, and counts as skipped. Thread-safe.

    A worker that is held up for a moment so catches up, and one that is too slow works on the newest.

    Parameters
    ----------
    patience_s : how long an item may wait without giving way
    clock : tells the time, s
    """

    def __init__(self, patience_s: float = _PATIENCE_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._condition = threading.Condition()
        self._patience_s = patience_s
        self._clock = clock
        self._waiting: deque[tuple[float, T]] = deque()
        self._skipped = 0
        self._closed = False

    @property
    def skipped(self) -> int:
        """Items that gave way before anybody took them."""
        return self._skipped

    def put(self, item: T) -> None:
        """Hand over an item."""
        with self._condition:
            self._waiting.append((self._clock(), item))
            self._give_way()
            self._condition.notify()

    def take(self) -> T | None:
        """Wait for an item and take it; None once the slot is closed."""
        with self._condition:
            self._condition.wait_for(lambda: self._waiting or self._closed)
            if self._closed:
                return None
            self._give_way()
            return self._waiting.popleft()[1]

    def clear(self) -> None:
        """Drop what is held; it does not count as skipped."""
        with self._condition:
            self._waiting.clear()

    def close(self) -> None:
        """End every `take`, now and later."""
        with self._condition:
            self._closed = True
            self._waiting.clear()
            self._condition.notify_all()

    def _give_way(self) -> None:
        now = self._clock()
        while len(self._waiting) > _MOST or (len(self._waiting) > 1 and now - self._waiting[0][0] > self._patience_s):
            self._waiting.popleft()
            self._skipped += 1
