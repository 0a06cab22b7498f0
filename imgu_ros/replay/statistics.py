# SPDX-License-Identifier: Apache-2.0
"""Statistics of the frames of a replay, and what its report needs beside frames.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from imgu_ros.config.parameters import Parameters
from imgu_ros.files.pose_files import RisingStamps
from imgu_ros.frame import Frame
from imgu_ros.reasons import reason_kind
from imgu_ros.replay.output_folder import RunFolder
from imgu_ros.report.summary import Reason, Source
from imgu_ros.report.target_cards import TargetCard
from imgu_ros.result import CalibrationFinding, Result, Status
from imgu_ros.simulate.truth import Truth
from imgu_ros.vision.camera.intrinsics import Camera

_MOST_REASONS = 100


class ReasonCounts:
    """Counts reasons by status; reasons that differ only in their numbers count as one."""

    def __init__(self) -> None:
        self._first: dict[tuple[str, str], str] = {}
        self._count: dict[tuple[str, str], int] = {}

    def add(self, status: str, reason: str) -> bool:
        """Count one case; return whether it is the first of its kind."""
        key = (status, reason_kind(reason))
        if key not in self._first and len(self._first) >= _MOST_REASONS:
            key, reason = (status, ""), "other reasons"
        is_new = key not in self._first
        if is_new:
            self._first[key] = reason
        self._count[key] = self._count.get(key, 0) + 1
        return is_new

    def counted(self) -> Sequence[Reason]:
        """Return all kinds, the most frequent first, each with its first case's words."""
        reasons = [Reason(status, self._first[status, kind], n) for (status, kind), n in self._count.items()]
        return tuple(sorted(reasons, key=lambda reason: (-reason.count, reason.status, reason.reason)))


@dataclass(slots=True, eq=False)
class ReplayStatistics:
    """Counts of a replay's frames, and what its first one tells: nothing that grows with their number.

    Attributes
    ----------
    frames, rejected : how many
    first_reason : why the first of those that were rejected was
    seconds : time that all took
    reasons : why targets were not found, have no pose, or frames were rejected
    image_size : width and height of the first frame that was read, px; 0 without one
    layout : of that frame, such as `bayer rggb uint16`
    camera : of that frame
    calibration : what all frames so far say of their camera's calibration; None before the first pose
    trajectories : which poses the targets' .tum files have
    """

    frames: int = 0
    rejected: int = 0
    first_reason: str = ""
    seconds: float = 0.0
    reasons: ReasonCounts = field(default_factory=ReasonCounts)
    image_size: tuple[int, int] = (0, 0)
    layout: str = ""
    camera: Camera | None = None
    calibration: CalibrationFinding | None = None
    trajectories: RisingStamps = field(default_factory=RisingStamps)

    def add(self, result: Result) -> str:
        """Count a frame; return why it was rejected, when it was and for a reason that is new."""
        self.frames += 1
        if result.reason:
            self.rejected += 1
            self.first_reason = self.first_reason or result.reason
            return result.reason if self.reasons.add(Status.REJECTED.value, result.reason) else ""
        self.calibration = result.calibration or self.calibration
        if not self.layout:
            self._describe(result.frame)
        for target in result:
            if target.reason:
                status = target.pose_status if target.status.found else target.status
                self.reasons.add(status.value, target.reason)
            if target.pose is not None:
                self.trajectories.takes(target.name, result.frame.stamp_ns)
        return ""

    def warnings(self) -> list[str]:
        """Return what the user should know of the results."""
        return [
            f"poses_{name}.tum: {count} poses left out, whose stamps do not rise; frames.csv has all of them"
            for name, count in self.trajectories.left_out.items()
        ]

    def _describe(self, frame: Frame) -> None:
        height, width = frame.image.pixels.shape[:2]
        layout = frame.image.layout
        pattern = f" {layout.pattern.value}" if layout.pattern else ""
        self.image_size = (width, height)
        self.layout = f"{layout.color.value}{pattern} {frame.image.pixels.dtype.name}"
        self.camera = frame.camera


@dataclass(frozen=True, slots=True, eq=False)
class FinishedReplay:
    """A replay whose frames are all processed.

    Attributes
    ----------
    folder : its folder, with a complete frames.csv
    statistics : of the frames
    source : what was replayed
    truths : of the truth file; empty without one
    sizes : width and height of each target, px
    parameters : of the replay
    warnings : all so far
    cards : what the report shows of the targets
    command : that was run; empty: none
    date : when the replay began
    """

    folder: RunFolder
    statistics: ReplayStatistics
    source: Source
    truths: Sequence[Truth]
    sizes: Mapping[str, tuple[int, int]]
    parameters: Parameters
    warnings: tuple[str, ...]
    cards: tuple[TargetCard, ...]
    command: str
    date: str
