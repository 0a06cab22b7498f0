# SPDX-License-Identifier: Apache-2.0
"""The node `pyramid`: a grey image in, its pyramid out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rclpy.node import Node

from imgu_ros.config.components import FeatureParameters
from imgu_ros.config.parameters import DemosaicParameters, Parameters, RawParameters
from imgu_ros.detect.features import Reduced, frame_pyramid, reduced_picture
from imgu_ros.image.frame_image import develop
from imgu_ros.messages.frame import decode_frame
from imgu_ros.messages.reduced_info import Covered, decode_covered, reduced_info_from, reduced_info_message
from imgu_ros.messages.results import result_header
from imgu_ros.result import Result
from imgu_ros.ros.frame_input import CAMERA_INFO_TYPE
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.outputs import Outputs, TopicSelection
from imgu_ros.ros.stages.demosaic import REDUCED, REDUCED_INFO
from imgu_ros.ros.stages.input import StageTopics
from imgu_ros.ros.stages.node import run_stage
from imgu_ros.ros.stages.stage import PipelineStage, picture_feed, reduced_info_beside
from imgu_ros.ros.stopping import StopSignal

LEVELS = "pyramid/level_"
LEVELS_INFO = "pyramid/camera_info"


def run(ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run the node until the process is asked to stop; return the exit code."""
    return run_stage(PyramidStage(), ros_arguments, stop)


class PyramidStage(PipelineStage):
    """Builds pyramids."""

    name = "pyramid"
    takes = (REDUCED,)
    selection = TopicSelection(lambda topic: topic.startswith(LEVELS), {LEVELS_INFO: CAMERA_INFO_TYPE})

    def topics(self, node: Node, parameters: Parameters) -> StageTopics:
        """See `PipelineStage.topics`."""
        picture = picture_feed(node, REDUCED)
        return StageTopics((picture,), reduced_info_beside(node, picture, REDUCED_INFO))

    def work(self, job: FrameMessages, outputs: Outputs) -> None:
        """See `PipelineStage.work`."""
        frame = decode_frame(job.messages[REDUCED], None, rectified=False)
        # The image was developed by the stage that published it.
        developed = develop(frame.image, RawParameters(), DemosaicParameters())
        height, width = developed.shape
        size = Covered(width, height)
        shown = size if job.camera_info is None else decode_covered(job.camera_info, size)
        parameters = FeatureParameters.of(self.parameters)
        base = reduced_picture(developed, parameters)
        full_size = base.full_size * (shown.width, shown.height) / (width, height)
        pyramid = frame_pyramid(Reduced(base.image, full_size), parameters)
        result = Result(frame, {}, developed=developed, pyramid=pyramid)
        header = self.named(result_header(result))
        covered = Covered(*np.rint(full_size).astype(int).tolist())
        level = Covered(base.image.shape[1], base.image.shape[0])
        if job.camera_info is None:
            info = reduced_info_message(make_message, header, None, shown, covered, level)
        else:
            info = reduced_info_from(make_message, header, job.camera_info, covered, level)
        outputs.offer(LEVELS_INFO, lambda: info)
        outputs.publish(result)
