# SPDX-License-Identifier: Apache-2.0
"""Does the last step of a piece of work in a thread of its own, behind the one that goes on, in bounded memory."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Generic, Self, TypeVar

T = TypeVar("T")


class Background(Generic[T]):
    """Calls `work` with each item, in order, in a thread of its own; a context manager.

    Leaving it finishes what was put, after an error or an interrupt too, so that nothing is left half done.

    Parameters
    ----------
    work : what it raises is raised to the one who puts, at the next `put` or at the end; later items are dropped then
    limit : items that may wait; `put` waits while there are as many
    """

    def __init__(self, work: Callable[[T], None], limit: int = 4) -> None:
        self._work = work
        self._limit = limit
        self._condition = threading.Condition()
        self._waiting: deque[T] = deque()
        self._ended = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="background", daemon=True)
        self._thread.start()

    def put(self, item: T) -> None:
        """Hand over an item; wait while too many are waiting."""
        with self._condition:
            self._condition.wait_for(lambda: len(self._waiting) < self._limit or self._error is not None)
            self._raise()
            self._waiting.append(item)
            self._condition.notify_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._condition:
            self._ended = True
            self._condition.notify_all()
        self._thread.join()
        if error is None:  # else the error under way is the one to report
            self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._waiting or self._ended)
                if not self._waiting:
                    return
                item = self._waiting.popleft()
                self._condition.notify_all()
            try:
                self._work(item)
            except Exception as error:
                with self._condition:
                    self._error = error
                    self._waiting.clear()
                    self._condition.notify_all()
                return
            del item  # not held while nothing comes
