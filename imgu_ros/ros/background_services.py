# SPDX-License-Identifier: Apache-2.0
"""Services that take long: their work runs in a thread, while the executor calls other callbacks.

rclpy's events executor runs no coroutines, so a service cannot await its work there. Instead its callback returns a
note, the service's `send_response` keeps that back, and the response is sent when the work has ended.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from imgu_ros.errors import ImguError
from imgu_ros.threads import quick_thread_switches

#: Requests that may wait for the one that is processed. Of more the oldest are refused: a caller keeps ten responses,
#: and the last ones to come are then those of the newest requests.
_MOST_WAITING = 10


@dataclass(frozen=True, slots=True, eq=False)
class BackgroundAction:
    """What a service does: `work` in a thread, then `finish` with its result in the executor's: it says what was done.

    Both may raise ImguError, whose text becomes the response.
    """

    work: Callable[[], Any]
    finish: Callable[[Any], str]


@dataclass(frozen=True, slots=True, eq=False)
class _DeferredResponse:
    """A request that is answered later."""

    begin: Callable[[], BackgroundAction]
    response: Any
    send: Callable[[Any], None]


class BackgroundServices:
    """The slow services of a node. One request is worked on at a time, the others wait in their order.

    Parameters
    ----------
    node : creates the services; its executor calls what is not the thread's
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._waiting: deque[_DeferredResponse] = deque()
        self._thread: threading.Thread | None = None
        self._is_busy = False

    def create(self, name: str, begin: Callable[[], BackgroundAction]) -> None:
        """Offer a std_srvs/Trigger.

        Parameters
        ----------
        begin : called in the executor's thread when the request's turn comes; may raise ImguError
        """
        service = self._node.create_service(Trigger, name, lambda _, response: response)
        send = service.send_response

        def defer(response: Any, header: Any) -> None:
            self._waiting.append(_DeferredResponse(begin, response, lambda made: send(made, header)))
            if len(self._waiting) > _MOST_WAITING:
                refused = self._waiting.popleft()
                self._answer(refused, False, f"{name}: {_MOST_WAITING} newer requests wait; call again later")
            self._next()

        service.send_response = defer  # type: ignore[method-assign]

    def close(self, timeout_s: float) -> bool:
        """Drop the requests that wait and join the thread; return whether it has ended in time."""
        self._waiting.clear()
        if self._thread is not None:
            self._thread.join(timeout_s)
        return self._thread is None or not self._thread.is_alive()

    def _next(self) -> None:
        while self._waiting and not self._is_busy:
            request = self._waiting.popleft()
            try:
                action = request.begin()
            except Exception as error:
                self._fail(request, error)
                continue
            self._is_busy = True
            self._thread = threading.Thread(target=self._run, args=(request, action), name="service", daemon=True)
            self._thread.start()

    def _run(self, request: _DeferredResponse, action: BackgroundAction) -> None:
        result, failure = None, None
        try:
            with quick_thread_switches():
                result = action.work()
        except Exception as error:
            failure = error
        executor = self._node.executor
        if executor is not None:  # None: the node ends
            executor.create_task(lambda: self._finish_safely(request, action, result, failure))

    def _finish_safely(
        self, request: _DeferredResponse, action: BackgroundAction, result: Any, failure: Exception | None
    ) -> None:
        """Finish a request; nothing is raised: rclpy's events executor does not survive a task that raises."""
        try:
            self._finish(request, action, result, failure)
        except Exception as error:
            with suppress(Exception):
                self._node.get_logger().error(f"{type(error).__name__}: {error}")

    def _finish(
        self, request: _DeferredResponse, action: BackgroundAction, result: Any, failure: Exception | None
    ) -> None:
        self._is_busy = False
        try:
            if failure is not None:
                raise failure
            self._answer(request, True, action.finish(result))
        except Exception as error:
            self._fail(request, error)
        self._next()

    def _fail(self, request: _DeferredResponse, error: Exception) -> None:
        """Answer why a request failed; what is no fault of the caller is logged too."""
        said = str(error)
        if not isinstance(error, ImguError):
            said = f"{type(error).__name__}: {' '.join(said.split())}"
            self._node.get_logger().error(said)
        self._answer(request, False, said)

    @staticmethod
    def _answer(request: _DeferredResponse, success: bool, message: str) -> None:
        request.response.success, request.response.message = success, message
        request.send(request.response)
