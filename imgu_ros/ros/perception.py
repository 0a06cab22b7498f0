# SPDX-License-Identifier: Apache-2.0
"""The node `perception`: the whole pipeline in one process, live."""

from __future__ import annotations

from collections.abc import Sequence

from imgu_ros.config.components import OutputParameters, ReadingParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ImguError
from imgu_ros.files.frame_reading import frame_reading
from imgu_ros.files.target_images import load_target_images
from imgu_ros.localizer import PreparedLocalizer
from imgu_ros.messages.diagnostics import HealthEntry
from imgu_ros.reference.family import MOST_MEMBERS
from imgu_ros.reference.reference import names_of
from imgu_ros.reference.templates import TargetImage
from imgu_ros.remarks import Remarks
from imgu_ros.result import Result
from imgu_ros.ros.background_services import BackgroundAction
from imgu_ros.ros.causes import Cause
from imgu_ros.ros.diagnostics import Explainer, PerceptionState, unusable_camera_info
from imgu_ros.ros.graph_checks import why_not_served
from imgu_ros.ros.image_input import ImageInput
from imgu_ros.ros.localizer_worker import LocalizerWorker, ResultHandlers
from imgu_ros.ros.managed_node import ManagedNode
from imgu_ros.ros.process import run_node
from imgu_ros.ros.reach import domain_text
from imgu_ros.ros.stopping import StopSignal

#: Interval of the messages that say that one frame still occupies the worker.
_HELD_UP_S = 1.0


def run(ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run the node until the process is asked to stop; return the exit code.

    Raises
    ------
    ImguError
        If the node cannot start: a bad parameter, a target that cannot be used, a missing package.
    """
    return run_node(lambda: PerceptionNode(stop), ros_arguments, stop)


class PerceptionNode(ManagedNode[ImageInput, LocalizerWorker]):
    """Images in, poses out."""

    def __init__(self, stop: StopSignal) -> None:
        super().__init__("perception", stop)
        self._remarks = Remarks()
        self._input = ImageInput(self, self._server.parameters.image_transport)
        self._worker = LocalizerWorker(
            self._input.queue,
            lambda: self._server.parameters,
            ResultHandlers(
                result=self._on_result,
                rejected=self._on_rejected,
                failed=self._log_failure,
                needs_keypoints=self._needs_keypoints,
            ),
        )
        self._explainer = Explainer(self, self._input, self._worker, self._perception_state)
        self.create_timer(_HELD_UP_S, self._publish_held_up, clock=self._steady)
        self._start_timers()
        self._create_slow_service("~/reload", self._reload)
        self._create_slow_service("~/set_target_from_view", self._set_target_from_view)

    def _load(self) -> None:
        parameters = self._server.reload()
        reading = frame_reading(ReadingParameters.of(parameters))
        built = self._worker.build(load_target_images(parameters.targets, self._log_warning, limits=parameters.limits))
        self._worker.read_with(reading, parameters)
        self._adopt(built)

    def _drop_loaded(self) -> None:
        self._worker.drop()

    def _begin(self) -> None:
        self._explainer.begin()
        self._remarks = Remarks()
        names = ", ".join(target.name for target in self._worker.targets) or "none (set targets.images)"
        self.get_logger().info(
            f"targets: {names}; subscribes to {self._input.topics.image} when an output has a subscriber "
            f"({domain_text(self)})"
        )

    def _adopt(self, built: PreparedLocalizer) -> None:
        """Search for these targets from the next frame on, and have a publisher for each of their topics."""
        with self._input.standstill.excused(), self._worker.between_frames():
            self._worker.use(built)
            for line in self._worker.poor_targets.values():
                self.get_logger().warning(line)
            self._fit_outputs(self._names(), self._server.parameters)

    def _follow(self, parameters: Parameters) -> None:
        self._worker.follow()
        names = self._names()
        if self._outputs is not None and not self._outputs.serves(names, OutputParameters.of(parameters)):
            try:
                with self._worker.soon_between_frames() as between:
                    if between:
                        self._fit_outputs(names, parameters)
            except ImguError as error:
                self._log_failure(f"parameters: {error}")
        wanted = parameters.camera.info_file
        # A file that has vanished since it was named: frames are decoded as before.
        self._input.expect_camera_info(not (self._worker.info_file if self._worker.reading_problem else wanted))
        if self._input.is_open and self._input.looks_rectified and not parameters.camera.rectified:
            topic = self._input.topics.image
            self._warn_once("rect", f"{topic} looks like rectified images; then set camera.rectified to true")

    def _names(self) -> list[str]:
        """Return the targets that have topics: of a family the ids that were seen or are listened to."""
        targets = self._worker.targets
        names = names_of(targets)
        of_families = {name for each in targets if len(each.names) > 1 for name in each.names}
        if of_families:
            prefix = self.resolve_topic_name("targets/_").removesuffix("_")
            # A subscriber to a topic makes it known.
            for topic, _ in self.get_topic_names_and_types():
                name = topic.removeprefix(prefix).partition("/")[0] if topic.startswith(prefix) else ""
                is_new = name in of_families and name not in names and len(names) < MOST_MEMBERS
                if is_new and self.count_subscribers(topic):
                    names.append(name)
        return names

    def _health(self) -> list[HealthEntry]:
        return self._explainer.health()

    def _on_result(self, result: Result) -> None:
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

    def _publish_held_up(self) -> None:
        frame = self._worker.long_frame()
        if frame is not None and self._outputs is not None:
            self._outputs.publish_held_up(frame.header, frame.text)

    def _needs_keypoints(self) -> bool:
        return self._outputs is not None and self._outputs.needs_keypoints()

    def _warn_once(self, key: str, line: str) -> None:
        if key not in self._warned:
            self._warned.add(key)
            self.get_logger().warning(line)

    def _perception_state(self, stopped_clock: Cause | None) -> PerceptionState:
        outputs = self._outputs
        return PerceptionState(
            self._node_state(),
            misfits=tuple(why_not_served(self, self.publishers)) if outputs is not None and outputs.unmatched() else (),
            stopped_clock=stopped_clock,
            frames="" if outputs is None else outputs.problem,
        )

    def _forget(self) -> str:
        self._worker.reset()
        return "all tracks and paths forgotten"

    def _reload(self) -> BackgroundAction:
        staged = self._server.staged()
        reading = frame_reading(ReadingParameters.of(staged))  # the file may have changed

        def work() -> PreparedLocalizer:
            images = load_target_images(staged.targets, self._log_warning, limits=staged.limits)
            return self._worker.build(images, staged)

        def finish(built: PreparedLocalizer) -> str:
            self._server.reload(staged)
            self._adopt(built)
            self._worker.read_with(reading, staged)
            return "targets: " + (", ".join(target.name for target in self._worker.targets) or "none")

        return BackgroundAction(work, finish)

    def _set_target_from_view(self) -> BackgroundAction:
        last = self._worker.last
        if last is None or last.developed is None:
            raise ImguError("view: no frame yet; need images, and a subscriber to any output")
        view = TargetImage("view", last.developed.grey, 0.0, last.developed.is_linear)

        def finish(built: PreparedLocalizer) -> str:
            self._adopt(built)
            stamp_ns = last.frame.stamp_ns
            return f"target: view, the frame at {stamp_ns} ns, its size unknown; ~/reload brings back the others"

        return BackgroundAction(lambda: self._worker.build([view]), finish)
