# SPDX-License-Identifier: Apache-2.0
"""Builds the localizer for changed parameters in a thread of its own, so that no frame waits for it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ImguError
from imgu_ros.localizer import PreparedLocalizer, prepare_localizer
from imgu_ros.threads import quick_thread_switches

#: The longest pause between two builds, s.
_LONGEST_REST_S = 1.0


class Rebuilder:
    """Builds for the newest parameters requested, one at a time, in a thread that ends with its work.

    Parameters
    ----------
    failed : takes a line about parameters with which no localizer can be built; called in the thread
    """

    def __init__(self, failed: Callable[[str], None]) -> None:
        self._failed = failed
        self._lock = threading.Lock()
        self._wanted: _Order | None = None
        self._tried: Parameters | None = None
        self._done: PreparedLocalizer | None = None
        self._thread: threading.Thread | None = None
        self._closed = threading.Event()

    def ask(self, before: PreparedLocalizer, parameters: Parameters) -> None:
        """Ask for a localizer like `before` with other parameters; returns at once, and may be called repeatedly."""
        with self._lock:
            if parameters is self._tried or self._closed.is_set():
                return
            self._wanted = _Order(before, parameters)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="rebuilder", daemon=True)
                self._thread.start()

    def take(self) -> PreparedLocalizer | None:
        """Return the localizer built since the last call; None when there is none."""
        with self._lock:
            done, self._done = self._done, None
            return done

    def forget(self) -> None:
        """Drop request and result: the targets have changed."""
        with self._lock:
            self._wanted = self._tried = self._done = None

    def close(self, timeout_s: float) -> bool:
        """End the thread; return whether it has ended in time."""
        with self._lock:
            self._closed.set()
            self._wanted = None
            thread = self._thread
        if thread is not None:
            thread.join(timeout_s)
        return thread is None or not thread.is_alive()

    def _run(self) -> None:
        with quick_thread_switches():
            while (order := self._next()) is not None:
                start = time.monotonic()
                self._make(order)
                # Parameters may change all the time: at least half of it is left to the frames.
                self._closed.wait(min(time.monotonic() - start, _LONGEST_REST_S))

    def _make(self, order: _Order) -> None:
        try:
            built = prepare_localizer(order.before.images, order.parameters, order.before)
        except ImguError as error:
            self._failed(f"parameters: {error}; the old parameters stay in use")
        except Exception as error:
            # The old localizer stays in use; later parameters may be valid.
            self._failed(f"parameters: {type(error).__name__}: {error}; the old parameters stay in use")
        else:
            with self._lock:
                self._done = built if self._tried is order.parameters else None

    def _next(self) -> _Order | None:
        with self._lock:
            order, self._wanted = self._wanted, None
            if order is None:
                self._thread = None
            else:
                self._tried = order.parameters
            return order


@dataclass(frozen=True, slots=True, eq=False)
class _Order:
    """A localizer to build: like `before`, with these parameters."""

    before: PreparedLocalizer
    parameters: Parameters
