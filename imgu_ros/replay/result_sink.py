# SPDX-License-Identifier: Apache-2.0
"""Where a replay's results go: written beside the chain, in a thread or in a process of their own."""

from __future__ import annotations

import os
import sys
from types import TracebackType
from typing import Protocol, Self

from imgu_ros.replay.result_items import Files, ResultItem
from imgu_ros.replay.statistics import Replayed
from imgu_ros.report.summary import Summary

#: A process takes about a second of a processor to start, and saves some milliseconds a frame.
_WORTH_A_PROCESS = 500


class ResultSink(Protocol):
    """Writes results in order, behind the one who puts them.

    A context manager: leaving it completes the files, after an error or an interrupt too. What goes wrong while writing
    is raised by a later call, at the latest on leaving. Rows are in their files when `put` returns, or soon after.
    """

    def put(self, written: ResultItem) -> None:
        """Take one frame's result."""

    def report(self, replayed: Replayed) -> Summary:
        """Complete the files of the frames, then write summary and report; the last call."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def result_sink(files: Files) -> ResultSink:
    """Return what writes the results.

    A process of its own, where that pays: threads hold up each other, as Python runs one of them at a time. With a
    thread where pictures or keypoints are recorded, which would all have to be handed over; the files are the same.
    """
    # In a program that was frozen into one file, that file stands where the interpreter should.
    has_python = bool(sys.executable) and not getattr(sys, "frozen", False)
    if files.expected >= _WORTH_A_PROCESS and not files.record and has_python and _processors() > 1:
        from imgu_ros.replay.result_process import ResultProcess

        try:
            return ResultProcess(files)
        except OSError:  # no room for another process
            pass
    # Imported where it is used, for it takes some tenths of a second: what writes bags.
    from imgu_ros.replay.result_thread import ResultThread

    return ResultThread(files)


def _processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
