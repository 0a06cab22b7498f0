# SPDX-License-Identifier: Apache-2.0
"""Writes a replay's bag and report: the process `python -m imgu_ros.replay.result_writer`, for `ResultProcess` alone.

Reads pickled `Files`, then lists of `ResultItem`, then perhaps `Replayed` from standard input, and at the end writes to
standard output, pickled, the summary, None, or what went wrong. Whatever ends the input, the bag is completed; without
`Replayed` there is no summary, which would say that the replay is complete. Signals that stop the other process are
blocked here: a container or a service manager sends them to both.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import sys
from contextlib import ExitStack
from typing import BinaryIO, NoReturn

from imgu_ros.errors import ImguError
from imgu_ros.replay.reporting import write_summary_and_report
from imgu_ros.replay.result_files import BagFiles
from imgu_ros.replay.result_items import Files, ResultItem
from imgu_ros.replay.statistics import Replayed
from imgu_ros.report.summary import Summary


def main() -> NoReturn:
    """Write what comes, then end the process."""
    # What anybody prints must not come between.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    answer: object
    try:
        answer = serve(sys.stdin.buffer)
    except Exception as error:
        answer = error
    with contextlib.suppress(BrokenPipeError), answers:  # whoever started this may have ended
        answers.write(_pickled(answer))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # everything is written; to take down what draws would take another fifth of a second


def serve(source: BinaryIO) -> Summary | None:
    """Write the results that `source` holds; return the summary when a report was asked for."""
    with ExitStack() as stack:
        opened: BagFiles | None = None
        while True:
            try:
                item = pickle.load(source)
            except (EOFError, pickle.UnpicklingError):  # the end, or the other process was killed
                return None
            if isinstance(item, Files):
                opened = stack.enter_context(BagFiles(item))
            elif isinstance(item, Replayed):
                stack.close()
                return write_summary_and_report(item, () if opened is None else opened.samples.chosen())
            elif opened is not None:
                _write(opened, item)


def _write(files: BagFiles, batch: list[ResultItem]) -> None:
    for written in batch:
        files.write(written)


def _pickled(answer: object) -> bytes:
    try:
        data = pickle.dumps(answer)
        pickle.loads(data)
    except Exception:
        return pickle.dumps(ImguError(f"results: {type(answer).__name__}: {answer}"))
    return data


if __name__ == "__main__":
    main()
