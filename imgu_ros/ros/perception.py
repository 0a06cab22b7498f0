"""The node `perception`: the whole chain in one process, live."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from imgu_ros.errors import ImguError, ParameterError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.perception.result import Result
from imgu_ros.perception.targets import TargetImage
from imgu_ros.ros.cause import Cause
from imgu_ros.ros.diagnostics import NodeState
from imgu_ros.ros.explaining import Explainer
from imgu_ros.ros.input import ImageInput, Job
from imgu_ros.ros.offers import why_not_served
from imgu_ros.ros.outputs import Outputs
from imgu_ros.ros.parameter_sections import files_without_section
from imgu_ros.ros.parameters import ParameterServer
from imgu_ros.ros.process import run_node
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.ros.transitions import refuse_impossible_transitions
from imgu_ros.ros.worker import Handlers, Worker

#: Between two looks for listeners: while there are some, and while there are none and the node is to cost little.
_WATCH_S = 0.1
_REST_S = 0.2
_THROTTLE_S = 5.0


def run(ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run the node until the process is asked to stop; return the exit code.

    Raises
    ------
    ImguError
        If the node cannot start: a bad parameter, a target that cannot be used, a missing package.
    """

    def make_node() -> PerceptionNode:
        node = PerceptionNode(stop)
        for line in files_without_section(ros_arguments, node.get_fully_qualified_name()):
            node.get_logger().warning(line)
        return node

    return run_node(make_node, ros_arguments, stop)


class PerceptionNode(LifecycleNode):
    """Images in, poses out.

    Callbacks run in the executor's thread and only hand over; one worker thread decodes, runs the chain and
    publishes. Inputs are subscribed only while the node is active, not paused, and somebody listens.
    """

    def __init__(self, stop: StopSignal) -> None:
        super().__init__("perception", enable_logger_service=True)
        refuse_impossible_transitions(self)
        self._stop = stop
        self._failure: ImguError | None = None
        self._lifecycle = "unconfigured"
        self._paused = False
        self._warned: set[str] = set()
        # The machine's time: with use_sim_time a timer would stand still until /clock comes.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._outputs: Outputs | None = None
        self._server = ParameterServer(self)
        self._input = ImageInput(self, self._server.parameters.image_transport)
        self._worker = Worker(
            self._input.slot,
            lambda: self._server.parameters,
            Handlers(
                result=self._on_result,
                rejected=self._on_rejected,
                failed=self._on_failed,
                needs_keypoints=self._needs_keypoints,
            ),
        )
        self._explainer = Explainer(self, self._input, self._worker, self._state)
        self._watch_timer = self.create_timer(_REST_S, self._watch, clock=self._steady)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/reload", self._on_reload)
        self.create_service(Trigger, "~/set_target_from_view", self._on_set_target_from_view)
        self.create_service(SetBool, "~/pause", self._on_pause)

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
            raise self._failure or ImguError("perception: cannot be configured; see the log")
        self.trigger_activate()

    def frame_group(self) -> CallbackGroup | None:
        """Return the group of the inputs' callbacks while they are subscribed."""
        return self._input.group if self._input.is_open else None

    def close(self) -> bool:
        """Drop the inputs and end the worker; return whether it has ended."""
        self._input.close()
        return self._worker.close()

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Any:
        """See `ParameterServer.set_atomically`."""
        return self._server.set_atomically(parameter_list, super().set_parameters_atomically)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the targets and create the publishers."""
        try:
            with self._stop.interruptible():
                self._adopt(load_target_images(self._server.reload().targets))
        except ImguError as error:
            self._failure = error
            if state.label != "unconfigured" or not self._server.parameters.autostart:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._lifecycle = "inactive"
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to look for listeners."""
        self._lifecycle = "active"
        self._explainer.begin()
        names = ", ".join(target.name for target in self._worker.targets) or "none (set targets.images)"
        self.get_logger().info(f"targets: {names}; images from {self._input.topics.image} when somebody listens")
        self._watch()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the inputs."""
        self._lifecycle = "inactive"
        self._input.close()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the targets and destroy the publishers."""
        self._lifecycle = "unconfigured"
        self._clear()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop everything; the process ends when it is asked to."""
        self._lifecycle = "finalized"
        self._clear()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to the beginning."""
        return self.on_cleanup(state)

    def _clear(self) -> None:
        self._input.close()
        with self._worker.between_frames():
            self._worker.drop()
            if self._outputs is not None:
                self._outputs.destroy()
                self._outputs = None

    def _adopt(self, images: Sequence[TargetImage]) -> None:
        """Look for these targets from now on, and have a publisher for each of their topics."""
        with self._worker.between_frames():
            targets = self._worker.use(images)
            self._fit_outputs([target.name for target in targets])

    def _fit_outputs(self, names: Sequence[str]) -> None:
        parameters = self._server.parameters
        if self._outputs is not None and self._outputs.serves(names, parameters):
            return
        if self._outputs is None:
            self._outputs = Outputs(self, names, parameters)
        else:
            # Topics that stay keep their listeners.
            self._outputs.adapt(names, parameters)
        possible = self._outputs.qos_override_names() + self._input.qos_override_names()
        self._server.check_qos_overrides(dict.fromkeys(possible))

    def _watch(self) -> None:
        """Subscribe when somebody listens, and only then; follow parameters that change the publishers."""
        if self._outputs is None:
            return
        self._worker.follow()
        names = [target.name for target in self._worker.targets]
        if not self._outputs.serves(names, self._server.parameters):
            try:
                with self._worker.soon_between_frames() as between:
                    if between:
                        self._fit_outputs(names)
            except ImguError as error:
                self._on_failed(f"parameters: {error}")
                return
        if self._lifecycle == "active" and not self._paused and self._outputs.wanted():
            self._input.open()
            self._input.check_waiting()
            self._warn_of_topic_name()
        else:
            self._input.close()
        period_ns = round((_WATCH_S if self._input.is_open else _REST_S) * 1e9)
        if self._watch_timer.timer_period_ns != period_ns:
            self._watch_timer.timer_period_ns = period_ns

    def _on_result(self, result: Result, _: Job) -> None:
        if self._outputs is not None:
            self._outputs.publish(result)
        if result.reason:
            self._log_rejected(result.reason)
        now_ns = self.get_clock().now().nanoseconds
        if now_ns:
            self._worker.age.add((now_ns - result.frame.stamp_ns) / 1e9)

    def _on_rejected(self, result: Result) -> None:
        self._log_rejected(result.reason)
        if self._outputs is not None:
            self._outputs.publish_rejected(result)

    def _needs_keypoints(self) -> bool:
        return self._outputs is not None and self._outputs.needs_keypoints()

    def _on_failed(self, line: str) -> None:
        self.get_logger().error(line, throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=self._steady)

    def _log_rejected(self, reason: str) -> None:
        self.get_logger().warning(
            f"frame rejected: {reason}", throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=self._steady
        )

    def _warn_of_topic_name(self) -> None:
        if self._input.looks_rectified and not self._server.parameters.camera.rectified:
            topic = self._input.topics.image
            self._warn_once("rect", f"{topic} looks like rectified images; then set camera.rectified to true")

    def _warn_once(self, key: str, line: str) -> None:
        if key not in self._warned:
            self._warned.add(key)
            self.get_logger().warning(line)

    def _state(self, stopped_clock: Cause | None) -> NodeState:
        outputs = self._outputs
        misfits = why_not_served(self, self.publishers) if outputs is not None and outputs.unmatched() else []
        return NodeState(
            name=self.get_fully_qualified_name(),
            lifecycle=self._lifecycle,
            paused=self._paused,
            listened=outputs is not None and outputs.wanted(),
            misfits=tuple(misfits),
            stopped_clock=stopped_clock,
            frames="" if outputs is None else outputs.problem,
        )

    def _on_reset(self, _: Any, response: Any) -> Any:
        return self._answer(response, self._reset)

    def _on_reload(self, _: Any, response: Any) -> Any:
        return self._answer(response, self._reload)

    def _on_set_target_from_view(self, _: Any, response: Any) -> Any:
        return self._answer(response, self._set_target_from_view)

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
        self._worker.reset()
        with self._worker.between_frames():
            if self._outputs is not None:
                self._outputs.reset()
        return "all tracks and paths forgotten"

    def _reload(self) -> str:
        self._require_configured()
        self._adopt(load_target_images(self._server.reload().targets))
        return "targets: " + (", ".join(target.name for target in self._worker.targets) or "none")

    def _set_target_from_view(self) -> str:
        self._require_configured()
        last = self._worker.last
        if last is None or last.developed is None:
            raise ImguError("view: no frame yet; need images, and a listener on any output")
        grey = last.developed.grey
        self._adopt([TargetImage("view", grey, 0.0, last.developed.is_linear)])
        return f"target: view, the frame at {last.frame.stamp_ns} ns, its size unknown; ~/reload brings back the others"

    def _pause(self, paused: bool) -> str:
        self._paused = paused
        self._watch()
        return "paused" if paused else "running"

    def _require_configured(self) -> None:
        if self._outputs is None:
            raise ParameterError(f"lifecycle state: {self._lifecycle}; need inactive or active")
