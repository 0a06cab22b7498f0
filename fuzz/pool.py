# SPDX-License-Identifier: Apache-2.0
"""Run cases in a process that may hang or die, and hold them to the bounds."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self

from fuzz.corpus import CORPUS
from fuzz.worker import STANDARD_SECONDS, Answer, Request

REPOSITORY = Path(__file__).resolve().parent.parent
MOST_MB = 1500.0
MOST_SECONDS = 10.0  # on a machine that does `standard_work` in STANDARD_SECONDS; more on a slower one, in proportion
_SLOWEST = 4.0  # times; a slower machine is not waited for
#: On a machine with other work, time counts once the process itself had as much; this ends one that waits.
_HANG_SECONDS = 45.0
_MAKING_SECONDS = 15.0  # what making the case and the scan may take beside
_CASES_A_PROCESS = 1000
_MOST_BASE_MB = 400


class Pool:
    """One worker process, started anew when a case ends it; a context manager.

    Parameters
    ----------
    prepare : Python that the worker runs first, for tests
    """

    def __init__(self, prepare: str = "") -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="imgu_fuzz_", dir=_fast_folder())
        self._prepare = prepare
        self._worker: subprocess.Popen[bytes] | None = None
        self._done = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._end()
        self._folder.cleanup()

    @property
    def folder(self) -> Path:
        """Where the worker writes."""
        return Path(self._folder.name)

    def run(self, request: Request) -> Answer:
        """Run one case; what ends the process is a failure like others."""
        if self._done >= _CASES_A_PROCESS:
            self._end()
        worker = self._worker or self._start()
        assert worker.stdin and worker.stdout
        self._done += 1
        start, cpu = time.monotonic(), _cpu_seconds(worker.pid)
        try:
            worker.stdin.write(json.dumps(asdict(request)).encode() + b"\n")
            worker.stdin.flush()
        except BrokenPipeError:
            return self._ended(start)
        while not select.select([worker.stdout], [], [], 0.5)[0]:
            passed, used = time.monotonic() - start, _cpu_seconds(worker.pid) - cpu
            waits = passed > _HANG_SECONDS and used < 1
            if waits or passed > 4 * _HANG_SECONDS or used > _SLOWEST * MOST_SECONDS + _MAKING_SECONDS:
                self._end()
                return Answer([f"time: ended after {passed:.0f} s ({used:.0f} s of a processor)"], seconds=passed)
        line = worker.stdout.readline()
        if not line:
            return self._ended(start)
        answer = Answer(**json.loads(line))
        if answer.peak_mb > MOST_MB:
            answer.failures.append(f"memory: {answer.peak_mb:.0f} MB; need at most {MOST_MB:.0f}")
        most = MOST_SECONDS * min(max(answer.standard_seconds / STANDARD_SECONDS, 1.0), _SLOWEST)
        if min(answer.seconds, answer.cpu_seconds) > most:
            answer.failures.append(f"time: {answer.seconds:.1f} s; need at most {most:.0f}")
        if answer.peak_mb > MOST_MB or answer.base_mb > _MOST_BASE_MB:
            self._end()  # what it left in memory is not the next one's
        return answer

    def _start(self) -> subprocess.Popen[bytes]:
        single = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}
        environment = {**os.environ, **single, "OPENCV_LOG_LEVEL": "ERROR", "PYTHONPATH": str(REPOSITORY)}
        program = f"{self._prepare}\nfrom fuzz.worker import main\nmain()\n"
        with (self.folder / "stderr").open("wb") as errors:
            self._worker = subprocess.Popen(
                [sys.executable, "-c", program, str(self.folder)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, env=environment,
            )  # fmt: skip
        self._done = 0
        assert self._worker.stdout
        self._worker.stdout.readline()
        return self._worker

    def _ended(self, start: float) -> Answer:
        """Return the verdict on a case that ended the process."""
        assert self._worker
        code = self._worker.wait()
        said = (self.folder / "stderr").read_bytes()[-2000:].decode(errors="replace")
        self._end()
        return Answer([f"crash: the process ended with {code}"], details=said, seconds=time.monotonic() - start)

    def _end(self) -> None:
        if self._worker is not None:
            self._worker.kill()
            self._worker.wait()
            for pipe in (self._worker.stdin, self._worker.stdout):
                if pipe is not None:
                    pipe.close()
            self._worker = None


def run_entry(pool: Pool, name: str) -> tuple[list[str], Answer]:
    """Run a named case; return what is wrong with it, and what it cost."""
    entry = CORPUS[name]
    answer = pool.run(Request("", corpus=name))
    failures = list(answer.failures)
    if entry.is_read is not None and entry.is_read != answer.read:
        failures.append(f"need it to be {'read' if entry.is_read else 'refused'}; said: {answer.said}")
    if answer.messages < entry.messages:
        failures.append(f"{answer.messages} messages; need {entry.messages}; said: {answer.said}")
    if entry.says not in " ".join(answer.said):
        failures.append(f"need {entry.says!r} in what is said: {answer.said}")
    return failures, answer


def _fast_folder() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def _cpu_seconds(pid: int) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
