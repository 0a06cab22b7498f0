# SPDX-License-Identifier: Apache-2.0
"""The node of one stage of the pipeline."""

from __future__ import annotations

import time
from collections.abc import Sequence

from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ImguError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.messages.diagnostics import HealthEntry, HealthLevel
from imgu_ros.reference.templates import TargetImage
from imgu_ros.remarks import Remarks
from imgu_ros.ros.background_services import BackgroundAction
from imgu_ros.ros.frame_worker import FrameMessages, FrameWorker
from imgu_ros.ros.managed_node import ManagedNode, NodeState
from imgu_ros.ros.middleware import full_memory
from imgu_ros.ros.process import run_node
from imgu_ros.ros.reach import domain_text
from imgu_ros.ros.stages.input import StageInput
from imgu_ros.ros.stages.stage import PipelineStage
from imgu_ros.ros.stopping import StopSignal


def run_stage(stage: PipelineStage, ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run a stage's node until the process is asked to stop; return the exit code.

    Raises
    ------
    ImguError
        If the node cannot start: a bad parameter, a target that cannot be used.
    """
    return run_node(lambda: StageNode(stage, stop), ros_arguments, stop)


class StageNode(ManagedNode[StageInput, FrameWorker]):
    """Topics of earlier stages in, those of this stage out."""

    def __init__(self, stage: PipelineStage, stop: StopSignal) -> None:
        super().__init__(stage.name, stop, stage.selection)
        self._stage = stage
        self._images: tuple[TargetImage, ...] = ()
        self._used: Parameters | None = None
        self._remarks = Remarks()
        topics = stage.topics(self, self._server.parameters)
        self._input = StageInput(self, topics, stage.is_complete)
        self._worker = FrameWorker(self._input.queue, self._process, self._log_failure)
        self._start_timers()
        if stage.needs_targets or stage.reads_camera:
            self._create_slow_service("~/reload", self._reload)

    def _load(self) -> None:
        parameters = self._server.reload()
        self._adopt(parameters, self._target_images(parameters))

    def _target_images(self, parameters: Parameters) -> Sequence[TargetImage]:
        if not self._stage.needs_targets:
            return ()
        return load_target_images(parameters.targets, self._log_warning, limits=parameters.limits)

    def _drop_loaded(self) -> None:
        self._used = None
        self._stage.reset()

    def _begin(self) -> None:
        taken = ", ".join(feed.topic for feed in self._input.topics.feeds)
        self.get_logger().info(
            f"{self._stage.name}: subscribes to {taken} when an output has a subscriber ({domain_text(self)})"
        )

    def _adopt(self, parameters: Parameters, images: Sequence[TargetImage]) -> None:
        with self._worker.between_frames():
            self._stage.use(parameters, images)
            self._used, self._images = parameters, tuple(images)
            self._fit(parameters)

    def _fit(self, parameters: Parameters) -> None:
        """Have the publishers and the inputs that the parameters ask for."""
        self._fit_outputs([image.name for image in self._images], parameters)
        topics = self._stage.topics(self, parameters)
        if topics != self._input.topics:
            self._input.change(topics)

    def _follow(self, parameters: Parameters) -> None:
        if parameters is self._used:
            return
        with self._input.standstill.excused(), self._worker.between_frames():
            self._used = parameters
            try:
                self._stage.use(parameters, self._images)
                self._fit(parameters)
            except ImguError as error:
                self._log_failure(f"parameters: {error}; {self._stage.name} keeps the old ones")

    def _warn_of_override(self, line: str) -> None:
        # Six nodes may share a parameter file.
        self.get_logger().info(f"{line}; an override for another node?")

    def _process(self, frame: FrameMessages) -> None:
        if self._outputs is None or self._worker.is_closing:
            return
        try:
            self._stage.work(frame, self._outputs)
        except ImguError as error:
            self._worker.figures.count_rejected(str(error))
            self._log_rejected(str(error))
            return
        self._worker.figures.count_rejected("")
        self._worker.figures.count_done(frame.received_s)
        for line in self._remarks.news(self._stage.remarks):
            self.get_logger().warning(line)

    def _health(self) -> list[HealthEntry]:
        long = self._worker.long_frame()
        troubles = ["" if long is None else long.text, self._input.standstill.lately(), full_memory()]
        unmatched = 0 if self._outputs is None else self._outputs.unmatched()
        remarks = (*self._stage.remarks, *filter(None, troubles))
        return stage_health(self._node_state(), self._worker, self._input, unmatched, remarks)

    def _forget(self) -> str:
        self._stage.reset()
        return "earlier frames are forgotten"

    def _reload(self) -> BackgroundAction:
        parameters = self._server.staged()

        def finish(images: Sequence[TargetImage]) -> str:
            with self._input.standstill.excused(), self._worker.between_frames():
                self._stage.read_again(parameters)
                self._adopt(parameters, images)
                self._server.reload(parameters)
            if not self._stage.needs_targets:
                return f"camera.info_file: {parameters.camera.info_file or 'none'}"
            return "targets: " + (", ".join(image.name for image in images) or "none")

        return BackgroundAction(lambda: self._target_images(parameters), finish)


def stage_health(
    state: NodeState, worker: FrameWorker, source: StageInput, unmatched_subscribers: int, remarks: Sequence[str]
) -> list[HealthEntry]:
    """Return the entries of /diagnostics.

    Parameters
    ----------
    state, worker, source : of the node
    unmatched_subscribers : subscribers that cannot be served because their QoS is incompatible
    remarks : of the last frame, for people
    """
    now, figures = time.monotonic(), worker.figures
    rest = _rest(state)
    reason = ""
    if not rest:
        rejected = f"rejected: {figures.rejection}" if figures.rejection else ""
        reason = source.why_silent() or rejected or "; ".join(remarks)
    output: dict[str, object] = {
        "lifecycle_state": state.lifecycle,
        **figures.values(now),
        "subscribers_with_incompatible_qos": unmatched_subscribers,
    }
    taken: dict[str, object] = {f"{feed.name}_topic": feed.topic for feed in source.topics.feeds}
    if source.topics.camera_info:
        taken["camera_info_topic"] = source.topics.camera_info
    taken |= {
        "rate_hz": source.arrivals.rate_hz(now),
        "frames": source.arrivals.count,
        "lost": source.counters.lost,
        "skipped": source.queue.skipped,
        "incomplete": source.incomplete,
        "rejected": figures.rejected,
        "absent": ", ".join(sorted(source.absent)),
        "publishers_with_incompatible_qos": source.counters.incompatible,
    }
    level = HealthLevel.WARN if reason else HealthLevel.OK
    return [
        HealthEntry(f"{state.name}: output", level, rest or reason or "works", output),
        HealthEntry(f"{state.name}: input", level, "not subscribed" if rest else reason or "frames come in", taken),
    ]


def _rest(state: NodeState) -> str:
    """Return why the node does not subscribe to its inputs; empty when it does."""
    if state.lifecycle != "active":
        return f"lifecycle state: {state.lifecycle}"
    if state.paused:
        return "paused: call ~/pause with false to go on"
    return "" if state.listened else f"idle: no subscribers in {state.domain}"
