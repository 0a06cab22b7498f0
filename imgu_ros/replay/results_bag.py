# SPDX-License-Identifier: Apache-2.0
"""The results bag of a replay: the messages that the live node would have published, stamped as the input."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.writing import BagWriter
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import EstimationError
from imgu_ros.messages.geometry import PathHistory, odometry_message
from imgu_ros.messages.results import FRAME_OUTPUTS, TARGET_OUTPUTS, level_message, picture_message, result_header
from imgu_ros.pose.map_pose import camera_in_map
from imgu_ros.replay.recorded_topics import FRAME_TOPICS, TARGET_TOPICS, checked_record, pyramid_level
from imgu_ros.report.overlay import draw_result
from imgu_ros.result import ReferenceResult, Result
from imgu_ros.vision.camera.rigid import rigid_transforms


class ResultsBag:
    """Writes the results bag (MCAP).

    Parameters
    ----------
    path : the bag's folder
    parameters : names of frames, length of a path, and the targets' places in the map
    targets : names, the first one's topics appear without a prefix too
    record : topics to record beside those that always are
    """

    def __init__(self, path: Path, parameters: Parameters, targets: Sequence[str], record: Sequence[str]) -> None:
        self._record = checked_record(record)
        self._prefix = parameters.frames.target_prefix
        self._camera_frame = parameters.frames.camera
        self._paths = {
            name: PathHistory(make_message, self._prefix + name, parameters.path.max_length) for name in targets
        }
        self._map_from_target = rigid_transforms(parameters.targets.poses, "targets.poses")
        self._widths_m = parameters.targets.widths_m
        self._map_frame = parameters.frames.map
        self._map_path = PathHistory(make_message, self._map_frame, parameters.path.max_length)
        self._writer = BagWriter(path)

    def close(self) -> None:
        """Complete the bag.

        Raises
        ------
        BagError
            If it cannot be completed.
        """
        self._writer.close()

    def write(self, result: Result, time_ns: int) -> None:
        """Write the messages of one frame; `time_ns` is when the bag recorded the frame."""
        if self._camera_frame:
            result = replace(result, frame=replace(result.frame, frame_id=self._camera_frame))
        for topic in (*FRAME_TOPICS, *self._record):
            self._write(topic, _frame_message(topic, result), time_ns)
        for target in result:
            for topic in TARGET_TOPICS:
                frame = self._prefix + target.name
                self._write_target(
                    topic, target, TARGET_OUTPUTS[topic].message(make_message, result, target, frame), time_ns
                )
            if "path" in self._record and target.pose is not None:
                path = self._paths[target.name].add(result.frame.stamp_ns, target.pose)
                self._write_target("path", target, path, time_ns)
        if self._map_from_target:
            self._write_in_map(result, time_ns)

    def _write_in_map(self, result: Result, time_ns: int) -> None:
        with suppress(EstimationError):  # targets that contradict each other beyond measure: no place in the map
            fused = camera_in_map(result, self._map_from_target, self._widths_m)
            if fused is None:
                return
            camera_from_map = fused.pose.inverse()
            message = odometry_message(make_message, result_header(result), self._map_frame, camera_from_map)
            self._write("map/odom", message, time_ns)
            if "path" in self._record:
                self._write("map/path", self._map_path.add(result.frame.stamp_ns, camera_from_map), time_ns)

    def _write_target(self, topic: str, target: ReferenceResult, message: Any | None, time_ns: int) -> None:
        unprefixed = (f"/{topic}",) if target.number == 0 else ()
        self._write(f"targets/{target.name}/{topic}", message, time_ns, *unprefixed)

    def _write(self, topic: str, message: Any | None, time_ns: int, *also: str) -> None:
        if message is not None:
            self._writer.write(f"/{topic}", message, time_ns, *also)


def _frame_message(topic: str, result: Result) -> Any | None:
    level = pyramid_level(topic)
    if level is not None:
        return level_message(make_message, result, level)
    if topic == "debug_image":
        return picture_message(make_message, result, draw_result(result))
    return FRAME_OUTPUTS[topic].message(make_message, result) if topic in FRAME_OUTPUTS else None
