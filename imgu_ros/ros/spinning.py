# SPDX-License-Identifier: Apache-2.0
"""Runs a node's callbacks in one thread, those that come with every frame at little cost.

rclpy's executor gathers all that a node waits for before each callback. For a node with parameters, services and a
lifecycle those are some fifty things, more work than the callbacks themselves at 100 frames a second. Here the few
that bring frames are waited for by themselves, and the executor looks at everything twenty times a second, or more
often while there is more to do.
"""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

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
        self._frames: _FrameWait | None = None
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
            self._frames = _FrameWait(self._node, group)
        self._frames.spin_once(self._rest_period_s)
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
        """Forget what waits for frames: it may hold on to a subscription that is to go."""
        frames, self._frames = self._frames, None
        if frames is not None:
            frames.close()


class _FrameWait:
    """Waits for the subscriptions of one callback group and calls them, as `rclpy.wait_for_message` waits for one.

    rclpy's executor makes a timer, a wait set and a task for each message, which takes longer than a small message
    itself. Events of the subscriptions are left to it: they come soon enough with the rest.
    """

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        self.group = group
        self._node = node
        self._guard = GuardCondition(None, None, context=node.context)
        self._wait_set: Any = None
        self._room = -1

    def spin_once(self, timeout_s: float) -> None:
        """Wait for a message or for `wake`, no longer than `timeout_s`, and call what has come."""
        waiting = [one for one in self._node.subscriptions if one.callback_group is self.group]
        handles = [one.handle for one in waiting]
        context = self._node.context.handle
        with ExitStack() as held:
            for handle in (*handles, self._guard.handle, context):
                held.enter_context(handle)
            if self._room != len(handles):
                self._wait_set = rclpy_implementation.WaitSet(len(handles), 1, 0, 0, 0, 0, context)
                self._room = len(handles)
            self._wait_set.clear_entities()
            for handle in handles:
                self._wait_set.add_subscription(handle)
            self._wait_set.add_guard_condition(self._guard.handle)
            self._wait_set.wait(round(timeout_s * 1e9))
            ready = self._wait_set.get_ready_entities("subscription")
            taken = [
                (one, one.handle.take_message(one.msg_type, one.raw)) for one in waiting if one.handle.pointer in ready
            ]
        for one, message in taken:
            if message is None:
                continue
            if one._callback_type is Subscription.CallbackType.WithMessageInfo:
                one.callback(*message)
            else:
                one.callback(message[0])

    def wake(self) -> None:
        """Let a `spin_once` that waits return; from any thread."""
        with suppress(rclpy_implementation.InvalidHandle):  # closed meanwhile: nobody waits
            self._guard.trigger()

    def close(self) -> None:
        """Let go of the subscriptions."""
        self._wait_set = None
        self._guard.destroy()
