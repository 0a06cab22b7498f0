# SPDX-License-Identifier: Apache-2.0
"""Results written by a thread."""

from __future__ import annotations

from contextlib import ExitStack
from types import TracebackType
from typing import Self

from imgu_ros.replay.background_thread import Background
from imgu_ros.replay.result_files import BagFiles, RowFiles
from imgu_ros.replay.result_items import Files, ResultItem
from imgu_ros.replay.statistics import Replayed
from imgu_ros.report.summary import Summary
from imgu_ros.stop_signals import held


class ResultThread:
    """A `ResultSink` in this process."""

    def __init__(self, files: Files) -> None:
        with ExitStack() as stack:
            self._rows = stack.enter_context(RowFiles(files.folder, files.targets))
            self._bag = stack.enter_context(BagFiles(files))
            self._behind = stack.enter_context(Background(self._write))
            self._stack = stack.pop_all()

    def put(self, written: ResultItem) -> None:
        """Take one frame's result; wait while several have not been written."""
        self._behind.put(written)

    def report(self, replayed: Replayed) -> Summary:
        """Complete the files of the frames, then write summary and report; the last call."""
        # Imported here, for it takes half a second: what draws.
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

    def _write(self, written: ResultItem) -> None:
        self._rows.write(written.result)
        self._bag.write(written)
