# SPDX-License-Identifier: Apache-2.0
"""`frames.csv`: a row for every input frame and target, every number written so that it reads back the same."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from imgu_ros.errors import FileError
from imgu_ros.file_access.atomic_files import LineFile
from imgu_ros.file_access.bounded_reading import file_lines
from imgu_ros.file_access.text_files import csv_line, csv_writer
from imgu_ros.result import ReferenceResult, Result, Stage
from imgu_ros.shown_text import as_cell, cell_text, shown
from imgu_ros.types import Floats

_IDENTITY = ("stamp_ns", "frame_id", "target", "status", "pose_status", "reason")
#: Columns of text; they are written by `as_cell`.
TEXT_COLUMNS = ("frame_id", "target", "reason")
_COUNTS = ("n_keypoints", "n_matches", "n_inliers", "rms_px", "confirmed_share")
H_COLUMNS = tuple(f"h{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
T_COLUMNS = ("tx", "ty", "tz")
Q_COLUMNS = ("qx", "qy", "qz", "qw")
C_COLUMNS = tuple(f"c{row}{column}" for row in range(1, 7) for column in range(1, 7))
TIME_COLUMNS = ("t_total_ms", *(f"t_{stage.value}_ms" for stage in Stage))

#: The columns, in order.
COLUMNS = (*_IDENTITY, *_COUNTS, *H_COLUMNS, *T_COLUMNS, *Q_COLUMNS, *C_COLUMNS, "ambiguity", *TIME_COLUMNS)


class FramesWriter:
    """Writes `frames.csv`, every row at once, so that a process that is killed loses none; a context manager.

    Parameters
    ----------
    path : the file, replaced when it exists
    """

    def __init__(self, path: Path) -> None:
        self._file = LineFile(path, csv_line(COLUMNS))
        self._writer = csv_writer(self._file)

    def __enter__(self) -> FramesWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def write(self, result: Result) -> None:
        """Write one row for each target of `result`."""
        for target in result:
            self._writer.writerow(_row(result, target))


def read_rows(path: Path) -> Iterator[dict[str, str]]:
    """Yield the rows of a `frames.csv`, as text by column, that of `TEXT_COLUMNS` as it was before it was written.

    Raises
    ------
    FileError
        If the file cannot be read or its columns are not those of `COLUMNS`.
    """
    try:
        reader = csv.DictReader(file_lines(path, "a frames.csv"))
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise FileError(f"{path}: columns {list(reader.fieldnames or ())[:4]}...; need those of frames.csv")
        for row in reader:
            if None in row or None in row.values():
                raise FileError(f"{path}:{reader.line_num}: not a cell for each column; need a frames.csv")
            for column in TEXT_COLUMNS:
                row[column] = cell_text(row[column])
            yield row
    except csv.Error as error:
        raise FileError(f"{path}: {error}; need a frames.csv") from None


def _row(result: Result, target: ReferenceResult) -> list[str]:
    matches, estimate, pose = target.matches, target.homography, target.pose
    row = [
        str(result.frame.stamp_ns),
        as_cell(result.frame.frame_id),
        as_cell(target.name),
        target.status.value,
        target.pose_status.value,
        as_cell(shown(target.reason or result.reason)),
        _text(None if result.keypoints is None else len(result.keypoints)),
        _text(None if matches is None else len(matches.matches)),
        _text(None if estimate is None else int(np.count_nonzero(estimate.inliers))),
        _text(None if estimate is None else estimate.rms_px),
        _text(target.confirmed_share),
        *_texts(None if estimate is None else estimate.H, 9),
        *_texts(None if pose is None else pose.transform.numbers(), 7),
        *_texts(None if pose is None else pose.covariance, 36),
        _text(target.ambiguity),
        _milliseconds(result.total_ns or None),
    ]
    times = result.times_ns or {}
    return row + [_milliseconds(times.get(stage)) for stage in Stage]


def _texts(values: Floats | None, count: int) -> list[str]:
    # Python's own floats: numpy's say their type in their repr, and take longer.
    return [""] * count if values is None else list(map(repr, np.asarray(values, np.float64).ravel().tolist()))


def _text(value: Any) -> str:
    """Return the shortest text that reads back as the same number; nothing for what is unknown."""
    if value is None:
        return ""
    return repr(value) if isinstance(value, int) else repr(float(value))


def _milliseconds(duration_ns: int | None) -> str:
    return "" if duration_ns is None else repr(duration_ns / 1e6)
