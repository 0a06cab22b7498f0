# SPDX-License-Identifier: Apache-2.0
"""SIGINT, SIGTERM and SIGHUP of a command: one of them stops it, and what it was writing is completed.

A live node has its own: `imgu_ros.ros.stopping`.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from types import FrameType, TracebackType

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Stopped(KeyboardInterrupt):
    """Raised in the main thread by the first signal; handled wherever Ctrl-C is.

    Attributes
    ----------
    number : of the signal
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class _State:
    """What the signals of this process found; there is one, as there is one handler of a signal."""

    requested = 0
    held = 0


@contextlib.contextmanager
def stop_signals() -> Iterator[None]:
    """Raise `Stopped` at the first of the signals; those that follow are ignored, so that files can be completed.

    A signal that was ignored when the process began stays ignored (nohup). Does nothing but in the main thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {
        number: signal.signal(number, _on_signal) for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        _State.requested = _State.held = 0


def requested() -> int:
    """Return the number of the signal that asked for a stop; 0 without one."""
    return _State.requested


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Mark a short stretch of the main thread that no signal interrupts: the stop is raised at its end."""
    _State.held += 1
    try:
        yield
    finally:
        _State.held -= 1
    if _State.requested and not _State.held:
        raise Stopped(_State.requested)


class HeldExitStack(ExitStack):
    """An `ExitStack` whose clean-up no signal interrupts."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        with held():
            return bool(super().__exit__(kind, error, trace))


@contextlib.contextmanager
def blocked() -> Iterator[None]:
    """Keep the signals from this thread: a process that is started meanwhile never gets them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _on_signal(number: int, frame: FrameType | None) -> None:
    if not _State.requested:
        _State.requested = number
        if not _State.held:
            raise Stopped(number)
