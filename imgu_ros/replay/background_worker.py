# SPDX-License-Identifier: Apache-2.0
"""A thread that works off a bounded queue. Separate, because both kinds of result sink use it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Generic, Self, TypeVar

T = TypeVar("T")


class BackgroundWorker(Generic[T]):
    """Calls `work` with each item, in order, in a thread of its own; a context manager.

    Leaving it finishes what was put, after an error or an interrupt too, so that nothing is left half done.

    Parameters
    ----------
    work : its exception is raised by the next `put` or on leaving; later items are dropped
    limit : number of items that may wait; `put` blocks while there are as many
    patience_s : longest wait for one item; beyond it `put` and leaving raise TimeoutError, and the thread is left to
        itself
    """

    def __init__(self, work: Callable[[T], None], limit: int = 4, patience_s: float = threading.TIMEOUT_MAX) -> None:
        self._work = work
        self._limit = limit
        self._patience_s = patience_s
        self._condition = threading.Condition()
        self._waiting: deque[T] = deque()
        self._ended = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="background", daemon=True)
        self._thread.start()

    def put(self, item: T) -> None:
        """Hand over an item; wait while too many are waiting."""
        with self._condition:
            has_room = self._condition.wait_for(
                lambda: len(self._waiting) < self._limit or self._error is not None, self._patience_s
            )
            self._raise()
            if not has_room:
                raise TimeoutError
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
        left = -1
        while self._thread.is_alive() and left != len(self._waiting):
            left = len(self._waiting)
            self._thread.join(self._patience_s)
        if error is None:  # else the error under way is the one to report
            self._raise()
            if self._thread.is_alive():
                raise TimeoutError

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
