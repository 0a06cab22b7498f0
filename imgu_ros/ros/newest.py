"""The slot between the callbacks, which only hand over, and the worker, which takes the newest."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class NewestSlot(Generic[T]):
    """Holds one item; a newer one replaces it, and the replaced one counts as skipped. Thread-safe."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._item: T | None = None
        self._skipped = 0
        self._closed = False

    @property
    def skipped(self) -> int:
        """Items that were replaced before anybody took them."""
        return self._skipped

    def put(self, item: T) -> bool:
        """Hand over an item; return whether it replaced one."""
        with self._condition:
            replaced = self._item is not None
            self._skipped += replaced
            self._item = item
            self._condition.notify()
            return replaced

    def take(self) -> T | None:
        """Wait for an item and take it; None once the slot is closed."""
        with self._condition:
            self._condition.wait_for(lambda: self._item is not None or self._closed)
            if self._closed:
                return None
            item, self._item = self._item, None
            return item

    def clear(self) -> None:
        """Drop what is held; it does not count as skipped."""
        with self._condition:
            self._item = None

    def close(self) -> None:
        """End every `take`, now and later."""
        with self._condition:
            self._closed = True
            self._item = None
            self._condition.notify_all()
