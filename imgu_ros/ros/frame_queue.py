# SPDX-License-Identifier: Apache-2.0
"""Queue of frames between the callbacks and the worker."""

from __future__ import annotations

import math
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")

#: A worker that has not emptied the queue for so long is too slow; before that it is delayed and will catch up.
_PATIENCE_S = 0.25
#: Maximum number of items: an image is some megabytes.
_MOST = 12
#: Number of senders that are distinguished, and the time constant of the processing time counted for each.
_SENDERS = 8
_LATELY_S = 2.0


class FrameQueue(Generic[T]):
    """Keeps all items for a worker that keeps up, and the newest for one that is too slow. Thread-safe.

    A worker keeps up if it has emptied the queue within `patience_s`. After that all but the newest item are dropped
    and count as skipped.

    Senders are treated separately, and the one that used the least of the worker's time recently is served first; a
    new one is served last. The time of other senders' items does not count as delay, so a sender of slow items does not
    cost the others their frames, up to twelve items in all. Eight senders are distinguished; all others share one place
    until one of the eight has been silent for two seconds, so that endlessly many names displace no steady sender.

    Parameters
    ----------
    patience_s : how long a worker may be behind before old items are dropped
    clock : tells the time, s
    is_old : whether an item is to be skipped
    sender : name of an item's sender
    """

    def __init__(
        self,
        patience_s: float = _PATIENCE_S,
        clock: Callable[[], float] = time.monotonic,
        is_old: Callable[[T], bool] = lambda _: False,
        sender: Callable[[T], str] = lambda _: "",
    ) -> None:
        self._condition = threading.Condition()
        self._patience_s = patience_s
        self._clock = clock
        self._is_old = is_old
        self._sender = sender
        self._senders: OrderedDict[str | None, _Sender[T]] = OrderedDict()  # the latest sender last; None: all others
        self._served: _Sender[T] | None = None
        self._looked_s = clock()
        self._skipped = 0
        self._closed = False

    @property
    def skipped(self) -> int:
        """Items that were dropped."""
        return self._skipped

    def skip(self) -> None:
        """Count an item that was dropped before it was put."""
        with self._condition:
            self._skipped += 1

    def put(self, item: T) -> None:
        """Add an item."""
        with self._condition:
            now_s = self._clock()
            name = self._known_name(self._sender(item), now_s)
            if name not in self._senders:
                used_s = max((sender.used_s for sender in self._senders.values()), default=0.0)
                self._senders[name] = _Sender(used_s)
            sender = self._senders[name]
            self._senders.move_to_end(name)
            sender.last_s = now_s
            if sender.behind_since_s is None:
                sender.behind_since_s = now_s
            sender.waiting.append(item)
            self._give_way()
            self._condition.notify()

    def take(self) -> T | None:
        """Wait for an item and take it; None once the queue is closed."""
        with self._condition:
            while True:
                self._charge()
                for sender in self._senders.values():
                    if not sender.waiting:
                        sender.behind_since_s = None
                self._condition.wait_for(lambda: self._closed or self._is_waiting())
                if self._closed:
                    return None
                self._charge()
                self._give_way()
                waiting = [sender for sender in self._senders.values() if sender.waiting]
                self._served = min(waiting, key=lambda sender: sender.used_s)
                item = self._served.waiting.popleft()
                if not self._is_old(item):
                    return item
                self._skipped += 1

    def clear(self) -> None:
        """Drop all items; they do not count as skipped."""
        with self._condition:
            self._senders.clear()

    def close(self) -> None:
        """End every `take`, now and later."""
        with self._condition:
            self._closed = True
            self._senders.clear()
            self._condition.notify_all()

    def _known_name(self, name: str, now_s: float) -> str | None:
        """Return the name under which a sender is kept; None for the shared place."""
        if name in self._senders or len(self._senders.keys() - {None}) < _SENDERS:
            return name
        for known, sender in self._senders.items():
            if known is not None and not sender.waiting and now_s - sender.last_s > _LATELY_S:
                del self._senders[known]
                return name
        return None

    def _is_waiting(self) -> bool:
        return any(sender.waiting for sender in self._senders.values())

    def _charge(self) -> None:
        """Add the time since the last call to the sender whose item was taken; older times decay."""
        now_s = self._clock()
        passed_s, self._looked_s = now_s - self._looked_s, now_s
        if self._served is not None:
            for sender in self._senders.values():
                if sender is not self._served and sender.behind_since_s is not None:
                    sender.behind_since_s = now_s - self._behind_s(sender, now_s, now_s - passed_s)
            self._served.used_s += passed_s
            self._served = None
        left = math.exp(-passed_s / _LATELY_S)
        for sender in self._senders.values():
            sender.used_s *= left

    def _behind_s(self, sender: _Sender[T], now_s: float, looked_s: float) -> float:
        """Return for how long the worker has been behind with a sender, without its time for others."""
        if sender.behind_since_s is None:
            return 0.0
        is_others = self._served is not None and self._served is not sender
        return (min(now_s, max(looked_s, sender.behind_since_s)) if is_others else now_s) - sender.behind_since_s

    def _give_way(self) -> None:
        now_s = self._clock()
        for sender in self._senders.values():
            while self._behind_s(sender, now_s, self._looked_s) > self._patience_s and len(sender.waiting) > 1:
                sender.waiting.popleft()
                self._skipped += 1
        while sum(len(sender.waiting) for sender in self._senders.values()) > _MOST:
            max(self._senders.values(), key=lambda sender: len(sender.waiting)).waiting.popleft()
            self._skipped += 1


@dataclass(slots=True, eq=False)
class _Sender(Generic[T]):
    """One sender: the worker's time that it used recently, its items, and since when not all of them were taken.

    `last_s`: time of its last item.
    """

    used_s: float
    last_s: float = 0.0
    waiting: deque[T] = field(default_factory=deque)
    behind_since_s: float | None = None
