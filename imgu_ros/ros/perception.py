# SPDX-License-Identifier: Apache-2.0
"""The node `perception`: the whole chain in one process, live."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from imgu_ros.config.components import OutputParameters, ReadingParameters
from imgu_ros.errors import ImguError
from imgu_ros.files.frame_reading import frame_reading
from imgu_ros.files.target_images import load_target_images
from imgu_ros.localizer_builder import Built
from imgu_ros.reference.templates import TargetImage
from imgu_ros.remarks import Remarks
from imgu_ros.result import Result
from imgu_ros.ros.cause import Cause
from imgu_ros.ros.diagnostics import NodeState, unusable_camera_info
from imgu_ros.ros.explanations import Explainer
from imgu_ros.ros.graph_checks import why_not_served
from imgu_ros.ros.input import ImageInput, Job
from imgu_ros.ros.managed_node import ManagedNode, run_managed
from imgu_ros.ros.outputs import Outputs
from imgu_ros.ros.reach import domain_text
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.ros.worker import Handlers, Worker

#: Between two looks for listeners: while there are some, and while there are none and the node is to cost little.
_WATCH_S = 0.1
_REST_S = 0.2
#: Between two messages that one frame still holds the worker.
_HELD_UP_S = 1.0


def run(ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run the node until the process is asked to stop; return the exit code.

    Raises
    ------
    ImguError
        If the node cannot start: a bad parameter, a target that cannot be used, a missing package.
    """
    return run_managed(lambda: PerceptionNode(stop), ros_arguments, stop)


class PerceptionNode(ManagedNode[ImageInput]):
    """Images in, poses out.

    Callbacks run in the executor's thread and only hand over; one worker thread decodes, runs the chain and
    publishes. Inputs are subscribed only while the node is active, not paused, and somebody listens.
    """

    def __init__(self, stop: StopSignal) -> None:
        super().__init__("perception", stop)
        self._warned: set[str] = set()
        self._remarks = Remarks()
        self._input = ImageInput(self, self._server.parameters.image_transport)
        self._worker = Worker(
            self._input.slot,
            lambda: self._server.parameters,
            Handlers(
                result=self._on_result,
                rejected=self._on_rejected,
                failed=self._log_failure,
                needs_keypoints=self._needs_keypoints,
            ),
        )
        self._explainer = Explainer(self, self._input, self._worker, self._state)
        self._watch_timer = self.create_timer(_REST_S, self._watch, clock=self._steady)
        self.create_timer(_HELD_UP_S, self._tell_held_up, clock=self._steady)
        self._create_slow_service("~/reload", self._reload)
        self._create_slow_service("~/set_target_from_view", self._set_target_from_view)

    def close(self) -> bool:
        """Drop the inputs and end the threads; return whether they have ended."""
        ended = super().close()
        return self._worker.close() and ended

    def _load(self) -> None:
        parameters = self._server.reload()
        reading = frame_reading(ReadingParameters.of(parameters))
        built = self._worker.build(load_target_images(parameters.targets, self._log_warning, limits=parameters.limits))
        self._worker.read_with(reading, parameters)
        self._adopt(built)

    def _drop(self) -> None:
        with self._worker.between_frames():
            self._worker.drop()
            if self._outputs is not None:
                self._outputs.destroy()
                self._outputs = None

    def _begin(self) -> None:
        self._explainer.begin()
        self._remarks = Remarks()
        names = ", ".join(target.name for target in self._worker.targets) or "none (set targets.images)"
        self.get_logger().info(
            f"targets: {names}; images from {self._input.topics.image} when somebody listens ({domain_text(self)})"
        )

    def _adopt(self, built: Built) -> None:
        """Look for these targets from now on, and have a publisher for each of their topics."""
        with self._input.standstill.excused(), self._worker.between_frames():
            self._worker.use(built)
            self._fit_outputs([target.name for target in built.references])

    def _fit_outputs(self, names: Sequence[str]) -> None:
        parameters = OutputParameters.of(self._server.parameters)
        if self._outputs is not None and self._outputs.serves(names, parameters):
            return
        if self._outputs is None:
            self._outputs = Outputs(self, names, parameters)
        else:
            # Topics that stay keep their listeners.
            self._outputs.adapt(names, parameters)
        possible = self._outputs.qos_override_names() + self._input.qos_override_names()
        for line in self._server.unknown_qos_overrides(possible):
            if line not in self._warned:
                self._warned.add(line)
                self.get_logger().warning(line)

    def _watch(self) -> None:
        """Subscribe when somebody listens, and only then; follow parameters that change the publishers."""
        if self._outputs is None:
            return
        self._worker.follow()
        names = [target.name for target in self._worker.targets]
        if not self._outputs.serves(names, OutputParameters.of(self._server.parameters)):
            try:
                with self._worker.soon_between_frames() as between:
                    if between:
                        self._fit_outputs(names)
            except ImguError as error:
                self._log_failure(f"parameters: {error}")
                return
        self._input.limits = self._server.parameters.limits
        wanted = self._server.parameters.camera.info_file
        # A file that has vanished since it was named: frames are read as before.
        self._input.expect_camera_info(not (self._worker.info_file if self._worker.reading_problem else wanted))
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
        if result.frame.image.remark:
            self._warn_once("image", f"{self._input.topics.image}: {result.frame.image.remark}")
        reason = result.frame.camera_reason
        unusable = [unusable_camera_info(reason, self._input.camera_info_topic)] if reason else ()
        for line in self._remarks.news((*result.camera_remarks, *unusable)):
            self.get_logger().warning(line)
        now_ns = self.get_clock().now().nanoseconds
        if now_ns and result.frame.stamp_ns:
            self._worker.age.add((now_ns - result.frame.stamp_ns) / 1e9)

    def _on_rejected(self, result: Result) -> None:
        self._log_rejected(result.reason)
        if self._outputs is not None:
            self._outputs.publish_rejected(result)

    def _tell_held_up(self) -> None:
        frame = self._worker.in_hand.long()
        if frame is not None and self._outputs is not None:
            self._outputs.publish_held_up(frame.header, frame.text)

    def _needs_keypoints(self) -> bool:
        return self._outputs is not None and self._outputs.needs_keypoints()

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

    def _reset(self) -> str:
        with self._input.standstill.excused(), self._worker.between_frames():
            self._worker.reset()
            if self._outputs is not None:
                self._outputs.reset()
        return "all tracks and paths forgotten"

    async def _reload(self) -> str:
        staged = self._server.staged()
        reading = frame_reading(ReadingParameters.of(staged))  # the file may have changed
        built = await self._do_beside(
            lambda: self._worker.build(
                load_target_images(staged.targets, self._log_warning, limits=staged.limits), staged
            )
        )
        self._require_configured()  # it may have been cleaned up meanwhile
        self._server.reload(staged)
        self._adopt(built)
        self._worker.read_with(reading, staged)
        return "targets: " + (", ".join(target.name for target in self._worker.targets) or "none")

    async def _set_target_from_view(self) -> str:
        last = self._worker.last
        if last is None or last.developed is None:
            raise ImguError("view: no frame yet; need images, and a listener on any output")
        view = TargetImage("view", last.developed.grey, 0.0, last.developed.is_linear)
        await self._adopt_soon(lambda: self._worker.build([view]))
        return f"target: view, the frame at {last.frame.stamp_ns} ns, its size unknown; ~/reload brings back the others"

    async def _adopt_soon(self, make: Callable[[], Built]) -> None:
        built = await self._do_beside(make)
        self._require_configured()  # it may have been cleaned up meanwhile
        self._adopt(built)
