# SPDX-License-Identifier: Apache-2.0
"""The node `demosaic`: raw images in; colour, grey, and the image in which keypoints are detected out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rclpy.node import Node

from imgu_ros.config.components import DevelopmentParameters, FeatureParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.features import plain_picture
from imgu_ros.errors import ImguError
from imgu_ros.image.frame_image import FrameImage, develop_frame
from imgu_ros.messages.header_checks import HeaderChecks
from imgu_ros.messages.reduced_info import Covered, reduced_info_message
from imgu_ros.messages.results import picture_message, result_header
from imgu_ros.result import Result
from imgu_ros.ros.frame_input import CAMERA_INFO_TYPE
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.image_input import input_topics
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.outputs import Outputs, TopicSelection
from imgu_ros.ros.qos import image_qos
from imgu_ros.ros.stages.input import Feed, StageTopics
from imgu_ros.ros.stages.node import run_stage
from imgu_ros.ros.stages.stage import IMAGE_TYPE, PipelineStage
from imgu_ros.ros.stopping import StopSignal

REDUCED = "reduced/image_mono"
REDUCED_INFO = "reduced/camera_info"
_IN = "image_raw"


def run(ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run the node until the process is asked to stop; return the exit code."""
    return run_stage(DemosaicStage(), ros_arguments, stop)


class DemosaicStage(PipelineStage):
    """Develops raw frames."""

    name = "demosaic"
    takes = (_IN,)
    reads_camera = True
    selection = TopicSelection(
        lambda topic: topic in ("image_color", "image_mono"),
        {REDUCED: IMAGE_TYPE, REDUCED_INFO: CAMERA_INFO_TYPE},
    )

    def __init__(self) -> None:
        self._named = ("", "")
        self._headers = HeaderChecks(*self._named)

    def topics(self, node: Node, parameters: Parameters) -> StageTopics:
        """See `PipelineStage.topics`."""
        known = input_topics(node, parameters.image_transport)
        if self._named != (known.image, known.camera_info):
            self._named = (known.image, known.camera_info)
            self._headers = HeaderChecks(*self._named)
        camera_info = "" if parameters.camera.info_file else known.camera_info
        return StageTopics((Feed(_IN, known.image, known.image_type, image_qos()),), camera_info)

    def work(self, job: FrameMessages, outputs: Outputs) -> None:
        """See `PipelineStage.work`."""
        p = self.parameters
        self._headers.add_image(job.messages[_IN])
        if job.camera_info is not None:
            self._headers.add_camera_info(job.camera_info)
        self.remarks = tuple(self._headers.told(p.frames.camera, lately=True).values())
        frame = self.reading.frame(job.messages[_IN], job.camera_info)
        frame = replace(frame, frame_id=p.frames.camera or frame.frame_id)
        if frame.image.remark:
            self.remarks += (frame.image.remark,)
        development = develop_frame(frame, DevelopmentParameters.of(p))
        if development.image is None:
            raise ImguError(development.reason)
        result = Result(frame, {}, developed=development.image)
        # First: it is reduced from the mosaic itself as long as no full-size image has been made.
        if outputs.listened(REDUCED) or outputs.listened(REDUCED_INFO):
            self._publish_reduced(result, development.image, outputs)
        outputs.publish(result)

    def _publish_reduced(self, result: Result, pictures: FrameImage, outputs: Outputs) -> None:
        reduced = plain_picture(pictures, FeatureParameters.of(self.parameters))
        height, width = pictures.shape
        covered = Covered(*(int(side) for side in reduced.full_size))
        size = Covered(reduced.image.shape[1], reduced.image.shape[0])
        header, camera = result_header(result), result.frame.camera
        outputs.offer(
            REDUCED_INFO,
            lambda: reduced_info_message(make_message, header, camera, Covered(width, height), covered, size),
        )
        outputs.offer(REDUCED, lambda: picture_message(make_message, result, reduced.image))
