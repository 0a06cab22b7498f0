# SPDX-License-Identifier: Apache-2.0
"""Between the callbacks, which only hand over, and the worker."""

from __future__ import annotations

import math
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")

#: A worker that has not been up with what comes for so long is too slow; before, it is held up and will catch up.
_PATIENCE_S = 0.25
#: More never wait: an image is some megabytes.
_MOST = 12
#: So many senders are told apart, by the time that they took lately.
_SENDERS = 8
_LATELY_S = 2.0


class FrameQueue(Generic[T]):
    """Holds what comes: all of it for a worker that keeps up, the newest for one that is too slow. Thread-safe.

    A worker keeps up if it has, now and then, taken all that came. If it is held up for a moment what comes waits for
    it; if it has been behind for longer all but the newest gives way, and counts as skipped.

    Of several senders each is looked at by itself, and the one comes first that took the least of the worker's time
    lately; a new one comes last. While the worker is at another's item nobody is behind: who sends what takes long does
    not cost the others their frames, but for those beyond a dozen. Eight are told apart; all others count as one until
    one of the eight has been silent for two seconds: endlessly many names do not cost one that stays its frames.

    Parameters
    ----------
    patience_s : how long a worker may be behind before what is old gives way
    clock : tells the time, s
    is_old : tells whether an item is not worth taking any more
    sender : tells whose an item is
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
        self._senders: OrderedDict[str | None, _Sender[T]] = OrderedDict()  # who sent last, last; None: all others
        self._served: _Sender[T] | None = None
        self._looked_s = clock()
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
        """Wait for an item and take it; None once the slot is closed."""
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
        """Drop what is held; it does not count as skipped."""
        with self._condition:
            self._senders.clear()

    def close(self) -> None:
        """End every `take`, now and later."""
        with self._condition:
            self._closed = True
            self._senders.clear()
            self._condition.notify_all()

    def _known_name(self, name: str, now_s: float) -> str | None:
        """Return the name that a sender is told apart by; None when it is one of the others."""
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
        """Count the time since the last look for the sender whose item was taken; what is long ago counts less."""
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
        """Return for how long the worker has not been up with a sender; its work for another does not count."""
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
    """One sender: the worker's time that it took lately, what waits, since when not all of it has been taken.

    `last_s`: when it sent last.
    """

    used_s: float
    last_s: float = 0.0
    waiting: deque[T] = field(default_factory=deque)
    behind_since_s: float | None = None
