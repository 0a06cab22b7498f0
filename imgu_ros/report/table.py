# SPDX-License-Identifier: Apache-2.0
"""The frames of a replay as columns of numbers, read back from `frames.csv`; what the summary and the plots work on."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imgu_ros.errors import FileError
from imgu_ros.files.frames_csv import C_COLUMNS, H_COLUMNS, Q_COLUMNS, T_COLUMNS, TIME_COLUMNS, read_rows
from imgu_ros.reasons import reason_kind
from imgu_ros.report.accuracy import RowErrors, TruthComparison, camera_position
from imgu_ros.result import PoseStatus, Stage, Status
from imgu_ros.types import Floats, Indices, Mask

_NAN = float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class FrameTable:
    """R rows of `frames.csv`; NaN where the file has nothing.

    Attributes
    ----------
    stamp_ns : (R,) int64
    targets : the targets' names, in order of appearance
    target : (R,) index into `targets`
    frame : (R,) number of the frame in the file, from 0
    status, pose_status : (R,) index into `list(Status)` and `list(PoseStatus)`
    reason : (R,) index into `reasons`
    reasons : why something is missing, each kind once with the numbers of its first case; the first is empty
    n_keypoints, n_matches, n_inliers, rms_px, ambiguity, confirmed_share : (R,)
    position : (R, 3) of the camera in the target's frame, m
    distance : (R,) from the camera to the target's centre, m
    sigma_t, sigma_r : (R,) square root of the trace of the position's (m) and the rotation's (rad) covariance
    total_ms : (R,)
    stage_ms : (R, number of stages), in the order of `Stage`
    errors : errors against the truth; None without truth
    """

    stamp_ns: Indices
    targets: tuple[str, ...]
    target: Indices
    frame: Indices
    status: Indices
    pose_status: Indices
    reason: Indices
    reasons: tuple[str, ...]
    n_keypoints: Floats
    n_matches: Floats
    n_inliers: Floats
    rms_px: Floats
    ambiguity: Floats
    confirmed_share: Floats
    position: Floats
    distance: Floats
    sigma_t: Floats
    sigma_r: Floats
    total_ms: Floats
    stage_ms: Floats
    errors: ErrorColumns | None

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def seconds(self) -> Floats:
        """Time since the earliest stamp, (R,) s."""
        return (self.stamp_ns - (self.stamp_ns.min() if len(self) else 0)) / 1e9

    @property
    def found(self) -> Mask:
        """Where there is a homography, (R,)."""
        return np.isin(self.status, [i for i, status in enumerate(Status) if status.found])

    def of_target(self, index: int) -> Mask:
        """Return the mask of one target's rows, (R,)."""
        return np.asarray(self.target == index)

    @property
    def frame_rows(self) -> Mask:
        """One row for each frame, (R,): that of the first target; the first one where it is none of its targets."""
        return np.asarray(self.of_target(0) | (np.diff(self.stamp_ns, prepend=self.stamp_ns[:1] - 1) != 0))


@dataclass(frozen=True, slots=True, eq=False)
class ErrorColumns:
    """Errors against the truth, NaN where the truth or the estimate has nothing.

    Attributes
    ----------
    corner_px, rotation_deg, translation_percent : (R,)
    nees : (R,) squared error of the pose in units of its covariance; see `normalised_squared_error`
    true_position : (R, 3) of the camera in the target's frame, m
    """

    corner_px: Floats
    rotation_deg: Floats
    translation_percent: Floats
    nees: Floats
    true_position: Floats


def read_frame_table(path: Path, comparison: TruthComparison | None = None) -> FrameTable:
    """Read a `frames.csv`, and compare every row with the truth when there is one.

    Memory: about 280 bytes a row.

    Raises
    ------
    FileError
        If the file is no frames.csv.
    """
    statuses = {status.value: i for i, status in enumerate(Status)}
    pose_statuses = {status.value: i for i, status in enumerate(PoseStatus)}
    integers: dict[str, array[int]] = {name: array("q") for name in _INTEGERS}
    scalars, errors = array("d"), array("d")
    names: dict[str, int] = {}
    reasons = _Reasons()
    of_frame: set[str] = set()
    for number, row in enumerate(read_rows(path), 1):
        try:
            integers["stamp"].append(int(row["stamp_ns"]))
            integers["status"].append(statuses[row["status"]])
            integers["pose_status"].append(pose_statuses[row["pose_status"]])
            scalars.extend(_scalars(row))
        except (KeyError, ValueError, OverflowError) as error:
            raise FileError(f"{path}: row {number}: {str(error)[:80]}; need what a replay writes") from None
        integers["target"].append(names.setdefault(row["target"], len(names)))
        integers["reason"].append(reasons.number(row["reason"]))
        # Every frame has a row for each target: the second one of the same target is of the next frame.
        stamps, frames = integers["stamp"], integers["frame"]
        is_next = row["target"] in of_frame or (number > 1 and stamps[-1] != stamps[-2])
        frames.append(0 if number == 1 else frames[-1] + is_next)
        if is_next:
            of_frame.clear()
        of_frame.add(row["target"])
        if comparison is not None:
            errors.extend(_error_scalars(comparison, row))
    return _table(integers, scalars, errors if comparison is not None else None, tuple(names), tuple(reasons.texts))


class _Reasons:
    """Numbers reasons; those that differ only in their numbers are one, and what is too many is the last."""

    def __init__(self) -> None:
        self.texts = [""]
        self._numbers = {"": 0}

    def number(self, reason: str) -> int:
        kind = reason_kind(reason)
        if kind not in self._numbers:
            if len(self.texts) > _MOST_REASONS:
                return _MOST_REASONS
            self._numbers[kind] = len(self.texts)
            self.texts.append("other reasons" if len(self.texts) == _MOST_REASONS else reason)
        return self._numbers[kind]


_MOST_REASONS = 100
_INTEGERS = ("stamp", "target", "frame", "status", "pose_status", "reason")
_SIMPLE = ("n_keypoints", "n_matches", "n_inliers", "rms_px", "ambiguity", "confirmed_share")
_N_SCALARS = len(_SIMPLE) + 3 + 1 + 2 + 1 + len(Stage)
_N_ERRORS = 4 + 3


def _table(
    integers: Mapping[str, array[int]],
    scalars: array[float],
    errors: array[float] | None,
    targets: tuple[str, ...],
    reasons: tuple[str, ...],
) -> FrameTable:
    values = np.array(scalars).reshape(-1, _N_SCALARS)
    columns: dict[str, Any] = {name: values[:, i] for i, name in enumerate(_SIMPLE)}
    others = values[:, len(_SIMPLE) :]
    columns["position"], columns["distance"] = others[:, :3], others[:, 3]
    columns["sigma_t"], columns["sigma_r"] = others[:, 4], others[:, 5]
    columns["total_ms"], columns["stage_ms"] = others[:, 6], others[:, 7:]
    return FrameTable(
        stamp_ns=np.array(integers["stamp"], np.int64),
        targets=targets,
        target=np.array(integers["target"], np.intp),
        frame=np.array(integers["frame"], np.intp),
        status=np.array(integers["status"], np.intp),
        pose_status=np.array(integers["pose_status"], np.intp),
        reason=np.array(integers["reason"], np.intp),
        reasons=reasons,
        errors=None if errors is None else _error_columns(np.array(errors).reshape(-1, _N_ERRORS)),
        **columns,
    )


def _error_columns(values: Floats) -> ErrorColumns:
    return ErrorColumns(values[:, 0], values[:, 1], values[:, 2], values[:, 3], values[:, 4:7])


def _scalars(row: Mapping[str, str]) -> list[float]:
    position, distance, sigma_t, sigma_r = [_NAN] * 3, _NAN, _NAN, _NAN
    if row["tx"]:
        pose, covariance = _numbers(row, T_COLUMNS + Q_COLUMNS), _numbers(row, C_COLUMNS).reshape(6, 6)
        position = camera_position(pose).tolist()
        distance = float(np.linalg.norm(pose[:3]))
        sigma_t = float(np.sqrt(np.trace(covariance[:3, :3])))
        sigma_r = float(np.sqrt(np.trace(covariance[3:, 3:])))
    simple = [_number(row[name]) for name in _SIMPLE]
    return [*simple, *position, distance, sigma_t, sigma_r, *(_number(row[name]) for name in TIME_COLUMNS)]


def _error_scalars(comparison: TruthComparison, row: Mapping[str, str]) -> Iterable[float]:
    H = _numbers(row, H_COLUMNS).reshape(3, 3) if row["h11"] else None
    pose = _numbers(row, T_COLUMNS + Q_COLUMNS) if row["tx"] else None
    covariance = _numbers(row, C_COLUMNS).reshape(6, 6) if row["tx"] else None
    errors: RowErrors = comparison.errors(int(row["stamp_ns"]), row["target"], H, pose, covariance)
    known = (errors.corner_px, errors.rotation_deg, errors.translation_percent, errors.nees)
    true_position = [_NAN] * 3 if errors.true_position is None else errors.true_position.tolist()
    return [*(_NAN if value is None else value for value in known), *true_position]


def _numbers(row: Mapping[str, str], columns: tuple[str, ...]) -> Floats:
    return np.array([float(row[name]) for name in columns])


def _number(text: str) -> float:
    return float(text) if text else _NAN
