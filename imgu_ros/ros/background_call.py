# SPDX-License-Identifier: Apache-2.0
"""Work that takes long, beside the executor's thread: a coroutine that a service awaits."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from rclpy.executors import Executor
from rclpy.task import Future

from imgu_ros.threads import quick_thread_switches

T = TypeVar("T")


class BackgroundCall:
    """Does one thing at a time in a thread of its own, while the executor calls other callbacks."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None

    async def do(self, work: Callable[[], T], executor: Executor) -> T:
        """Return what `work` returns, and raise what it raises.

        Parameters
        ----------
        work : called in another thread
        executor : runs the coroutine; it goes on with it when the work is done
        """
        future = Future(executor=executor)

        def run() -> None:
            try:
                with quick_thread_switches():
                    result = work()
            except Exception as error:
                future.set_exception(error)
            else:
                future.set_result(result)
            # It waits in C for something to happen.
            executor.wake()

        self._thread = threading.Thread(target=run, name="beside", daemon=True)
        self._thread.start()
        done: T = await future
        return done

    def close(self, timeout_s: float) -> bool:
        """Wait for the work's end; return whether it has come in time."""
        if self._thread is not None:
            self._thread.join(timeout_s)
        return self._thread is None or not self._thread.is_alive()
