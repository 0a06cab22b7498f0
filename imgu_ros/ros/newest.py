# SPDX-License-Identifier: Apache-2.0
"""Between the callbacks, which only hand over, and the worker."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

#: A worker that has not been up with what comes for so long is too slow; before, it is held up and will catch up.
_PATIENCE_S = 0.25
#: More never wait: an image is some megabytes.
_MOST = 12


class NewestSlot(Generic[T]):
    """Holds what comes: all of it for a worker that keeps up, the newest for one that is too slow. Thread-safe.

    A worker keeps up if it has, now and then, taken all that came. If it is held up for a moment what comes waits for
    it; if it has been behind for longer all but the newest gives way, and counts as skipped.

    Parameters
    ----------
    patience_s : how long a worker may be behind before what is old gives way
    clock : tells the time, s
    is_old : tells whether an item is not worth taking any more
    """

    def __init__(
        self,
        patience_s: float = _PATIENCE_S,
        clock: Callable[[], float] = time.monotonic,
        is_old: Callable[[T], bool] = lambda _: False,
    ) -> None:
        self._condition = threading.Condition()
        self._patience_s = patience_s
        self._clock = clock
        self._is_old = is_old
        self._waiting: deque[T] = deque()
        # Since when the worker has not taken all that came; None: it has.
        self._behind_since_s: float | None = None
        self._skipped = 0
        self._closed = False

    @property
    def skipped(self) -> int:
        """Items that gave way before anybody took them."""
        return self._skipped

    def skip(self) -> None:
        """Count an item as skipped that is not worth handing over."""
        with self._condition:
            self._skipped += 1

    def put(self, item: T) -> None:
        """Hand over an item."""
        with self._condition:
            if self._behind_since_s is None:
                self._behind_since_s = self._clock()
            self._waiting.append(item)
            self._give_way()
            self._condition.notify()

    def take(self) -> T | None:
        """Wait for an item and take it; None once the slot is closed."""
        with self._condition:
            while True:
                if not self._waiting:
                    self._behind_since_s = None
                self._condition.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return None
                self._give_way()
                item = self._waiting.popleft()
                if not self._is_old(item):
                    return item
                self._skipped += 1

    def clear(self) -> None:
        """Drop what is held; it does not count as skipped."""
        with self._condition:
            self._waiting.clear()
            self._behind_since_s = None

    def close(self) -> None:
        """End every `take`, now and later."""
        with self._condition:
            self._closed = True
            self._waiting.clear()
            self._condition.notify_all()

    def _give_way(self) -> None:
        behind_s = 0.0 if self._behind_since_s is None else self._clock() - self._behind_since_s
        most = 1 if behind_s > self._patience_s else _MOST
        while len(self._waiting) > most:
            self._waiting.popleft()
            self._skipped += 1
