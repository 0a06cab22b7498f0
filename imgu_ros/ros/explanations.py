# SPDX-License-Identifier: Apache-2.0
"""Says why nothing comes out of a node: each cause once in the log, and all that hold in /diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from imgu_ros.messages.diagnostics import diagnostics_message
from imgu_ros.ros.cause import Cause, CauseLog, Kind
from imgu_ros.ros.clock_cause import ClockWatch
from imgu_ros.ros.diagnostics import NodeState, causes, health
from imgu_ros.ros.input import ImageInput
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.middleware import full_memory
from imgu_ros.ros.qos import no_events, output_qos
from imgu_ros.ros.worker import Worker

_LOOK_S = 0.5
_DIAGNOSTICS_S = 1.0


class Explainer:
    """Looks twice a second for what keeps poses from coming out, and publishes /diagnostics once a second.

    Parameters
    ----------
    node : logs, and looks at the graph
    source, worker : what is explained
    state : tells what the node knows about itself; the clock is looked at here
    """

    def __init__(
        self, node: Node, source: ImageInput, worker: Worker, state: Callable[[Cause | None], NodeState]
    ) -> None:
        self._node, self._source, self._worker, self._state = node, source, worker, state
        self._log = CauseLog()
        self._clock = ClockWatch(node)
        self._publisher = node.create_publisher(
            message_class("diagnostic_msgs/msg/DiagnosticArray"),
            "/diagnostics",
            output_qos(10),
            event_callbacks=no_events(),
        )
        # The machine's time: with use_sim_time a timer would stand still until /clock comes.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_LOOK_S, self._look, clock=steady)
        node.create_timer(_DIAGNOSTICS_S, self._publish, clock=steady)

    def begin(self) -> None:
        """Tell every cause again: the node begins anew."""
        self._log.clear()

    def _look(self) -> None:
        now = time.monotonic()
        state = self._state(self._clock.cause(now))
        found = self._causes(state) if state.listened or state.misfits else _memory_causes()
        for cause in self._log.news(found, now):
            self._node.get_logger().warning(cause.text)

    def _publish(self) -> None:
        if not self._publisher.get_subscription_count():
            return
        state = self._state(self._clock.cause(time.monotonic()))
        found = self._causes(state)
        entries = health(state, found, self._source, self._worker)
        stamp_ns = self._node.get_clock().now().nanoseconds
        self._publisher.publish(diagnostics_message(make_message, stamp_ns, entries))

    def _causes(self, state: NodeState) -> list[Cause]:
        return [*causes(state, self._node, self._source, self._worker), *_memory_causes()]


def _memory_causes() -> list[Cause]:
    full = full_memory()
    return [Cause(Kind.MEMORY, full)] if full else []
