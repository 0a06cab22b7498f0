# SPDX-License-Identifier: Apache-2.0
"""All that a replay writes while frames pass: frames.csv, poses, the results bag, and samples for the report."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from imgu_ros.bags.output_folder import RESULTS
from imgu_ros.bags.results_bag import ResultsBag
from imgu_ros.bags.written import Written
from imgu_ros.files.frames_csv import FramesWriter
from imgu_ros.files.pose_files import PoseFiles
from imgu_ros.params import Parameters
from imgu_ros.report.samples import Samples


class ResultFiles:
    """Writes every frame into all files; a context manager, which completes them.

    Parameters
    ----------
    out : the folder, prepared
    parameters : of the replay
    targets : names
    record : outputs to record beside those that always are
    expected : number of frames, as far as it is known

    Attributes
    ----------
    samples : some of the frames, drawn
    """

    def __init__(
        self, out: Path, parameters: Parameters, targets: Sequence[str], record: Sequence[str], expected: int = 0
    ) -> None:
        self.samples = Samples(expected)
        self._frames = 0
        with ExitStack() as stack:
            self._rows = stack.enter_context(FramesWriter(out / "frames.csv"))
            self._poses = stack.enter_context(PoseFiles(out, targets))
            self._messages = stack.enter_context(ResultsBag(out / RESULTS, parameters, targets, record))
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def write(self, written: Written) -> None:
        """Write one frame."""
        self._rows.write(written.result)
        self._poses.write(written.result)
        self._messages.write(written.result, written.time_ns)
        self.samples.offer(self._frames, written.result)
        self._frames += 1
