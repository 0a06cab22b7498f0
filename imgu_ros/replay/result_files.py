# SPDX-License-Identifier: Apache-2.0
"""The files that a replay writes frame by frame: frames.csv, poses, the results bag; and samples for the report."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from imgu_ros.bags.writing import bag_files, unfinished_bag_files
from imgu_ros.config.components import OutputParameters
from imgu_ros.files.frames_csv import FramesWriter
from imgu_ros.files.pose_files import AMBIGUOUS_FILE, PoseFiles, trajectory_file
from imgu_ros.replay.output_folder import OutputFiles, RunFolder
from imgu_ros.replay.results_bag import ResultsBag
from imgu_ros.report.samples import Samples
from imgu_ros.result import Result

FRAMES, REPORT, SUMMARY = "frames.csv", "report.html", "summary.json"
RESULTS = "results"
#: The results bag while it is written.
_PART = f"{RESULTS}.part"
_UNFINISHED = f"{_PART}/{RESULTS}"


@dataclass(frozen=True, slots=True, eq=False)
class ReplayOutput:
    """What a replay is to write.

    Attributes
    ----------
    folder : where
    parameters : those of the outputs
    targets : names
    record : outputs to record beside those that always are
    expected : number of frames, as far as it is known
    ids : names that ids of families have when they are seen
    """

    folder: RunFolder
    parameters: OutputParameters
    targets: tuple[str, ...]
    record: tuple[str, ...]
    expected: int
    ids: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ResultItem:
    """The result of one frame, and when the bag recorded the frame."""

    result: Result
    time_ns: int


def replay_contents(targets: Sequence[str]) -> OutputFiles:
    """Return what a replay with these targets writes."""
    files = (
        FRAMES,
        AMBIGUOUS_FILE,
        *map(trajectory_file, targets),
        *(f"{RESULTS}/{name}" for name in bag_files(RESULTS)),
        *(f"{_UNFINISHED}/{name}" for name in unfinished_bag_files(RESULTS)),
        REPORT,
        SUMMARY,
    )
    return OutputFiles("replay", files, SUMMARY)


class RowFiles:
    """Writes the tables, each frame immediately: a process that is killed loses none; a context manager.

    Parameters
    ----------
    folder : of the replay
    targets : names
    """

    def __init__(self, folder: RunFolder, targets: Sequence[str]) -> None:
        self._folder = folder
        with ExitStack() as stack:
            self._rows = stack.enter_context(FramesWriter(folder.path / FRAMES))
            self._poses = stack.enter_context(PoseFiles(folder.path, targets))
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def write(self, result: Result) -> None:
        """Write one frame."""
        with self._folder.writing():
            self._rows.write(result)
            self._poses.write(result)


class BagFiles:
    """Writes the results bag, and draws samples; a context manager, which completes the bag and gives it its name.

    A bag that could not be written to the end stays where it was written.

    Attributes
    ----------
    samples : some of the frames, drawn
    """

    def __init__(self, output: ReplayOutput) -> None:
        self.samples = Samples(output.expected)
        self._frames = 0
        self._folder = output.folder
        self._is_whole = True
        unfinished = self._folder.make(_PART) / RESULTS
        self._messages = ResultsBag(unfinished, output.parameters, (*output.targets, *output.ids), output.record)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # The error under way is the one to report.
        with contextlib.nullcontext() if error is None else contextlib.suppress(Exception):
            try:
                self._messages.close()
                if self._is_whole:
                    self._folder.publish((_UNFINISHED, RESULTS))
            finally:
                self._folder.mark_time()

    def write(self, item: ResultItem) -> None:
        """Write one frame."""
        try:
            with self._folder.writing():
                self._messages.write(item.result, item.time_ns)
        except BaseException:
            self._is_whole = False
            raise
        self.samples.offer(self._frames, item.result)
        self._frames += 1
