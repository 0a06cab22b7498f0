# SPDX-License-Identifier: Apache-2.0
"""The node `matcher`: keypoints in, their tentative matches with the targets' out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rclpy.node import Node

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import DetectionParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.detector import ReferenceDetector
from imgu_ros.errors import EncodingError
from imgu_ros.messages.features import decode_keypoints
from imgu_ros.messages.header import decode_header
from imgu_ros.reference.planar import PlanarReference
from imgu_ros.result import ReferenceMatches, ReferenceResult, Result, Status, by_name
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.outputs import Outputs, TopicSelection
from imgu_ros.ros.stages.input import StageTopics
from imgu_ros.ros.stages.node import run_stage
from imgu_ros.ros.stages.stage import TargetStage, cloud_feed, frame_without_image
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.matching.matches import Matches

_IN = "keypoints"


def run(ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run the node until the process is asked to stop; return the exit code."""
    return run_stage(MatcherStage(), ros_arguments, stop)


class MatcherStage(TargetStage):
    """Matches descriptors to those of the targets."""

    name = "matcher"
    takes = (_IN,)
    selection = TopicSelection(lambda topic: topic == "matches", {})
    needs_features = True
    _seeker: ReferenceDetector | None = None

    def topics(self, node: Node, parameters: Parameters) -> StageTopics:
        """See `PipelineStage.topics`."""
        return StageTopics((cloud_feed(node, _IN),))

    def _prepare(self, parameters: Parameters, parts: BuildCache) -> None:
        self._seeker = ReferenceDetector(self._planar(), DetectionParameters.of(parameters), parts)

    def _planar(self) -> list[PlanarReference]:
        return [each for each in self.targets if isinstance(each, PlanarReference)]

    def work(self, job: FrameMessages, outputs: Outputs) -> None:
        """See `PipelineStage.work`."""
        message = job.messages[_IN]
        keypoints, descriptors = decode_keypoints(message)
        if self._seeker is None or not self._planar():
            return
        known = self._planar()[0].features.described.descriptors
        if descriptors is None or descriptors.shape[1:] != known.shape[1:] or descriptors.dtype != known.dtype:
            got = "none" if descriptors is None else f"{descriptors.shape[1]} x {descriptors.dtype}"
            raise EncodingError(f"descriptors: {got}; need {known.shape[1]} x {known.dtype}: the same descriptor.kind")
        found = list(self._seeker.match(Descriptions(keypoints, descriptors)))
        # The others are published without matches, so that the next stage knows that the frame was searched.
        sought = {result.name for result in found}
        found += [
            ReferenceResult(each.name, each.number, Status.LOST, matches=_NONE)
            for each in self.targets
            if each.name not in sought
        ]
        outputs.publish(Result(frame_without_image(decode_header(message)), by_name(found)))


_NO_INDICES = np.zeros(0, np.intp)
_NONE = ReferenceMatches(
    Matches(_NO_INDICES, _NO_INDICES, np.zeros(0)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, bool)
)
