# SPDX-License-Identifier: Apache-2.0
"""Results written by a thread."""

from __future__ import annotations

from contextlib import ExitStack
from types import TracebackType
from typing import Self

from imgu_ros.bags.background import Background
from imgu_ros.bags.passed import Replayed
from imgu_ros.bags.result_files import ResultFiles
from imgu_ros.bags.written import Files, Written
from imgu_ros.report.samples import Sample
from imgu_ros.report.summary import Summary


class ResultThread:
    """A `ResultSink` in this process."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._behind: Background[Written] | None = None
        self._files: ResultFiles | None = None
        self._samples: tuple[Sample, ...] = ()

    def open(self, files: Files) -> None:
        """Begin; the first call."""
        self._files = self._stack.enter_context(
            ResultFiles(files.out, files.parameters, files.targets, files.record, files.expected)
        )
        self._behind = self._stack.enter_context(Background(self._files.write))

    def put(self, written: Written) -> None:
        """Take one frame's result; wait while several have not been written."""
        assert self._behind is not None
        self._behind.put(written)

    def report(self, replayed: Replayed) -> Summary:
        """Complete the files of the frames, then write summary and report; the last call."""
        # Imported here, for it takes half a second: what draws.
        from imgu_ros.bags.reporting import write_summary_and_report

        self._stack.close()
        assert self._files is not None
        samples = self._files.samples.chosen()
        self._files = None
        return write_summary_and_report(replayed, samples)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)
