# SPDX-License-Identifier: Apache-2.0
"""Results written by another process: both ends of the pipe between them. The tables are written by the replay itself.

The other process is `python -m imgu_ros.replay.result_process`. It reads a pickled `ReplayOutput`, then lists of
`ResultItem`, then perhaps a `FinishedReplay` from standard input. At the end it writes one pickled answer to standard
output: the summary, None, or the error. Whatever ends its input, it completes the bag; without `FinishedReplay` it
writes no summary, which would say that the replay is complete.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace
from types import TracebackType
from typing import Any, BinaryIO, NoReturn, Self, cast

import numpy as np

from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.errors import BagError, ImguError
from imgu_ros.image.frame_image import develop
from imgu_ros.replay.background_worker import BackgroundWorker
from imgu_ros.replay.result_files import BagFiles, ReplayOutput, ResultItem, RowFiles
from imgu_ros.replay.statistics import FinishedReplay
from imgu_ros.report.samples import SampleChoice
from imgu_ros.report.summary import Summary
from imgu_ros.result import Result
from imgu_ros.stop_signals import blocked, held
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

#: Number of results in one message to the process.
_BATCH = 16
#: Batches that may wait, about 200 kB each: the process starts while the first frames are processed.
_WAITING = 40
#: Longest time for the process to take a batch, and to complete its files after an error or a signal.
_PATIENCE_S = 60.0

_NO_IMAGE = RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO))
_NOTHING_DEVELOPED = develop(_NO_IMAGE, RawParameters(), DemosaicParameters())


class ResultProcess:
    """A `ResultSink` whose bag and report another process writes.

    A process that hangs is ended after `_PATIENCE_S`, with a BagError; the tables are then complete, and the bag holds
    what was written until then.

    Raises
    ------
    OSError
        If no process can be started.
    FileError
        If a table cannot be written.
    """

    def __init__(self, output: ReplayOutput) -> None:
        self._process = _started(output.folder.lock)
        try:
            self._rows = RowFiles(output.folder, output.targets)
        except BaseException:
            self._end()
            raise
        self._batch: list[ResultItem] = []
        self._choice = SampleChoice(output.expected)
        self._has_answered = False
        self._sender = BackgroundWorker(self._send, _WAITING, _PATIENCE_S)
        self._put(output)

    def put(self, item: ResultItem) -> None:
        """Write the rows of one frame and hand over the rest; wait while many have not been written."""
        self._rows.write(item.result)
        # An image is handed over only when it will be drawn; other results are a few kilobytes.
        result = replace(item.result, pyramid=None, descriptors=None)
        is_drawn = self._choice.is_due(result)
        self._batch.append(ResultItem(result if is_drawn else _without_images(result), item.time_ns))
        if is_drawn or len(self._batch) >= _BATCH:
            self._flush()

    def report(self, replayed: FinishedReplay) -> Summary:
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
            self._answer(_PATIENCE_S)
        except Exception:
            if error is None:
                raise

    def _end(self) -> None:
        """Wait for the process, which ends with its input."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _flush(self) -> None:
        batch, self._batch = self._batch, []
        if batch:
            self._put(batch)

    def _put(self, item: object) -> None:
        try:
            self._sender.put(pickle.dumps(item, pickle.HIGHEST_PROTOCOL))
        except TimeoutError:  # an OSError too
            self._give_up()
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
        except TimeoutError:
            self._give_up()
        except OSError:
            self._answer()

    def _answer(self, patience_s: float | None = None) -> Any:
        """Return what the process said at its end, or raise it; give up when it says nothing for `patience_s`."""
        pipe = self._process.stdout
        assert pipe is not None
        # A signal interrupts this wait for a report.
        if not select.select([pipe], [], [], patience_s)[0]:
            self._give_up()
        self._has_answered = True
        data = pipe.read()
        if not data:
            raise BagError(f"results: the process that writes them ended early, with code {self._process.wait()}")
        answer = pickle.loads(data)
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def _give_up(self) -> NoReturn:
        """End a process that hangs, and say so."""
        self._has_answered = True
        self._process.kill()
        raise BagError(
            f"results: not complete: the process that writes the bag took no data for {_PATIENCE_S:g} s and was ended; "
            "need a disk that can be written"
        )


def main() -> NoReturn:
    """Write what comes from standard input, then end the process."""
    # Output that anybody prints must not come between.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    answer: object
    try:
        answer = serve(sys.stdin.buffer)
    except Exception as error:
        answer = error
    with contextlib.suppress(BrokenPipeError), answers:  # the replay may have ended
        answers.write(_pickled(answer))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # all is written; unloading the drawing library would take another fifth of a second


def serve(source: BinaryIO) -> Summary | None:
    """Write the results that `source` holds; return the summary when a report was asked for."""
    from imgu_ros.replay.reporting import write_summary_and_report

    with ExitStack() as stack:
        opened: BagFiles | None = None
        while True:
            try:
                item = pickle.load(source)
            except (EOFError, pickle.UnpicklingError):  # the end, or the replay was killed
                return None
            if isinstance(item, ReplayOutput):
                opened = stack.enter_context(BagFiles(item))
            elif isinstance(item, FinishedReplay):
                stack.close()
                return write_summary_and_report(item, () if opened is None else opened.samples.chosen())
            elif opened is not None:
                for one in item:
                    opened.write(one)


def _started(lock: int) -> subprocess.Popen[bytes]:
    # The other process must find the modules that this one found.
    paths = os.pathsep.join(path or os.getcwd() for path in sys.path)
    # A signal is for this process alone, which then has the files completed; containers and service managers send them
    # to both.
    with blocked():
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "imgu_ros.replay.result_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            env={**os.environ, "PYTHONPATH": paths},
            process_group=0,
            pass_fds=(lock,),  # the folder is in use until the other has ended too
        )


def _without_images(result: Result) -> Result:
    """Return what the files need of a result; whether it was developed stays known."""
    return replace(
        result,
        frame=replace(result.frame, image=_NO_IMAGE),
        developed=None if result.developed is None else _NOTHING_DEVELOPED,
    )


def _pickled(answer: object) -> bytes:
    try:
        data = pickle.dumps(answer)
        pickle.loads(data)
    except Exception:
        return pickle.dumps(ImguError(f"results: {type(answer).__name__}: {answer}"))
    return data


if __name__ == "__main__":
    main()
