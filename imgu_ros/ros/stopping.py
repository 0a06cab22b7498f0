# SPDX-License-Identifier: Apache-2.0
"""Ends a process of this package cleanly on SIGINT and SIGTERM, in every phase.

rclpy's own handlers shut the context down under the threads that still publish; its executor waits in C, where a
Python handler cannot run. Here the first byte that the signal writes wakes the executor, and the handler only sets a
flag, except in a phase that is marked as interruptible.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType, TracebackType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequested(BaseException):
    """Raised in an interruptible phase when the process is asked to stop.

    Not an `Exception`: no handler of errors on the way up may take it for one.
    """


class StopSignal:
    """Handles SIGINT and SIGTERM while it is entered, in the main thread.

    A second signal does not interrupt the clean-up that the first one started.
    """

    def __init__(self) -> None:
        self._event = threading.Event()
        self._requested = False
        self._wakers: list[Callable[[], object]] = []
        self._interruptible = self._interrupted = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> StopSignal:
        self._read_end, self._write_end = os.pipe()
        os.set_blocking(self._write_end, False)
        self._previous = {number: signal.signal(number, self._on_signal) for number in SIGNALS}
        self._previous_fd = signal.set_wakeup_fd(self._write_end, warn_on_full_buffer=False)
        threading.Thread(target=self._wake, name="stop_signal", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.set_wakeup_fd(self._previous_fd)
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        os.close(self._write_end)  # ends the thread, which closes the other end

    @property
    def requested(self) -> bool:
        """Whether the process was asked to stop."""
        return self._requested

    def wait(self, timeout_s: float) -> bool:
        """Sleep until the process is asked to stop, or the time is over; return `requested`."""
        return self._requested or self._event.wait(timeout_s)

    def request(self) -> None:
        """Ask for the stop from inside the process."""
        self._requested = True
        self._event.set()
        self._call_wakers()

    def on_request(self, waker: Callable[[], object]) -> None:
        """Call `waker`, from another thread, when the process is asked to stop."""
        self._wakers.append(waker)

    @contextlib.contextmanager
    def interruptible(self) -> Iterator[None]:
        """Mark a phase of the main thread that a signal ends at once, by raising `StopRequested`."""
        if self.requested:
            raise StopRequested
        self._interruptible = True
        try:
            yield
        except Exception:
            if self._interrupted:
                # C code that was interrupted, as in an import, may have made an error of its own of it.
                raise StopRequested from None
            raise
        finally:
            self._interruptible = False

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # Not the event: the main thread may hold its lock at this very moment, inside `wait`.
        self._requested = True
        if self._interruptible:
            self._interruptible = False
            self._interrupted = True
            raise StopRequested

    def _wake(self) -> None:
        while number := os.read(self._read_end, 1):
            if number[0] in SIGNALS:
                # The main thread may be in C and reach its handler only after it was woken.
                self.request()
        os.close(self._read_end)

    def _call_wakers(self) -> None:
        for waker in list(self._wakers):
            with contextlib.suppress(Exception):  # what it would wake may be gone already
                waker()
