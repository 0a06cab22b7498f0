# SPDX-License-Identifier: Apache-2.0
"""The life cycle that all nodes of this package share: parameters, inputs subscribed on demand, outputs, services."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool

from imgu_ros.config.components import OutputParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ImguError, ParameterError
from imgu_ros.messages.diagnostics import HealthEntry, diagnostics_message
from imgu_ros.process_memory import return_free_memory
from imgu_ros.ros.background_services import BackgroundAction, BackgroundServices
from imgu_ros.ros.frame_input import FrameInput
from imgu_ros.ros.frame_worker import FrameWorker
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.outputs import Outputs, TopicSelection
from imgu_ros.ros.parameters import ParameterServer
from imgu_ros.ros.plain_logger import PlainLogger
from imgu_ros.ros.qos import no_events, output_qos
from imgu_ros.ros.reach import domain_text
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.ros.transitions import refuse_impossible_transitions

_THROTTLE_S = 5.0
_END_S = 1.0
#: Intervals at which subscribers are looked for: while there are some, and while there are none and the node rests.
_WATCH_S = 0.1
_REST_S = 0.2
_DIAGNOSTICS_S = 1.0
#: Interval at which free memory is returned to the system.
_FREE_MEMORY_S = 10.0


@dataclass(frozen=True, slots=True)
class NodeState:
    """State of a node.

    Attributes
    ----------
    name : fully qualified
    lifecycle : name of the lifecycle state
    paused, listened : whether it is paused, and whether any output has a subscriber
    domain : ROS domain, and what confines the node
    """

    name: str
    lifecycle: str
    paused: bool
    listened: bool
    domain: str

    @property
    def works(self) -> bool:
        """Whether the node is to subscribe to its inputs."""
        return self.lifecycle == "active" and not self.paused and self.listened


InputT = TypeVar("InputT", bound=FrameInput)
WorkerT = TypeVar("WorkerT", bound=FrameWorker)


class ManagedNode(LifecycleNode, Generic[InputT, WorkerT]):
    """A lifecycle node with `~/pause`, `~/reset`, `~/reload` and `/diagnostics`.

    Callbacks run in the executor's thread and hand messages over; the worker's thread processes and publishes. Inputs
    are subscribed only while the node is active, not paused, and an output has a subscriber.

    A derived class has an `_input` and a `_worker`, calls `_start_timers` when it is constructed, and implements the
    methods that raise NotImplementedError.

    Parameters
    ----------
    name : of the node
    stop : tells when the process is asked to stop
    selection : the topics that it publishes; None: those of the node `perception`
    """

    _input: InputT
    _worker: WorkerT
    _plain_logger: PlainLogger | None = None

    def __init__(self, name: str, stop: StopSignal, selection: TopicSelection | None = None) -> None:
        super().__init__(name, enable_logger_service=True)
        refuse_impossible_transitions(self)
        self._stop = stop
        self._selection = selection
        self._failure: ImguError | None = None
        self._lifecycle = "unconfigured"
        self._paused = False
        self._warned: set[str] = set()
        # The machine's time: with use_sim_time a timer would stand still until /clock comes.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._outputs: Outputs | None = None
        self._server = ParameterServer(self)
        self._slow = BackgroundServices(self)
        # Of its own: it does not wait for `~/reload`.
        self._resetting = BackgroundServices(self)
        self._diagnostics = self.create_publisher(
            message_class("diagnostic_msgs/msg/DiagnosticArray"),
            "/diagnostics",
            output_qos(10),
            event_callbacks=no_events(),
        )
        self.create_service(SetBool, "~/pause", self._on_pause)
        # It waits for the end of the frame that is processed.
        self._resetting.create("~/reset", lambda: BackgroundAction(self._reset, str))

    def get_logger(self) -> PlainLogger:
        """Return the node's logger; what it logs acts on no terminal."""
        if self._plain_logger is None:
            self._plain_logger = PlainLogger(super().get_logger().name)
        return self._plain_logger

    def start(self) -> None:
        """Configure and activate when `autostart` says so.

        Raises
        ------
        ImguError
            If the node cannot be configured.
        """
        if not self._server.parameters.autostart:
            return
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            raise self._failure or ImguError(f"{self.get_name()}: cannot be configured; see the log")
        self.trigger_activate()

    def close(self) -> bool:
        """Drop the inputs and end the threads; return whether they have ended."""
        self._input.close()
        ended = self._slow.close(_END_S) and self._resetting.close(_END_S)
        return self._worker.close(_END_S) and ended

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Any:
        """See `ParameterServer.set_atomically`."""
        return self._server.set_atomically(parameter_list, super().set_parameters_atomically)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the targets and create the publishers."""
        try:
            with self._stop.interruptible():
                self._load()
        except ImguError as error:
            self._failure = error
            if state.label != "unconfigured" or not self._server.parameters.autostart:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._lifecycle = "inactive"
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to the inputs when an output has a subscriber."""
        self._lifecycle = "active"
        self._begin()
        self._watch()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the inputs."""
        self._lifecycle = "inactive"
        self._input.close()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the targets and destroy the publishers."""
        self._lifecycle = "unconfigured"
        self._input.close()
        self._drop()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop everything; the process ends when it is asked to."""
        self._lifecycle = "finalized"
        self._input.close()
        self._drop()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up, as an unconfigured node."""
        return self.on_cleanup(state)

    def _load(self) -> None:
        """Prepare what the parameters ask for.

        Raises
        ------
        ImguError
            If it cannot be prepared.
        """
        raise NotImplementedError

    def _drop_loaded(self) -> None:
        """Drop what was loaded; the worker is held between two frames."""
        raise NotImplementedError

    def _begin(self) -> None:
        """Called once when the node becomes active."""
        raise NotImplementedError

    def _follow(self, parameters: Parameters) -> None:
        """Put changed parameters in force; called a few times a second while the node is configured."""
        raise NotImplementedError

    def _forget(self) -> str:
        """Drop the state of earlier frames, from another thread than the executor's; return what was done."""
        raise NotImplementedError

    def _reload(self) -> BackgroundAction:
        """Load again and say what is there now."""
        raise NotImplementedError

    def _health(self) -> list[HealthEntry]:
        """Return the entries of /diagnostics."""
        raise NotImplementedError

    def _warn_of_override(self, line: str) -> None:
        """Log a QoS override that the node does not have."""
        self.get_logger().warning(line)

    def _start_timers(self) -> None:
        self._watch_timer = self.create_timer(_REST_S, self._watch, clock=self._steady)
        self.create_timer(_DIAGNOSTICS_S, self._publish_diagnostics, clock=self._steady)
        self.create_timer(_FREE_MEMORY_S, return_free_memory, clock=self._steady)

    def _node_state(self) -> NodeState:
        return NodeState(
            self.get_fully_qualified_name(),
            self._lifecycle,
            self._paused,
            self._outputs is not None and self._outputs.wanted(),
            domain_text(self),
        )

    def _watch(self) -> None:
        """Put changed parameters in force; subscribe when an output has a subscriber, and only then."""
        if self._outputs is None:
            return
        parameters = self._server.parameters
        self._follow(parameters)
        self._input.limits = parameters.limits
        if self._node_state().works:
            self._input.open()
            self._input.check_waiting()
        else:
            self._input.close()
        period_ns = round((_WATCH_S if self._input.is_open else _REST_S) * 1e9)
        if self._watch_timer.timer_period_ns != period_ns:
            self._watch_timer.timer_period_ns = period_ns

    def _fit_outputs(self, names: Sequence[str], parameters: Parameters) -> None:
        """Have the publishers for these targets and parameters; the worker is held between two frames."""
        wanted = OutputParameters.of(parameters)
        if self._outputs is not None and self._outputs.serves(names, wanted):
            return
        if self._outputs is None:
            self._outputs = Outputs(self, names, wanted, self._selection, self._input.taken_topics)
        else:
            # Topics that stay keep their subscribers.
            self._outputs.adapt(names, wanted)
        possible = self._outputs.qos_override_names() + self._input.qos_override_names()
        for line in self._server.unknown_qos_overrides(possible):
            if line not in self._warned:
                self._warned.add(line)
                self._warn_of_override(line)

    def _drop(self) -> None:
        with self._worker.between_frames():
            self._drop_loaded()
            if self._outputs is not None:
                self._outputs.destroy()
                self._outputs = None

    def _reset(self) -> str:
        with self._worker.between_frames():
            if self._outputs is not None:
                self._outputs.reset()
            return self._forget()

    def _publish_diagnostics(self) -> None:
        if self._diagnostics.get_subscription_count():
            stamp_ns = self.get_clock().now().nanoseconds
            self._diagnostics.publish(diagnostics_message(make_message, stamp_ns, self._health()))

    def _create_slow_service(self, name: str, begin: Callable[[], BackgroundAction]) -> None:
        """Offer a Trigger that may take long and needs the node to be configured, at its end too."""

        def configured() -> BackgroundAction:
            self._require_configured()
            action = begin()

            def finish(result: Any) -> str:
                self._require_configured()  # it may have been cleaned up meanwhile
                return action.finish(result)

            return BackgroundAction(action.work, finish)

        self._slow.create(name, configured)

    def _on_pause(self, request: Any, response: Any) -> Any:
        self._paused = bool(request.data)
        self._watch()
        response.message, response.success = "paused" if self._paused else "running", True
        return response

    def _require_configured(self) -> None:
        if self._outputs is None:
            raise ParameterError(f"lifecycle state: {self._lifecycle}; need inactive or active")

    def _log_failure(self, line: str) -> None:
        self.get_logger().error(line, throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=self._steady)

    def _log_warning(self, line: str) -> None:
        self.get_logger().warning(line)

    def _log_rejected(self, reason: str) -> None:
        self.get_logger().warning(
            f"frame rejected: {reason}", throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=self._steady
        )
