# SPDX-License-Identifier: Apache-2.0
"""The node `pose`: homographies in, the camera's pose out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

from rclpy.node import Node

from imgu_ros.build_cache import BuildCache
from imgu_ros.camera_memory import JUMP_NS
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import EstimationError
from imgu_ros.frame import Frame
from imgu_ros.messages.camera_reading import CameraReading
from imgu_ros.messages.features import decode_calibrated, decode_estimates, decode_sharp, decode_target_matches
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.results import result_status_message
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.planar_pose import Located
from imgu_ros.reasons import no_homography, no_pose
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.size_checks import SizeChecks
from imgu_ros.result import ReferenceMatches, ReferenceResult, Result, Status, by_name
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.outputs import Outputs, TopicSelection
from imgu_ros.ros.stages.homography import INLIERS
from imgu_ros.ros.stages.input import StageTopics
from imgu_ros.ros.stages.node import run_stage
from imgu_ros.ros.stages.stage import (
    TargetStage,
    camera_info_beside,
    cloud_feed,
    frame_without_image,
    unusable,
)
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.vision.projective.homography import HomographyEstimate

STATUS = "pose/status"
_HOMOGRAPHY = "homography"
_GIVEN = ("pose", "odom", "path")
_NOT_THE_IMAGES = "camera_info is not that of the image, says the node homography"
_NOT_THERE_TOO = "the node homography has no camera that fits the image; need the same camera.info_file there"


def run(ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run the node until the process is asked to stop; return the exit code."""
    return run_stage(PoseStage(), ros_arguments, stop)


class PoseStage(TargetStage):
    """Finds the pose of a calibrated camera."""

    name = "pose"
    takes = (_HOMOGRAPHY, INLIERS)
    reads_camera = True
    selection = TopicSelection(
        lambda topic: topic == "/tf" or topic.rpartition("/")[2] in _GIVEN,
        {STATUS: "diagnostic_msgs/msg/DiagnosticArray"},
    )

    def __init__(self) -> None:
        super().__init__()
        self._check = CalibrationCheck()
        self._last_ns: int | None = None
        self._sizes = SizeChecks(())

    def _prepare(self, parameters: Parameters, parts: BuildCache) -> None:
        self._sizes = SizeChecks(self.targets)

    def reset(self) -> None:
        """See `PipelineStage.reset`."""
        self._check.reset()
        self._last_ns = None
        self._sizes = SizeChecks(self.targets)

    def topics(self, node: Node, parameters: Parameters) -> StageTopics:
        """See `PipelineStage.topics`."""
        homography = cloud_feed(node, _HOMOGRAPHY)
        return StageTopics((homography, cloud_feed(node, INLIERS)), camera_info_beside(node, homography, parameters))

    def work(self, job: FrameMessages, outputs: Outputs) -> None:
        """See `PipelineStage.work`."""
        header = decode_header(job.messages[_HOMOGRAPHY])
        agreeing = decode_target_matches(job.messages[INLIERS])
        counts = {index: len(matches.template_xy) for index, matches in agreeing.items()}
        estimates = decode_estimates(job.messages[_HOMOGRAPHY], counts)
        sharp = decode_sharp(job.messages[_HOMOGRAPHY])
        # The node `homography` knows the image's size: its message says whether camera_info fits it.
        read = self.reading.camera(job.camera_info, None)
        if read.camera is not None and not decode_calibrated(job.messages[_HOMOGRAPHY]):
            read = CameraReading(None, _NOT_THE_IMAGES if self.reading.file_camera is None else _NOT_THERE_TOO)
        if self._last_ns is not None and header.stamp_ns < self._last_ns - JUMP_NS:
            self._check.reset()
        self._last_ns = header.stamp_ns
        frame = frame_without_image(header, read)
        found = by_name(self._posed(each, estimates, agreeing, sharp, frame) for each in self.targets)
        result = Result(frame, self._check.examined(frame.camera, found), calibration=self._check.finding)
        self._sizes.add(result)
        self.remarks = (*(unusable(read) or result.camera_remarks), *self._sizes.warnings.values())
        outputs.publish(result)
        outputs.offer(STATUS, lambda: result_status_message(make_message, result))

    def _posed(
        self,
        target: Reference,
        estimates: Mapping[int, HomographyEstimate],
        agreeing: Mapping[int, ReferenceMatches],
        sharp: Set[int],
        frame: Frame,
    ) -> ReferenceResult:
        number = target.number
        if number not in estimates:
            return ReferenceResult(target.name, number, Status.LOST, reason=no_homography())
        matches = agreeing[number]
        place = Located(
            matches.template_xy,
            matches.image_xy,
            estimates[number],
            halvings=int(number not in sharp),
            alike=target.symmetries,
        )
        found = ReferenceResult(target.name, number, Status.DETECTED, matches=matches)
        try:
            return target.pose(found, place, frame)
        except EstimationError as error:
            return ReferenceResult(target.name, number, Status.DEGENERATE, reason=no_pose(error), matches=matches)
