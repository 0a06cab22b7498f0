# SPDX-License-Identifier: Apache-2.0
"""Results written by another process, `imgu_ros.replay.result_writer`; the rows by this one, at once."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import replace
from types import TracebackType
from typing import Any, Self, cast

import numpy as np

from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.errors import BagError
from imgu_ros.image.development import develop
from imgu_ros.replay.background_thread import Background
from imgu_ros.replay.result_files import RowFiles
from imgu_ros.replay.result_items import Files, ResultItem
from imgu_ros.replay.statistics import Replayed
from imgu_ros.report.samples import SampleChoice
from imgu_ros.report.summary import Summary
from imgu_ros.result import Result
from imgu_ros.stop_signals import blocked, held
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

#: Results that are handed over at once.
_BATCH = 16
#: Batches that may wait, some 200 kB each: the process starts while the first frames pass.
_WAITING = 40

_NO_PICTURE = RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO))
_NOTHING_TO_SEE = develop(_NO_PICTURE, RawParameters(), DemosaicParameters())


class ResultProcess:
    """A `ResultSink` whose bag and report a process of their own writes.

    Raises
    ------
    OSError
        If no process can be started.
    FileError
        If a table cannot be written.
    """

    def __init__(self, files: Files) -> None:
        self._process = _started(files.folder.lock)
        try:
            self._rows = RowFiles(files.folder, files.targets)
        except BaseException:
            self._end()
            raise
        self._batch: list[ResultItem] = []
        self._choice = SampleChoice(files.expected)
        self._has_answered = False
        self._sender = Background(self._send, limit=_WAITING)
        self._put(files)

    def put(self, written: ResultItem) -> None:
        """Write one frame's rows and hand over the rest; wait while many have not been written."""
        self._rows.write(written.result)
        # A picture is handed over when it will be drawn; other results are a few kilobytes.
        result = replace(written.result, pyramid=None, descriptors=None)
        is_drawn = self._choice.is_due(result)
        self._batch.append(ResultItem(result if is_drawn else _without_pictures(result), written.time_ns))
        if is_drawn or len(self._batch) >= _BATCH:
            self._flush()

    def report(self, replayed: Replayed) -> Summary:
        """Complete the files of the frames, then write summary and report; the last call."""
        with held():
            self._rows.__exit__(None, None, None)
            self._flush()
            self._put(replayed)
            self._end_sending()
        return cast("Summary", self._answer())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._rows.__exit__(kind, error, trace)
            if not self._has_answered:
                self._complete(error)
        finally:
            self._end()

    def _complete(self, error: BaseException | None) -> None:
        """Have the files completed, without a report; `error`, when there is one, is the one to raise."""
        try:
            self._flush()
            self._end_sending()
            self._answer()
        except Exception:
            if error is None:
                raise

    def _end(self) -> None:
        """Wait for the process, which ends with its input."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._process.wait()

    def _flush(self) -> None:
        batch, self._batch = self._batch, []
        if batch:
            self._put(batch)

    def _put(self, item: object) -> None:
        try:
            self._sender.put(pickle.dumps(item, pickle.HIGHEST_PROTOCOL))
        except OSError:  # it has ended: its answer says why
            self._answer()

    def _send(self, data: bytes) -> None:
        pipe = self._process.stdin
        assert pipe is not None
        view = memoryview(data)
        while view:
            view = view[pipe.write(view) :]

    def _end_sending(self) -> None:
        assert self._process.stdin is not None
        try:
            self._sender.__exit__(None, None, None)
            self._process.stdin.close()
        except OSError:
            self._answer()

    def _answer(self) -> Any:
        """Return what the process said at its end, or raise it."""
        self._has_answered = True
        assert self._process.stdout is not None
        data = self._process.stdout.read()
        if not data:
            raise BagError(f"results: the process that writes them ended early, with code {self._process.wait()}")
        answer = pickle.loads(data)
        if isinstance(answer, BaseException):
            raise answer
        return answer


def _started(lock: int) -> subprocess.Popen[bytes]:
    # What this process imports, the other must find.
    paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
    # A signal is for this process alone, which then has the files completed.
    with blocked():
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "imgu_ros.replay.result_writer"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            env={**os.environ, "PYTHONPATH": paths},
            process_group=0,
            pass_fds=(lock,),  # the folder is in use until the other has ended too
        )


def _without_pictures(result: Result) -> Result:
    """Return what the files need of a result; that it was developed remains to be seen."""
    return replace(
        result,
        frame=replace(result.frame, image=_NO_PICTURE),
        developed=None if result.developed is None else _NOTHING_TO_SEE,
    )
