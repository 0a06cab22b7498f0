# SPDX-License-Identifier: Apache-2.0
"""Write the results of a replay beside the pipeline, in a thread or in a process of their own."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from types import TracebackType
from typing import Protocol, Self

from imgu_ros.replay.background_worker import BackgroundWorker
from imgu_ros.replay.result_files import BagFiles, ReplayOutput, ResultItem, RowFiles
from imgu_ros.replay.statistics import FinishedReplay
from imgu_ros.report.summary import Summary
from imgu_ros.stop_signals import held

#: Starting a process takes about a second of processor time; it saves some milliseconds per frame.
_MIN_FRAMES_FOR_PROCESS = 500


class ResultSink(Protocol):
    """Writes results in order, while the pipeline goes on.

    A context manager: leaving it completes the files, after an error or an interrupt too. An error while writing is
    raised by a later call, at the latest on leaving. Rows are in their files when `put` returns, or soon after.
    """

    def put(self, item: ResultItem) -> None:
        """Take the result of one frame."""

    def report(self, replayed: FinishedReplay) -> Summary:
        """Complete the files of the frames, then write summary and report; the last call."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def result_sink(output: ReplayOutput) -> ResultSink:
    """Return what writes the results: the files are the same whichever it is.

    A process of its own where that pays, because Python runs one thread at a time. A thread where images or keypoints
    are recorded, all of which would have to be sent to the process.
    """
    # In a program that was frozen into one file, `sys.executable` is that file and not the interpreter.
    has_python = bool(sys.executable) and not getattr(sys, "frozen", False)
    if output.expected >= _MIN_FRAMES_FOR_PROCESS and not output.record and has_python and _processors() > 1:
        from imgu_ros.replay.result_process import ResultProcess

        try:
            return ResultProcess(output)
        except OSError:  # no room for another process
            pass
    return ResultThread(output)


class ResultThread:
    """A `ResultSink` in this process."""

    def __init__(self, output: ReplayOutput) -> None:
        with ExitStack() as stack:
            self._rows = stack.enter_context(RowFiles(output.folder, output.targets))
            self._bag = stack.enter_context(BagFiles(output))
            self._worker = stack.enter_context(BackgroundWorker(self._write))
            self._stack = stack.pop_all()

    def put(self, item: ResultItem) -> None:
        """Take the result of one frame; wait while several have not been written."""
        self._worker.put(item)

    def report(self, replayed: FinishedReplay) -> Summary:
        """Complete the files of the frames, then write summary and report; the last call."""
        # Drawing takes half a second to import.
        from imgu_ros.replay.reporting import write_summary_and_report

        with held():
            self._stack.close()
        return write_summary_and_report(replayed, self._bag.samples.chosen())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _write(self, item: ResultItem) -> None:
        self._rows.write(item.result)
        self._bag.write(item)


def _processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
