# SPDX-License-Identifier: Apache-2.0
"""The figures of a replay: what `summary.json` says and the report shows."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imgu_ros.config.parameters import ParameterValue
from imgu_ros.file_access.text_files import write_text
from imgu_ros.report.table import FrameTable
from imgu_ros.result import CalibrationFinding, PoseStatus, Stage, Status
from imgu_ros.types import Floats


@dataclass(frozen=True, slots=True)
class Percentiles:
    """How a quantity is distributed over the frames that have it."""

    count: int
    mean: float
    p50: float
    p95: float
    maximum: float


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a target was not found, has no pose, or a frame was rejected; numbers in it are those of the first case."""

    status: str
    reason: str
    count: int


@dataclass(frozen=True, slots=True)
class Source:
    """What was replayed.

    Attributes
    ----------
    bags, truth : paths as given; no truth: empty
    image_topic, camera_info_topic : no camera_info: empty
    camera_info_file : what was used instead of camera_info; empty: nothing
    image_size : width x height of the first frame, empty without one
    layout : of the first frame, such as `bayer rggb 16 bit`
    recording : absolute paths of what was replayed
    rate_hz : pictures a second, where that was given; else 0
    """

    bags: tuple[str, ...]
    truth: str
    image_topic: str
    camera_info_topic: str
    camera_info_file: str
    image_size: str
    layout: str
    recording: tuple[str, ...] = ()
    rate_hz: float = 0.0


@dataclass(frozen=True, slots=True)
class TargetSummary:
    """One target over all frames; percentiles are None where no frame has the quantity.

    `nees` is the pose's squared error in units of its covariance: mean 6, median 5.35, 95 % below 12.59 when the
    covariance is right.
    """

    name: str
    frames: int
    found: int
    status: Mapping[str, int]
    pose_status: Mapping[str, int]
    n_inliers: Percentiles | None
    rms_px: Percentiles | None
    corner_error_px: Percentiles | None
    rotation_error_deg: Percentiles | None
    translation_error_percent: Percentiles | None
    nees: Percentiles | None


@dataclass(frozen=True, slots=True)
class Summary:
    """A replay in figures.

    `frames` is the number of input frames, `rejected` of which could not be read. `rate_in_hz` is the rate of the
    stamps; `frames_per_s` that of the whole replay on this machine, reading and writing included. `calibration` is
    what the pictures said of camera_info in the end; None without poses. `command` and `date`: what was run, empty when
    it was no command, and when.
    """

    frames: int
    rejected: int
    rate_in_hz: float | None
    targets: tuple[TargetSummary, ...]
    reasons: tuple[Reason, ...]
    warnings: tuple[str, ...]
    source: Source
    frames_per_s: float
    seconds: float
    total_ms: Percentiles | None
    stage_ms: Mapping[str, Percentiles]
    versions: Mapping[str, str]
    seed: ParameterValue
    parameters: Mapping[str, ParameterValue]
    calibration: CalibrationFinding | None = None
    command: str = ""
    date: str = ""


def write_summary(path: Path, summary: Summary) -> None:
    """Write `summary` as JSON.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    text = json.dumps(dataclasses.asdict(summary), indent=2, allow_nan=False) + "\n"
    write_text(path, text, synced=True)


def target_summaries(table: FrameTable) -> tuple[TargetSummary, ...]:
    """Summarise every target of `table`."""
    return tuple(_target_summary(table, index) for index in range(len(table.targets)))


def stage_percentiles(table: FrameTable) -> dict[str, Percentiles]:
    """Return the time of each stage that ran, in ms, over frames."""
    rows = table.frame_rows
    found = {stage.value: percentiles(table.stage_ms[rows, i]) for i, stage in enumerate(Stage)}
    return {name: value for name, value in found.items() if value is not None}


def input_rate_hz(table: FrameTable) -> float | None:
    """Return the rate of the frames' stamps; None when they do not advance."""
    stamps = table.stamp_ns[table.frame_rows]
    if len(stamps) < 2 or stamps.max() == stamps.min():
        return None
    return float((len(stamps) - 1) / ((stamps.max() - stamps.min()) / 1e9))


def percentiles(values: Floats) -> Percentiles | None:
    """Return the distribution of the known (not NaN) values; None when there are none."""
    known = values[~np.isnan(values)]
    if not len(known):
        return None
    p50, p95 = np.percentile(known, (50, 95))
    return Percentiles(len(known), float(known.mean()), float(p50), float(p95), float(known.max()))


def _target_summary(table: FrameTable, index: int) -> TargetSummary:
    rows, errors = table.of_target(index), table.errors
    return TargetSummary(
        name=table.targets[index],
        frames=int(rows.sum()),
        found=int((rows & table.found).sum()),
        status={status.value: int((table.status[rows] == i).sum()) for i, status in enumerate(Status)},
        pose_status={
            status.value: int((table.pose_status[rows] == i).sum())
            for i, status in enumerate(PoseStatus)
            if status is not PoseStatus.NONE
        },
        n_inliers=percentiles(table.n_inliers[rows]),
        rms_px=percentiles(table.rms_px[rows]),
        corner_error_px=None if errors is None else percentiles(errors.corner_px[rows]),
        rotation_error_deg=None if errors is None else percentiles(errors.rotation_deg[rows]),
        translation_error_percent=None if errors is None else percentiles(errors.translation_percent[rows]),
        nees=None if errors is None else percentiles(errors.nees[rows]),
    )
