# SPDX-License-Identifier: Apache-2.0
"""Prefetch items in a thread, in bounded memory. Separate: replay and `imgu play` both use it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Prefetch(Generic[T]):
    """Iterates `items` in a thread of its own, ahead of the one that iterates this object.

    Parameters
    ----------
    items : iterated once, in the thread; what it raises is raised to the consumer, after the items before it
    size_of : bytes that an item takes
    limit_bytes : the thread pauses when it holds more; one item is held whatever its size
    """

    def __init__(self, items: Iterable[T], size_of: Callable[[T], int], limit_bytes: int = 128_000_000) -> None:
        self._items = items
        self._size_of = size_of
        self._limit = limit_bytes
        self._condition = threading.Condition()
        self._held: deque[T] = deque()
        self._bytes = 0
        self._ended = False
        self._closed = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._fill, name="prefetch", daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[T]:
        """Yield the items in order; end when they end or the object is closed."""
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._held or self._ended or self._closed)
                if self._closed:
                    return
                if not self._held:
                    if self._error is not None:
                        raise self._error
                    return
                item = self._held.popleft()
                self._bytes -= self._size_of(item)
                self._condition.notify_all()
            yield item

    def wait_filled(self, timeout_s: float) -> None:
        """Wait until the thread pauses, has read everything, or the time is over."""
        with self._condition:
            self._condition.wait_for(lambda: self._bytes >= self._limit or self._ended, timeout_s)

    def close(self) -> None:
        """End the thread."""
        with self._condition:
            self._closed = True
            self._held.clear()
            self._condition.notify_all()
        self._thread.join(timeout=1.0)

    def _fill(self) -> None:
        try:
            for item in self._items:
                with self._condition:
                    self._condition.wait_for(lambda: self._bytes < self._limit or self._closed)
                    if self._closed:
                        return
                    self._held.append(item)
                    self._bytes += self._size_of(item)
                    self._condition.notify_all()
        except Exception as error:
            self._error = error
        finally:
            with self._condition:
                self._ended = True
                self._condition.notify_all()
