# SPDX-License-Identifier: Apache-2.0
"""`poses_<target>.tum` and `ambiguous.csv`: the poses of a replay for other tools."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np

from imgu_ros.file_access.atomic_files import LineFile
from imgu_ros.file_access.text_files import csv_line, csv_writer
from imgu_ros.files.frames_csv import C_COLUMNS, Q_COLUMNS, T_COLUMNS
from imgu_ros.result import PoseStatus, Result
from imgu_ros.shown_text import as_cell

AMBIGUOUS_FILE = "ambiguous.csv"
AMBIGUOUS_COLUMNS = ("stamp_ns", "frame_id", "target", "solution", "rms_px", *T_COLUMNS, *Q_COLUMNS, *C_COLUMNS)

_SECOND_NS = 1_000_000_000
#: Trajectories of markers of families that are open at once: a process may have some hundreds of files open.
_MOST_OPEN = 100


class RisingStamps:
    """Tells which poses a trajectory has: those whose stamp is later than that of every pose before, of each target."""

    def __init__(self) -> None:
        self.left_out: dict[str, int] = {}
        self._last_ns: dict[str, int] = {}

    def takes(self, target: str, stamp_ns: int) -> bool:
        """Return whether a target's trajectory has a pose of this stamp; if not, it is counted in `left_out`."""
        if target in self._last_ns and stamp_ns <= self._last_ns[target]:
            self.left_out[target] = self.left_out.get(target, 0) + 1
            return False
        self._last_ns[target] = stamp_ns
        return True


class PoseFiles:
    """Writes a trajectory for each target, and both solutions where two fit; a context manager.

    Those of other targets, ids of a family, begin with their first pose.

    Stamps of a trajectory rise, as every reader of its format expects: see `RisingStamps`.

    Parameters
    ----------
    out : the folder
    targets : names of the targets
    """

    def __init__(self, out: Path, targets: Sequence[str]) -> None:
        self._rising = RisingStamps()
        with ExitStack() as stack:
            self._trajectories = {name: stack.enter_context(LineFile(out / trajectory_file(name))) for name in targets}
            self._out, self._begun = out, set[str]()
            # The one used last is the last.
            self._others: dict[str, LineFile] = {}
            stack.callback(self._close_others)
            self._ambiguous = csv_writer(
                stack.enter_context(LineFile(out / AMBIGUOUS_FILE, csv_line(AMBIGUOUS_COLUMNS)))
            )
            self._stack = stack.pop_all()

    def __enter__(self) -> PoseFiles:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def write(self, result: Result) -> None:
        """Write what `result` says of poses."""
        frame = result.frame
        for target in result:
            if target.pose is not None:
                if not self._rising.takes(target.name, frame.stamp_ns):
                    continue
                numbers = " ".join(repr(float(value)) for value in target.pose.inverse().transform.numbers())
                self._trajectory(target.name).write(f"{seconds_text(frame.stamp_ns)} {numbers}\n")
            elif target.pose_status is PoseStatus.AMBIGUOUS:
                names = (as_cell(frame.frame_id), as_cell(target.name))
                for number, pose in enumerate(target.solutions, 1):
                    values = np.concatenate(([pose.rms_px], pose.transform.numbers(), pose.covariance.ravel()))
                    texts = [repr(float(value)) for value in values]
                    self._ambiguous.writerow([frame.stamp_ns, *names, number, *texts])

    def _trajectory(self, target: str) -> LineFile:
        if target in self._trajectories:
            return self._trajectories[target]
        file = self._others.pop(target, None)
        if file is None:
            if len(self._others) >= _MOST_OPEN:
                self._others.pop(next(iter(self._others))).close()
            file = LineFile(self._out / trajectory_file(target), continues=target in self._begun)
            self._begun.add(target)
        self._others[target] = file
        return file

    def _close_others(self) -> None:
        with ExitStack() as stack:
            for file in self._others.values():
                stack.callback(file.close)


def trajectory_file(target: str) -> str:
    """Return the name of a target's trajectory."""
    return f"poses_{target}.tum"


def seconds_text(stamp_ns: int) -> str:
    """Return a stamp in seconds with all its nine decimals."""
    sign = "-" if stamp_ns < 0 else ""
    seconds, nanoseconds = divmod(abs(stamp_ns), _SECOND_NS)
    return f"{sign}{seconds}.{nanoseconds:09d}"
