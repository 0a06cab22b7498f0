# SPDX-License-Identifier: Apache-2.0
"""Fuzz the readers: `python -m fuzz --seconds 60`, `python -m fuzz --recordings 20000 --pictures 5000 --figures FILE`.

A case is made from (kind, seed, index) alone. One that fails is saved in a folder of its own with what it broke, and
`--replay FOLDER` reads it again. Exit code 1 when any failed.
"""

from __future__ import annotations

import argparse
import datetime
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from fuzz.corpus import CORPUS
from fuzz.kinds import KINDS, PICTURE, RECORDING, generated, in_turn, write_case
from fuzz.pool import MOST_MB, MOST_SECONDS, Pool, run_entry
from fuzz.worker import Answer, Request

_DEEP_EVERY = {RECORDING: 100, PICTURE: 5}


@dataclass(slots=True)
class Tally:
    """What came of the cases of one kind."""

    cases: int = 0
    read: int = 0
    refused: int = 0
    limited: int = 0
    messages: int = 0
    whole_commands: int = 0
    most_mb: float = 0.0
    most_seconds: float = 0.0
    failures: Counter[str] = field(default_factory=Counter)

    def add(self, request: Request, answer: Answer) -> None:
        """Count a case."""
        self.cases += 1
        self.read += answer.read
        self.refused += not answer.read
        self.limited += answer.limited
        self.messages += answer.messages
        self.whole_commands += request.deep
        self.most_mb = round(max(self.most_mb, answer.peak_mb), 1)
        self.most_seconds = round(max(self.most_seconds, min(answer.seconds, answer.cpu_seconds)), 3)
        self.failures.update({failure.partition(":")[0] for failure in answer.failures})


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--kind", choices=list(KINDS), action="append", help="only these; default: all")
    parser.add_argument("--count", type=int, default=0, help="cases of each kind")
    parser.add_argument("--recordings", type=int, default=0, help="cases of all kinds of recordings together")
    parser.add_argument("--pictures", type=int, default=0, help="cases of all kinds of pictures together")
    parser.add_argument(
        "--seconds", type=float, default=0.0, help="stop after so long; without a count: all kinds in turn"
    )
    parser.add_argument("--first", type=int, default=0, help="index of the first case")
    parser.add_argument(
        "--seed", type=int, default=int(datetime.date.today().strftime("%Y%m%d")), help="default: the date"
    )
    parser.add_argument("--out", type=Path, default=Path("fuzz-failures"), help="folder for cases that fail")
    parser.add_argument("--figures", type=Path, help="write what came out as JSON")
    parser.add_argument("--corpus", nargs="*", metavar="NAME", help="run the named cases (none named: all)")
    parser.add_argument("--replay", type=Path, metavar="FOLDER", help="read a saved case again, or FILE with --kind")
    arguments = parser.parse_args()
    if arguments.corpus is not None:
        return _corpus(arguments.corpus)
    if arguments.replay:
        return _replayed(arguments.replay, (arguments.kind or [""])[0])
    return _fuzzed(arguments)


def _requests(arguments: argparse.Namespace) -> Iterator[Request]:
    seed, first = arguments.seed, arguments.first
    if arguments.recordings or arguments.pictures:
        for reader, count in ((RECORDING, arguments.recordings), (PICTURE, arguments.pictures)):
            yield from (Request(kind, seed, index) for kind, index in in_turn([reader], first, count))
    elif arguments.count:
        for kind in arguments.kind or KINDS:
            yield from (Request(kind, seed, first + index) for index in range(arguments.count))
    elif arguments.kind:
        yield from (Request(arguments.kind[i % len(arguments.kind)], seed, first + i) for i in range(10**9))
    else:
        yield from (Request(kind, seed, index) for kind, index in in_turn(None, first, 10**9))


def _fuzzed(arguments: argparse.Namespace) -> int:
    start = time.monotonic()
    tallies: dict[str, Tally] = {}
    failed = 0
    print(f"fuzz: seed {arguments.seed}", flush=True)
    with Pool() as pool:
        for number, request in enumerate(_requests(arguments)):
            if arguments.seconds and time.monotonic() - start > arguments.seconds:
                break
            every = _DEEP_EVERY.get(KINDS[request.kind].reader, 0)
            request.deep = bool(every) and number % every == 0
            answer = pool.run(request)
            tallies.setdefault(request.kind, Tally()).add(request, answer)
            if answer.failures:
                failed += 1
                _report(request, answer, arguments.out, pool)
            if number % 1000 == 999:
                print(f"fuzz: {number + 1} cases, {failed} failed, {time.monotonic() - start:.0f} s", flush=True)
    seconds = time.monotonic() - start
    for kind, tally in tallies.items():
        print(
            f"{kind:11} {tally.cases:6} cases, {tally.refused:5} refused, {tally.limited:4} by limits.*, "
            f"{tally.messages:7} messages, at most {tally.most_mb:5.0f} MB and {tally.most_seconds:5.2f} s; "
            f"failed: {dict(tally.failures) or 'none'}"
        )
    print(f"fuzz: {sum(t.cases for t in tallies.values())} cases, {failed} failed, {seconds:.0f} s")
    if arguments.figures:
        _write_figures(arguments.figures, arguments.seed, seconds, tallies)
    return 1 if failed else 0


def _report(request: Request, answer: Answer, out: Path, pool: Pool) -> None:
    """Save a case that failed, with as few mutations as fail alike, and say so."""
    what = {failure.partition(":")[0] for failure in answer.failures}
    for rounds in range(9):
        tried = Request(**{**asdict(request), "rounds": rounds})
        if what & {"time", "crash"}:
            break  # not worth the time
        again = pool.run(tried)
        if what & {failure.partition(":")[0] for failure in again.failures}:
            request, answer = tried, again
            break
    folder = out / f"{request.kind}-{request.seed}-{request.index}"
    folder.mkdir(parents=True, exist_ok=True)
    path = write_case(generated(request.kind, request.seed, request.index, request.rounds), folder)
    (folder / "case.json").write_text(json.dumps({**asdict(request), "path": str(path.relative_to(folder))}))
    (folder / "verdict.txt").write_text("\n".join([*answer.failures, answer.details]))
    for failure in answer.failures:
        print(f"FAILED {failure[:400]}")
    print(f"  again with: python -m fuzz --replay {folder}", flush=True)


def _corpus(names: Sequence[str]) -> int:
    """Run named cases; print what each costs, and what is wrong."""
    failed = 0
    with Pool() as pool:
        for name in names or CORPUS:
            failures, answer = run_entry(pool, name)
            failed += bool(failures)
            print(
                f"{name:36} {answer.seconds:6.2f} s {answer.peak_mb:6.0f} MB  {'read' if answer.read else 'refused'}",
                flush=True,
            )
            for failure in failures:
                print(f"  FAILED {failure[:600]}", flush=True)
    return 1 if failed else 0


def _replayed(path: Path, kind: str) -> int:
    saved = path / "case.json"
    if saved.is_file():
        request = Request(**json.loads(saved.read_text()))
        request.path = str(path / request.path)
    else:
        if not kind:
            raise SystemExit(f"{path}: no case.json in it; need a saved case, or its --kind")
        request = Request(kind, path=str(path), deep=True)
    with Pool() as pool:
        answer = pool.run(request)
    print(json.dumps({k: v for k, v in asdict(answer).items() if k != "details"}, indent=1))
    print(answer.details)
    return 1 if answer.failures else 0


def _write_figures(path: Path, seed: int, seconds: float, tallies: dict[str, Tally]) -> None:
    from imgu_ros.report.versions import versions

    document = {
        "date": datetime.date.today().isoformat(),
        "seed": seed,
        "versions": versions(),
        "seconds": round(seconds),
        "bounds": {"memory_mb": MOST_MB, "seconds": MOST_SECONDS},
        "recordings": sum(t.cases for kind, t in tallies.items() if KINDS[kind].reader == RECORDING),
        "pictures": sum(t.cases for kind, t in tallies.items() if KINDS[kind].reader == PICTURE),
        "most_mb": max((t.most_mb for t in tallies.values()), default=0),
        "most_seconds": max((t.most_seconds for t in tallies.values()), default=0),
        "kinds": {kind: {**asdict(t), "failures": dict(t.failures)} for kind, t in tallies.items()},
    }
    path.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    sys.exit(main())
