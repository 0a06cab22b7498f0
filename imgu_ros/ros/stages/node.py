# SPDX-License-Identifier: Apache-2.0
"""The node of one stage of the chain: lifecycle, parameters, lazy inputs, one worker, diagnostics."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

from imgu_ros.config.components import OutputParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ImguError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.messages.diagnostics import diagnostics_message
from imgu_ros.reference.templates import TargetImage
from imgu_ros.remarks import Remarks
from imgu_ros.ros.current_frame import CurrentFrame
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.managed_node import ManagedNode, run_managed
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.middleware import full_memory
from imgu_ros.ros.outputs import Outputs
from imgu_ros.ros.qos import no_events, output_qos
from imgu_ros.ros.reach import domain_text
from imgu_ros.ros.stages.health import StageFigures, StageState, stage_health
from imgu_ros.ros.stages.input import StageInput, StageJob
from imgu_ros.ros.stages.stage import Stage
from imgu_ros.ros.standstill import Standstill
from imgu_ros.ros.stopping import StopSignal

_WATCH_S = 0.1
_DIAGNOSTICS_S = 1.0
_END_S = 1.0


def run_stage(stage: Stage, ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run a stage's node until the process is asked to stop; return the exit code.

    Raises
    ------
    ImguError
        If the node cannot start: a bad parameter, a target that cannot be used.
    """
    return run_managed(lambda: StageNode(stage, stop), ros_arguments, stop)


class StageNode(ManagedNode[StageInput]):
    """Some topics in, others out.

    Callbacks run in the executor's thread and only hand over; one worker thread does the stage's work and publishes.
    Inputs are subscribed only while the node is active, not paused, and somebody listens.
    """

    def __init__(self, stage: Stage, stop: StopSignal) -> None:
        super().__init__(stage.name, stop)
        self._stage = stage
        self._listened = False
        self._told: set[str] = set()
        self._figures = StageFigures()
        self._images: tuple[TargetImage, ...] = ()
        self._used: Parameters | None = None
        self._standstill = Standstill()
        self._in_hand = CurrentFrame()
        self._slot: FrameQueue[StageJob] = FrameQueue(is_old=lambda job: self._standstill.precedes(job.received_s))
        self._input = self._made_input()
        self._diagnostics = self.create_publisher(
            message_class("diagnostic_msgs/msg/DiagnosticArray"),
            "/diagnostics",
            output_qos(10),
            event_callbacks=no_events(),
        )
        self.create_timer(_WATCH_S, self._watch, clock=self._steady)
        self.create_timer(_DIAGNOSTICS_S, self._publish_diagnostics, clock=self._steady)
        if stage.needs_targets or stage.reads_camera:
            self._create_slow_service("~/reload", self._reload)
        self._remarks = Remarks()
        self._between_frames = threading.RLock()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread.start()

    def close(self) -> bool:
        """Drop the inputs and end the threads; return whether they have ended."""
        ended = super().close()
        self._closing = True
        self._slot.close()
        self._thread.join(_END_S)
        return not self._thread.is_alive() and ended

    def _drop(self) -> None:
        with self._between_frames:
            if self._outputs is not None:
                self._outputs.destroy()
                self._outputs = None
            self._used = None
            self._stage.reset()

    def _begin(self) -> None:
        taken = ", ".join(feed.topic for feed in self._input.topics.feeds)
        self.get_logger().info(f"{self._stage.name}: takes {taken} when somebody listens ({domain_text(self)})")

    def _made_input(self) -> StageInput:
        topics = self._stage.topics(self, self._server.parameters)
        return StageInput(self, topics, self._stage.is_complete, self._slot, self._standstill)

    def _load(self) -> None:
        parameters = self._server.reload()
        self._adopt(
            parameters,
            load_target_images(parameters.targets, self._log_warning, limits=parameters.limits)
            if self._stage.needs_targets
            else [],
        )

    def _adopt(self, parameters: Parameters, images: Sequence[TargetImage]) -> None:
        with self._between_frames:
            self._stage.use(parameters, images)
            self._used, self._images = parameters, tuple(images)
            self._fit(parameters)

    def _fit(self, parameters: Parameters) -> None:
        """Have the publishers and the inputs that the parameters ask for."""
        names, wanted = [image.name for image in self._images], OutputParameters.of(parameters)
        if self._outputs is None or not self._outputs.serves(names, wanted):
            if self._outputs is None:
                self._outputs = Outputs(self, names, wanted, self._stage.choice)
            else:
                self._outputs.adapt(names, wanted)
            possible = self._outputs.qos_override_names() + self._input.qos_override_names()
            for line in self._server.unknown_qos_overrides(possible):
                if line not in self._told:
                    self._told.add(line)
                    # Six nodes may share a parameter file.
                    self.get_logger().info(f"{line}; an override for another node?")
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
        self._listened = self._outputs is not None and self._outputs.wanted()
        self._input.limits = parameters.limits
        if self._state().works:
            self._input.open()
            self._input.check_waiting()
        else:
            self._input.close()

    def _follow(self, parameters: Parameters) -> None:
        with self._standstill.excused(), self._between_frames:
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
                    self._in_hand.begin(next(iter(job.messages.values())))
                    self._stage.work(job, self._outputs)
                self._figures.worked(job.received_s, time.monotonic())
                for line in self._remarks.news(self._stage.remarks):
                    self.get_logger().warning(line)
            except ImguError as error:
                self._figures.rejected(str(error))
                self._log_rejected(str(error))
            except Exception as error:
                # One bad message must not end the node, whatever is wrong with it.
                if not self._closing:
                    self._log_failure(f"frame: {type(error).__name__}: {' '.join(str(error).split())}")
            finally:
                self._in_hand.end()

    def _state(self) -> StageState:
        name, domain = self.get_fully_qualified_name(), domain_text(self)
        return StageState(name, self._lifecycle, self._paused, self._listened, domain)

    def _publish_diagnostics(self) -> None:
        if not self._diagnostics.get_subscription_count():
            return
        unmatched = 0 if self._outputs is None else self._outputs.unmatched()
        long = self._in_hand.long()
        troubles = ["" if long is None else long.text, self._standstill.lately(), full_memory()]
        remarks = (*self._stage.remarks, *filter(None, troubles))
        entries = stage_health(self._state(), self._figures, self._input, self._slot.skipped, unmatched, remarks)
        self._diagnostics.publish(diagnostics_message(make_message, self.get_clock().now().nanoseconds, entries))

    def _reset(self) -> str:
        with self._standstill.excused(), self._between_frames:
            if self._outputs is not None:
                self._outputs.reset()
            self._stage.reset()
        return "all that earlier frames told is forgotten"

    async def _reload(self) -> str:
        parameters = self._server.staged()
        needs_targets = self._stage.needs_targets
        images = (
            await self._do_beside(
                lambda: load_target_images(parameters.targets, self._log_warning, limits=parameters.limits)
            )
            if needs_targets
            else []
        )
        self._require_configured()  # it may have been cleaned up meanwhile
        with self._standstill.excused(), self._between_frames:
            self._stage.read_again(parameters)
            self._adopt(parameters, images)
            self._server.reload(parameters)
        if not needs_targets:
            return f"camera.info_file: {parameters.camera.info_file or 'none'}"
        return "targets: " + (", ".join(image.name for image in images) or "none")
