"""Runs a node's callbacks in one thread, those that come with every frame at little cost.

rclpy's executor gathers all that a node waits for before each callback. For a node with parameters, services and a
lifecycle those are some fifty things, more work than the callbacks themselves at 100 frames a second. Here the
executor looks at the few that bring frames nearly every time, and at the rest twenty times a second, or more often
while there is more to do.
"""

from __future__ import annotations

import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.node import Node

#: How long services, timers and parameters may wait while frames come.
_REST_PERIOD_S = 0.05
#: While several of them come at a time, so often: a service keeps ten requests, and drops what comes beyond.
_BUSY_PERIOD_S = 0.01
_SEVERAL = 2
_MOST_AT_ONCE = 20


class Spinner:
    """Calls a node's callbacks, in the thread that calls `spin_once`.

    Parameters
    ----------
    node : all of its callbacks are served
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._all = SingleThreadedExecutor(context=node.context)
        self._all.add_node(node)
        self._frames: _GroupExecutor | None = None
        self._rest_due_s = 0.0
        self._rest_period_s = _REST_PERIOD_S

    def spin_once(self, group: CallbackGroup | None) -> None:
        """Wait for a callback and call it.

        Parameters
        ----------
        group : of the callbacks that come with every frame; None while there are none
        """
        if group is None:
            self._drop_frames()
            self._all.spin_once()
            return
        if self._frames is None or self._frames.group is not group:
            self._drop_frames()
            self._frames = _GroupExecutor(self._node, group)
        self._frames.spin_once(timeout_sec=self._rest_period_s)
        now = time.monotonic()
        if now >= self._rest_due_s:
            busy = self._call_all_ready(group) >= _SEVERAL
            # Fewer looks only little by little: what came in a burst may go on.
            self._rest_period_s = _BUSY_PERIOD_S if busy else min(_REST_PERIOD_S, 1.5 * self._rest_period_s)
            self._rest_due_s = now + self._rest_period_s

    def wake(self) -> None:
        """Let a `spin_once` that waits run Python's signal handlers; from any thread."""
        self._all.wake()
        frames = self._frames
        if frames is not None:
            frames.wake()

    def close(self) -> None:
        """Let go of the node."""
        self._drop_frames()
        self._all.remove_node(self._node)
        self._all.shutdown(timeout_sec=0)

    def _call_all_ready(self, group: CallbackGroup) -> int:
        """Call what is ready, but not for ever; return how many callbacks that were, without those of the group."""
        called = others = 0
        while called < _MOST_AT_ONCE:
            looked = called
            try:
                # One look finds at most one request of a service.
                while called < _MOST_AT_ONCE:
                    ready: tuple[Any, Any, Any] = self._all.wait_for_ready_callbacks(timeout_sec=0)
                    handler, entity, _ = ready
                    handler()
                    handler.result()  # raises what the callback raised
                    called += 1
                    # Frames come anyhow: many of them are no reason to look for other things more often.
                    others += getattr(entity, "callback_group", None) is not group
            except TimeoutException:
                if called == looked:
                    break
            except ShutdownException:
                break
        return others

    def _drop_frames(self) -> None:
        """Forget the executor of the frames' callbacks: it may hold on to a subscription that is to go."""
        if self._frames is not None:
            self._frames.shutdown(timeout_sec=0)
            self._frames = None


class _GroupExecutor(SingleThreadedExecutor):
    """Looks at the subscriptions of one callback group, whose node belongs to another executor."""

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        super().__init__(context=node.context)
        self.group = group
        self._part = _Part(node, group)

    def get_nodes(self) -> list[Any]:
        return [self._part]


class _Part:
    """What an executor asks a node for, as far as it is of one callback group."""

    # Not the subscriptions' events either: an executor knows them by their place among those that it waits for, and
    # the other executor waits for more. They come soon enough with the rest.
    timers = clients = services = guards = waitables = ()

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        self._node = node
        self._group = group

    @property
    def subscriptions(self) -> list[Any]:
        return [one for one in self._node.subscriptions if one.callback_group is self._group]
