# SPDX-License-Identifier: Apache-2.0
"""The process that reads cases, one after the other, and measures each: `python -m fuzz.worker FOLDER`.

It takes a request as a line of JSON and answers with one. Whoever started it ends it when a case takes too long.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

#: Where an allocation fails instead of the machine.
ADDRESS_SPACE_BYTES = 6 * 2**30
#: What `standard_work` takes on the machine that the bounds of time were set on, s.
STANDARD_SECONDS = 0.15


@dataclass(slots=True)
class Request:
    """A case: `kind`, `seed`, `index` and `rounds` to make it, or the `path` of one that is there.

    `deep`: also run the whole command on it.
    """

    kind: str
    seed: int = 0
    index: int = 0
    rounds: int | None = None
    path: str = ""
    deep: bool = False
    corpus: str = ""


@dataclass(slots=True)
class Answer:
    """What came of a case: the verdict, and what it cost in seconds and MB (of the whole process).

    `standard_seconds`: processor time of `standard_work` right after a case that took long, else 0.
    """

    failures: list[str] = field(default_factory=list)
    read: bool = False
    limited: bool = False
    messages: int = 0
    said: list[str] = field(default_factory=list)
    details: str = ""
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    standard_seconds: float = 0.0
    peak_mb: float = 0.0
    base_mb: float = 0.0


def main() -> None:
    """Answer requests until the input ends."""
    folder = Path(sys.argv[1])
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what others print is no answer
    import fuzz.corpus
    import fuzz.harness  # noqa: F401 - not in the first case's time

    answers.write("ready\n")
    for line in sys.stdin:
        answers.write(json.dumps(asdict(answered(Request(**json.loads(line)), folder))) + "\n")


def answered(request: Request, folder: Path) -> Answer:
    """Make, read and measure one case."""
    from fuzz.harness import fuzz_one

    case, scratch = folder / "case", folder / "scratch"
    for place in (case, scratch):
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
    os.environ["TMPDIR"] = str(scratch)
    reader, path = prepared(request, case)
    written = os.fstat(2).st_size
    base_mb = _reset_peak()
    start, cpu = time.monotonic(), time.process_time()
    verdict, complete = fuzz_one(reader, path, request.deep)
    answer = Answer(seconds=time.monotonic() - start, cpu_seconds=time.process_time() - cpu, base_mb=base_mb)
    answer.peak_mb = status_mb("VmHWM")
    if answer.cpu_seconds > 1:
        answer.standard_seconds = standard_work(scratch)
    complete()
    verdict.failures += _on_stderr(written)
    verdict.failures += [f"left behind: {path.name}" for path in scratch.iterdir()]
    return Answer(**{**asdict(answer), **asdict(verdict)})


def standard_work(folder: Path) -> float:
    """Count and write zeros, as hostile files make a reader do; return the processor time, s."""
    start = time.process_time()
    zeros = bytes(2**20)
    with tempfile.TemporaryFile(dir=folder) as file:
        for _ in range(128):
            file.write(zeros)
    count = 0
    for index in range(2_000_000):
        count += index & 1
    return time.process_time() - start


def prepared(request: Request, case: Path) -> tuple[str, Path]:
    """Write the case; return what reads it, and what is to be opened."""
    from fuzz.corpus import CORPUS
    from fuzz.kinds import KINDS, generated, write_case

    if request.corpus:
        entry = CORPUS[request.corpus]
        request.deep = request.deep or entry.deep
        return entry.reader, entry.build(case)
    kind = KINDS[request.kind]
    if request.path:
        return kind.reader, Path(request.path)
    return kind.reader, write_case(generated(request.kind, request.seed, request.index, request.rounds), case)


def status_mb(name: str) -> float:
    """Return a size that the kernel gives of this process, MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) / 1024
    return 0.0


def _reset_peak() -> float:
    """Let VmHWM begin anew; return the present size, MB."""
    Path("/proc/self/clear_refs").write_text("5")
    return status_mb("VmRSS")


def _on_stderr(since: int) -> list[str]:
    """Return what is wrong with what was written to stderr, where that is a file."""
    try:
        with open("/proc/self/fd/2", "rb") as file:
            file.seek(since)
            text = file.read(2**20)
    except OSError:
        return []
    marks: dict[str, Any] = {"escape": b"\x1b", "zero byte": b"\0", "traceback": b"Traceback (most recent"}
    return [f"text: {name} on stderr: {text[:200]!r}" for name, mark in marks.items() if mark in text]


if __name__ == "__main__":
    main()
