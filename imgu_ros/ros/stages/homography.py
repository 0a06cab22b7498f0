# SPDX-License-Identifier: Apache-2.0
"""The node `homography`: tentative matches in, homographies of the targets out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np
from rclpy.node import Node

from imgu_ros.config.components import DetectionParameters
from imgu_ros.config.parameters import DemosaicParameters, Parameters, RawParameters
from imgu_ros.detect.detector import while_promising
from imgu_ros.detect.features import reduction_of
from imgu_ros.detect.robust_fit import RobustFit, draws
from imgu_ros.errors import ImguError, ParameterError
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import develop
from imgu_ros.messages.features import decode_target_matches, matches_message
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.image import decode_image
from imgu_ros.messages.reduced_info import image_size
from imgu_ros.pose.planar_pose import Located, with_homography
from imgu_ros.reasons import no_matches
from imgu_ros.reference.templates import TargetImage
from imgu_ros.result import ReferenceMatches, ReferenceResult, Result, StageClock, Status, by_name
from imgu_ros.ros.frame_worker import FrameMessages
from imgu_ros.ros.messages import make_message
from imgu_ros.ros.outputs import Outputs, TopicSelection
from imgu_ros.ros.stages.input import StageTopics
from imgu_ros.ros.stages.node import run_stage
from imgu_ros.ros.stages.stage import (
    CLOUD_TYPE,
    TargetStage,
    camera_info_beside,
    cloud_feed,
    frame_without_image,
    picture_feed,
    unusable,
)
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.vision.matching.matches import Matches

#: What each homography was fitted to: the columns of `matches`.
INLIERS = "homography/inliers"
_MATCHES = "matches"
_PICTURE = "image_mono"


def run(ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run the node until the process is asked to stop; return the exit code."""
    return run_stage(HomographyStage(), ros_arguments, stop)


class HomographyStage(TargetStage):
    """Fits a homography to the matches of each target, verifies and refines it."""

    name = "homography"
    takes = (_MATCHES,)
    reads_camera = True
    selection = TopicSelection(
        lambda topic: topic in ("homography", "status") or topic.rpartition("/")[2] == "outline", {INLIERS: CLOUD_TYPE}
    )

    def topics(self, node: Node, parameters: Parameters) -> StageTopics:
        """See `PipelineStage.topics`."""
        picture = picture_feed(node, _PICTURE)
        return StageTopics((cloud_feed(node, _MATCHES), picture), camera_info_beside(node, picture, parameters))

    def use(self, parameters: Parameters, images: Sequence[TargetImage]) -> None:
        """See `PipelineStage.use`."""
        if parameters.matching.guided:
            raise ParameterError("matching.guided: true; need false in a stage node, which has no descriptors")
        super().use(parameters, images)

    def is_complete(self, messages: Mapping[str, Any], absent: Set[str]) -> bool:
        """See `PipelineStage.is_complete`: without refinement the image is not needed where it has no publisher."""
        spared = _PICTURE in absent and not self.parameters.refinement.enabled
        return _MATCHES in messages and (_PICTURE in messages or spared)

    def work(self, job: FrameMessages, outputs: Outputs) -> None:
        """See `PipelineStage.work`."""
        header = self.named(decode_header(job.messages[_MATCHES]))
        tentative = decode_target_matches(job.messages[_MATCHES])
        clock = StageClock()
        frame, fit = self._robust_fit(job, header, clock)
        places: dict[str, Located] = {}

        def finish(found: ReferenceResult, place: Located) -> ReferenceResult:
            # The pose is another stage's.
            places[found.name] = place
            return with_homography(found, self.targets[found.number].plane, place, frame.camera)

        def sought() -> Iterator[ReferenceResult]:
            for number, matches in tentative.items():
                if not 0 <= number < len(self.targets):
                    continue
                target = self.targets[number]
                missing = ReferenceResult(target.name, number, Status.LOST, matches=matches)
                rng = draws(self.parameters.seed, header.stamp_ns, target)
                yield fit.locate(missing, target, rng, finish=finish)

        found = by_name(while_promising(sought()))
        results = {
            each.name: found.get(each.name) or ReferenceResult(each.name, each.number, Status.LOST, reason=no_matches())
            for each in self.targets
        }
        result = Result(frame, results, times_ns=clock.times_ns, total_ns=sum(clock.times_ns.values()))
        outputs.publish(result)
        fitted = [
            replace(found[each.name], matches=_agreeing(places[each.name]))
            for each in self.targets
            if each.name in places
        ]
        outputs.offer(INLIERS, lambda: matches_message(make_message, header, fitted))

    def _robust_fit(self, job: FrameMessages, header: Header, clock: StageClock) -> tuple[Frame, RobustFit]:
        image = None
        if _PICTURE in job.messages:
            image = develop(decode_image(job.messages[_PICTURE]), RawParameters(), DemosaicParameters())
            height, width = image.shape
        elif job.camera_info is not None:
            size = image_size(job.camera_info)
            width, height = size.width, size.height
        elif self.reading.file_camera is not None:
            width, height = self.reading.file_camera.image_size
        else:
            raise ImguError("frame: neither image_mono nor camera_info; need one of them, or camera.info_file")
        read = self.reading.camera(job.camera_info, (width, height))
        self.remarks = unusable(read) or read.remarks
        parameters, frame = DetectionParameters.of(self.parameters), frame_without_image(header, read)
        return frame, RobustFit(frame, image, reduction_of((height, width), parameters).unit_px, parameters, clock)


def _agreeing(place: Located) -> ReferenceMatches:
    count = len(place.template_xy)
    none = np.full(count, -1, np.intp)
    matches = Matches(none, none, np.zeros(count))
    return ReferenceMatches(matches, place.template_xy, place.image_xy, np.ones(count, bool))
