"""The node of one stage of the chain: lifecycle, parameters, lazy inputs, one worker, diagnostics."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from imgu_ros.codec.diagnostics import diagnostics_message
from imgu_ros.errors import ImguError, ParameterError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.params import Parameters
from imgu_ros.perception.targets import TargetImage
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.newest import NewestSlot
from imgu_ros.ros.outputs import Outputs
from imgu_ros.ros.parameter_sections import files_without_section
from imgu_ros.ros.parameters import ParameterServer
from imgu_ros.ros.process import run_node
from imgu_ros.ros.qos import no_events, output_qos
from imgu_ros.ros.stage import Stage
from imgu_ros.ros.stage_health import StageFigures, StageState, stage_health
from imgu_ros.ros.stage_input import StageInput, StageJob
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.ros.transitions import refuse_impossible_transitions

_WATCH_S = 0.1
_DIAGNOSTICS_S = 1.0
_THROTTLE_S = 5.0
_END_S = 1.0


def run_stage(stage: Stage, ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run a stage's node until the process is asked to stop; return the exit code.

    Raises
    ------
    ImguError
        If the node cannot start: a bad parameter, a target that cannot be used.
    """

    def make_node() -> StageNode:
        node = StageNode(stage, stop)
        for line in files_without_section(ros_arguments, node.get_fully_qualified_name()):
            node.get_logger().warning(line)
        return node

    return run_node(make_node, ros_arguments, stop)


class StageNode(LifecycleNode):
    """Some topics in, others out.

    Callbacks run in the executor's thread and only hand over; one worker thread does the stage's work and publishes.
    Inputs are subscribed only while the node is active, not paused, and somebody listens.
    """

    def __init__(self, stage: Stage, stop: StopSignal) -> None:
        super().__init__(stage.name, enable_logger_service=True)
        refuse_impossible_transitions(self)
        self._stage = stage
        self._stop = stop
        self._failure: ImguError | None = None
        self._state = StageState(self.get_fully_qualified_name())
        self._figures = StageFigures()
        # The machine's time: with use_sim_time a timer would stand still until /clock comes.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._outputs: Outputs | None = None
        self._images: tuple[TargetImage, ...] = ()
        self._used: Parameters | None = None
        self._server = ParameterServer(self)
        self._slot: NewestSlot[StageJob] = NewestSlot()
        self._input = self._made_input()
        self._diagnostics = self.create_publisher(
            message_class("diagnostic_msgs/msg/DiagnosticArray"),
            "/diagnostics",
            output_qos(10),
            event_callbacks=no_events(),
        )
        self.create_timer(_WATCH_S, self._watch, clock=self._steady)
        self.create_timer(_DIAGNOSTICS_S, self._publish_diagnostics, clock=self._steady)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/reset", self._on_reset)
        if stage.needs_targets:
            self.create_service(Trigger, "~/reload", self._on_reload)
        self._between_frames = threading.RLock()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread.start()

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
            raise self._failure or ImguError(f"{self._stage.name}: cannot be configured; see the log")
        self.trigger_activate()

    def frame_group(self) -> CallbackGroup | None:
        """Return the group of the inputs' callbacks while they are subscribed."""
        return self._input.group if self._input.is_open else None

    def close(self) -> bool:
        """Drop the inputs and end the worker; return whether it has ended."""
        self._input.close()
        self._closing = True
        self._slot.close()
        self._thread.join(_END_S)
        return not self._thread.is_alive()

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Any:
        """See `ParameterServer.set_atomically`."""
        return self._server.set_atomically(parameter_list, super().set_parameters_atomically)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the targets, if the stage needs them, and create the publishers."""
        try:
            with self._stop.interruptible():
                self._load()
        except ImguError as error:
            self._failure = error
            if state.label != "unconfigured" or not self._server.parameters.autostart:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._state.lifecycle = "inactive"
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to look for listeners."""
        self._state.lifecycle = "active"
        taken = ", ".join(feed.topic for feed in self._input.topics.feeds)
        self.get_logger().info(f"{self._stage.name}: takes {taken} when somebody listens")
        self._watch()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the inputs."""
        self._state.lifecycle = "inactive"
        self._input.close()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Destroy the publishers."""
        self._state.lifecycle = "unconfigured"
        self._clear()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop everything; the process ends when it is asked to."""
        self._state.lifecycle = "finalized"
        self._clear()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to the beginning."""
        return self.on_cleanup(state)

    def _clear(self) -> None:
        self._input.close()
        with self._between_frames:
            if self._outputs is not None:
                self._outputs.destroy()
                self._outputs = None
            self._used = None

    def _made_input(self) -> StageInput:
        topics = self._stage.topics(self, self._server.parameters)
        return StageInput(self, topics, self._stage.is_complete, self._slot)

    def _load(self) -> None:
        parameters = self._server.reload()
        images = load_target_images(parameters.targets) if self._stage.needs_targets else []
        with self._between_frames:
            self._stage.use(parameters, images)
            self._used, self._images = parameters, tuple(images)
            self._fit(parameters)

    def _fit(self, parameters: Parameters) -> None:
        """Have the publishers and the inputs that the parameters ask for."""
        names = [image.name for image in self._images]
        if self._outputs is None or not self._outputs.serves(names, parameters):
            if self._outputs is None:
                self._outputs = Outputs(self, names, parameters, self._stage.choice)
            else:
                self._outputs.adapt(names, parameters)
            possible = self._outputs.qos_override_names() + self._input.qos_override_names()
            # Six nodes may share a parameter file.
            with contextlib.suppress(ParameterError):
                self._server.check_qos_overrides(dict.fromkeys(possible))
        if self._stage.topics(self, parameters) != self._input.topics:
            self._input.close()
            self._input = self._made_input()

    def _watch(self) -> None:
        """Subscribe when somebody listens, and only then; follow parameters that change."""
        if self._outputs is None:
            return
        parameters = self._server.parameters
        if parameters is not self._used:
            self._follow(parameters)
        self._state.listened = self._outputs is not None and self._outputs.wanted()
        if self._state.works:
            self._input.open()
            self._input.check_waiting()
        else:
            self._input.close()

    def _follow(self, parameters: Parameters) -> None:
        with self._between_frames:
            self._used = parameters
            try:
                self._stage.use(parameters, self._images)
                self._fit(parameters)
            except ImguError as error:
                self._log_failure(f"parameters: {error}; {self._stage.name} goes on with the old ones")

    def _run(self) -> None:
        while (job := self._slot.take()) is not None:
            try:
                with self._between_frames:
                    if self._outputs is None or self._closing:
                        continue
                    self._stage.work(job, self._outputs)
                self._figures.worked(job.received_s, time.monotonic())
            except ImguError as error:
                self._figures.rejected(str(error))
                self._log_rejected(str(error))
            except Exception as error:
                # One bad message must not end the node, whatever is wrong with it.
                if not self._closing:
                    self._log_failure(f"frame: {type(error).__name__}: {' '.join(str(error).split())}")

    def _log_failure(self, line: str) -> None:
        self.get_logger().error(line, throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=self._steady)

    def _log_rejected(self, reason: str) -> None:
        self.get_logger().warning(
            f"rejected: {reason}", throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=self._steady
        )

    def _publish_diagnostics(self) -> None:
        if not self._diagnostics.get_subscription_count():
            return
        unmatched = 0 if self._outputs is None else self._outputs.unmatched()
        entries = stage_health(self._state, self._figures, self._input, self._slot.skipped, unmatched)
        self._diagnostics.publish(diagnostics_message(make_message, self.get_clock().now().nanoseconds, entries))

    def _on_reset(self, _: Any, response: Any) -> Any:
        return self._answer(response, self._reset)

    def _on_reload(self, _: Any, response: Any) -> Any:
        return self._answer(response, self._reload)

    def _on_pause(self, request: Any, response: Any) -> Any:
        return self._answer(response, lambda: self._pause(bool(request.data)))

    def _answer(self, response: Any, act: Callable[[], str]) -> Any:
        """Run a service's action; its result, or what prevents it, is the answer."""
        try:
            response.message = act()
            response.success = True
        except ImguError as error:
            response.message = str(error)
            response.success = False
        return response

    def _reset(self) -> str:
        with self._between_frames:
            if self._outputs is not None:
                self._outputs.reset()
        return "paths begin anew; a stage remembers nothing else"

    def _reload(self) -> str:
        if self._outputs is None:
            raise ParameterError(f"lifecycle state: {self._state.lifecycle}; need inactive or active")
        self._load()
        return "targets: " + (", ".join(image.name for image in self._images) or "none")

    def _pause(self, paused: bool) -> str:
        self._state.paused = paused
        self._watch()
        return "paused" if paused else "running"
