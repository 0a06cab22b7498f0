# SPDX-License-Identifier: Apache-2.0
"""Runs that are killed at random moments of their lives: no file is corrupt or mixed, and nobody else's is touched.

    python benchmarks/kills.py --runs 100 --out benchmarks/figures/kills.json

Simulates a few short recordings, then starts `imgu replay` and `imgu simulate` again and again, most of them with
`--overwrite` over an earlier run's files and between a user's, and ends each by a signal (to the one process, or to
all, as containers and service managers do), by a full disk, or by taking its folder away. What is left is checked by
code of its own, against runs that were not disturbed. Exits 1 when anything is wrong. Linux only; a disk is full for
root as a small tmpfs, and else by a limit on the size of files.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import pty
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from imgu_ros.bags.compression import zstd
from imgu_ros.bags.reading import open_bag
from imgu_ros.errors import ImguError
from imgu_ros.file_access.text_files import write_text
from imgu_ros.replay.output_folder import check_output_folder
from imgu_ros.replay.recording import _contents
from imgu_ros.replay.result_files import replay_contents
from imgu_ros.simulate.sequence import default_targets

KINDS = ("SIGKILL", "SIGKILL to all", "SIGTERM", "SIGTERM to all", "SIGINT", "full disk", "folder removed",
         "folder renamed")  # fmt: skip
_SIGNALS = {"SIGKILL": signal.SIGKILL, "SIGTERM": signal.SIGTERM, "SIGINT": signal.SIGINT}
_CODES = {
    "SIGKILL": {-9},
    "SIGTERM": {143},
    "SIGINT": {130},
    "full disk": {1},
    "folder removed": {1},
    "folder renamed": {1},
}
_STREAMS = ("frames.csv", "ambiguous.csv", "poses_poster.tum")
_WHOLE = ("report.html", "summary.json")
_SIMULATED = ("poster.png", "params.yaml", "truth.csv", "out.mcap", "metadata.yaml")
_HIDDEN = {".imgu_lock", ".imgu_files.json"}
_REPLAYS = ("replay, two processes", "replay, one process")
_SMALL = ("--size", "160x120")
_RUN = """
import sys
from imgu_ros.cli import main
run = main._run
def with_frames(arguments):
    from imgu_ros.replay import result_sink
    result_sink._MIN_FRAMES_FOR_PROCESS = {}
    return run(arguments)
main._run = with_frames
sys.exit(main.main())
"""
_MARK = "IMGU_KILLED_RUN"


@dataclass(slots=True)
class Killed:
    """One run, and what is wrong with what it left."""

    command: str
    kind: str
    overwrites: bool
    after_s: float
    seconds: float
    code: int | None
    rows: int | None = None
    shown: int = 0
    lost: int = 0
    state: str = ""
    wrong: list[str] = field(default_factory=list)


@dataclass(slots=True)
class Undisturbed:
    """A command, what it leaves when nobody disturbs it, and how long it takes."""

    name: str
    arguments: list[str]
    out: Path
    seconds: float = 0.0


def main() -> int:
    """Run it; return the exit code."""
    # A shell starts what runs in the background with SIGINT ignored, and so would be those that are started here.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="write the figures into this file")
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory(prefix="imgu_kills_") as folder:
        work = Path(folder)
        commands = prepare(work)
        runs = []
        for number in range(arguments.runs):
            kind = KINDS[number % len(KINDS)]
            command = commands[rng.choice(list(commands))]
            run = kill(work / f"run_{number}", command, commands, kind, rng)
            runs.append(run)
            if arguments.out:  # what is measured is kept, whatever happens to the rest
                write_text(arguments.out, json.dumps(summed_up(runs, arguments.seed), indent=1) + "\n")
            told = "; ".join(run.wrong) or "ok"
            print(
                f"{number:3} {run.command:18} {kind:16} {run.after_s:5.1f} s  code {run.code}  {run.state:9} {told}",
                flush=True,
            )
    figures = summed_up(runs, arguments.seed)
    print(json.dumps({name: value for name, value in figures.items() if name != "wrong"}, indent=1))
    return 0 if figures["ok"] else 1


def summed_up(runs: list[Killed], seed: int) -> dict[str, Any]:
    """Return the figures of all runs."""
    return {
        "runs": len(runs),
        "seed": seed,
        "disk": "a small tmpfs" if os.geteuid() == 0 else "a limit on the size of files",
        "commands": Counter(run.command for run in runs),
        "kinds": Counter(run.kind for run in runs),
        "over an earlier run": sum(run.overwrites for run in runs),
        "states": {kind: Counter(run.state for run in runs if run.kind == kind) for kind in KINDS},
        "codes": {kind: Counter(str(run.code) for run in runs if run.kind == kind) for kind in KINDS},
        "rows shown as done that are missing after SIGKILL, most": max(
            (run.lost for run in runs if run.kind.startswith("SIGKILL")), default=0
        ),
        "wrong": [asdict(run) for run in runs if run.wrong],
        "ok": not any(run.wrong for run in runs),
    }


def prepare(work: Path) -> dict[str, Undisturbed]:
    """Simulate the recordings and run every command once undisturbed, and as another, earlier run."""
    commands = {}
    for name, frames, seed in zip(_REPLAYS, (80, 60), (1, 2), strict=True):
        bag = work / "bags" / name.replace(", ", "_")
        imgu(["simulate", "--out", str(bag), "--frames", str(frames), "--seed", str(seed), *_SMALL])
        packed = bag.with_suffix(".mcap.zstd")  # a temporary copy is made of it
        packed.write_bytes(zstd.compress(next(bag.glob("*.mcap")).read_bytes()))
        arguments = [
            "replay",
            str(packed),
            "--params-file",
            str(bag / "params.yaml"),
            "--truth",
            str(bag / "truth.csv"),
        ]
        commands[name] = Undisturbed(name, arguments, work / "undisturbed" / bag.name / "out")
    for name, seed in (("simulate", 4), ("simulate, earlier", 5)):
        arguments = ["simulate", "--frames", "60", "--seed", str(seed), *_SMALL]
        commands[name] = Undisturbed(name, arguments, work / "undisturbed" / name.replace(", ", "_") / "out")
    for command in commands.values():
        begin = time.monotonic()
        imgu([*command.arguments, "--out", str(command.out)])
        command.seconds = time.monotonic() - begin
    return {name: command for name, command in commands.items() if name != "simulate, earlier"}


def imgu(arguments: list[str]) -> None:
    """Run a command that nobody disturbs."""
    subprocess.run(
        [sys.executable, "-m", "imgu_ros.cli.main", *arguments], check=True, capture_output=True, timeout=600
    )


def kill(place: Path, command: Undisturbed, commands: dict[str, Undisturbed], kind: str, rng: random.Random) -> Killed:
    """Start a command, end it at a random moment, and look at what it left."""
    out = place / "out"
    out.mkdir(parents=True)
    earlier = earlier_run(command, commands) if kind != "full disk" and rng.random() < 0.6 else None
    after_s = rng.uniform(0, 1.15 * command.seconds)
    is_full = kind == "full disk"
    is_mounted = is_full and os.geteuid() == 0
    size = sum(path.stat().st_size for path in command.out.rglob("*") if path.is_file())
    limit = int(rng.uniform(0.05, 1.0) * size) + 65536
    try:
        if is_mounted:
            subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={limit}", "imgu", str(out)], check=True, timeout=60)
        if earlier is not None:
            shutil.copytree(earlier, out, dirs_exist_ok=True)
        put_user_files(out, place)
        users = {name: value for name, value in contents(out).items() if is_users(name)}
        outside, before = contents(place / "outside"), contents(out)
        run, text = disturbed(place, out, command, kind, after_s, None if is_mounted or not is_full else limit)
        run.overwrites = earlier is not None
        is_away = (place / "away").exists() or (place / "removed").exists()
        if is_away and out.exists():  # taken away before the run had come to it
            look(run, out, command.out, None, contents(out))
            if run.state != "complete" or ((place / "away").exists() and contents(place / "away") != before):
                run.wrong.append("the folder was made again by a run that had begun")
        elif not (place / "removed").exists():
            out = place / "away" if is_away else out
            found = contents(out)
            if {name: value for name, value in found.items() if is_users(name)} != users:
                run.wrong.append("the user's files changed")
            look(run, out, command.out, earlier, found)
            look_again(run, out)
        if contents(place / "outside") != outside:
            run.wrong.append("files outside changed")
        look_at_end(run, place, text)
        return run
    finally:
        if is_mounted:
            subprocess.run(["umount", str(place / "out")], check=False, timeout=60)
        shutil.rmtree(place)


def earlier_run(command: Undisturbed, commands: dict[str, Undisturbed]) -> Path:
    """Return what another run of the kind left, whose numbers are others."""
    if command.name == "simulate":
        return command.out.parent.parent / "simulate_earlier" / "out"
    return commands[_REPLAYS[command.name == _REPLAYS[0]]].out


def put_user_files(out: Path, place: Path) -> None:
    (place / "outside").mkdir()
    (place / "outside" / "data.csv").write_text("mine")
    for name in ("notes.txt", ".hidden", "poses_groundtruth.tum", "old_frames.csv"):
        (out / name).write_text(f"{name}: mine\n")
    for folder in ("recordings.mcap", "more"):
        (out / folder).mkdir()
        (out / folder / "mine.mcap").write_text("mine")
    (out / "link").symlink_to(place / "outside" / "data.csv")
    (out / "folder_link").symlink_to(place / "outside")
    (out / "nowhere").symlink_to("nothing")


def is_users(name: str) -> bool:
    users = {"notes.txt", ".hidden", "poses_groundtruth.tum", "old_frames.csv", "recordings.mcap", "more", "link"}
    return name.partition("/")[0] in users | {"folder_link", "nowhere"}


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file, folder and link below a folder."""
    found = {}
    for path in folder.rglob("*"):
        link = os.fsencode(os.readlink(path)) if path.is_symlink() else None
        found[str(path.relative_to(folder))] = link or (path.read_bytes() if path.is_file() else b"")
    return found


def disturbed(
    place: Path, out: Path, command: Undisturbed, kind: str, after_s: float, file_limit: int | None
) -> tuple[Killed, str]:
    """Run and disturb; return what became of the process, and what it said."""
    (place / "tmp").mkdir()
    mark = uuid.uuid4().hex
    master, slave = pty.openpty()  # on a terminal progress is told ten times a second

    def limited() -> None:
        if file_limit is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_limit, file_limit))

    # A process of its own writes the results of long recordings; here of short ones.
    frames = 1 if command.name == _REPLAYS[0] else 10**9
    code = _RUN.format(frames)
    begin = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-c", code, *command.arguments, "--out", str(out), "--overwrite"],
        stdout=subprocess.DEVNULL, stderr=slave, stdin=subprocess.DEVNULL, preexec_fn=limited,
        env={**os.environ, "TMPDIR": str(place / "tmp"), _MARK: mark},
    )  # fmt: skip
    os.close(slave)
    said: list[bytes] = []
    reader = threading.Thread(target=read_terminal, args=(master, said))
    reader.start()
    wrong = []
    if kind != "full disk":
        try:
            process.wait(after_s)
        except subprocess.TimeoutExpired:
            disturb(kind, process.pid, place, out, mark)
    try:
        code: int | None = process.wait(120)
    except subprocess.TimeoutExpired:
        code = None
        wrong.append("still runs after two minutes")
        process.kill()
        process.wait()
    seconds = time.monotonic() - begin
    deadline = time.monotonic() + 60
    while (left := processes(mark)) and time.monotonic() < deadline:
        time.sleep(0.05)
    for pid in left:
        wrong.append("a process is left")
        os.kill(pid, signal.SIGKILL)
    reader.join(timeout=30)
    text = b"".join(said).decode("utf-8", "replace")
    counts = re.findall(r"(?:replay|simulate): +\d+%\|[^|]*\| (\d+)/\d+", text)
    run = Killed(command.name, kind, False, round(after_s, 2), round(seconds, 2), code, wrong=wrong)
    run.shown = int(counts[-1]) if counts else 0
    return run, text


def read_terminal(master: int, said: list[bytes]) -> None:
    try:
        while data := os.read(master, 65536):
            said.append(data)
    except OSError:  # all who wrote have ended
        pass
    os.close(master)


def disturb(kind: str, pid: int, place: Path, out: Path, mark: str) -> None:
    name = kind.partition(" ")[0]
    if kind == "folder renamed":
        out.rename(place / "away")
    elif kind == "folder removed":
        out.rename(place / "removed")
        shutil.rmtree(place / "removed", ignore_errors=True)
        (place / "removed").mkdir(exist_ok=True)
    else:
        for one in processes(mark) if kind.endswith("to all") else [pid]:
            try:
                os.kill(one, _SIGNALS[name])
            except ProcessLookupError:
                continue


def processes(mark: str) -> list[int]:
    """Return the processes that the run has started, itself among them."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                if f"{_MARK}={mark}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                    found.append(int(folder.name))
            except OSError:
                continue
    return found


def look(run: Killed, out: Path, reference: Path, earlier: Path | None, found: dict[str, bytes]) -> None:
    """Check every file that is no user's: of one run, whole, and as far as it goes that of a run left alone."""
    names = (*_STREAMS, *_WHOLE) if run.command.startswith("replay") else _SIMULATED
    mark = "summary.json" if run.command.startswith("replay") else "metadata.yaml"
    bag = out / "results" if run.command.startswith("replay") else out
    old = {} if earlier is None else {name: value for name, value in contents(earlier).items() if not is_users(name)}
    ours = {name for name in found if not is_users(name) and name not in _HIDDEN}
    from_before = {name for name in ours if name in old and found[name] == old[name] and (out / name).is_file()}
    files = {name for name in ours if (out / name).is_file()}
    complete = mark in files
    same = {name for name in files if (reference / name).is_file() and found[name] == (reference / name).read_bytes()}
    if from_before and from_before - same:
        run.state = "earlier" if complete else "clearing"
        if files - from_before:
            run.wrong.append(f"mixed: {sorted(files - from_before)} beside an earlier run's files")
        if complete and files != {
            name for name in old if name not in _HIDDEN and (earlier or out).joinpath(name).is_file()
        }:
            run.wrong.append("an earlier run's mark beside only a part of its files")
        return
    run.state = "complete" if complete else "partial" if files else "nothing"
    beside = {name for name in ours if ".part" in name}
    for name in sorted(ours - beside):
        if name.partition("/")[0] not in (*names, "results"):
            run.wrong.append(f"unknown file {name}")
    if run.command.startswith("replay"):
        run.rows = check_replay(run, out, reference, files, complete)
    else:
        for name in sorted(files - beside - same):
            if name not in ("truth.csv", "params.yaml", "metadata.yaml"):  # these name the folder, or come last
                run.wrong.append(f"{name}: other bytes than undisturbed")
        if "truth.csv" in files and "truth.csv" not in same:
            run.wrong.append("truth.csv: other bytes than undisturbed")
    if complete:
        missing = {*names, *(() if run.command == "simulate" else ("results/metadata.yaml",))} - files
        if missing or beside:
            run.wrong.append(f"complete without {sorted(missing)}, with {sorted(beside)}")
    if (bag / "metadata.yaml").is_file():
        check_bag(run, bag, reference / "results" if bag != out else reference, complete)
    is_stop = run.code in (130, 143)
    if is_stop and beside and run.command.startswith("replay"):
        run.wrong.append(f"left {sorted(beside)}")
    if is_stop and run.rows and not (bag / "metadata.yaml").is_file():
        run.wrong.append("stopped without a results bag")
    for name in sorted(beside):
        if name.endswith(".mcap") and found[name]:
            read_as_far_as_it_goes(run, out / name)


def check_replay(run: Killed, out: Path, reference: Path, files: set[str], complete: bool) -> int | None:
    rows = None
    for name in sorted(files & set(_STREAMS)):
        text, whole = (out / name).read_text(), (reference / name).read_text()
        if text and not text.endswith("\n"):
            run.wrong.append(f"{name}: ends within a line")
        given, wanted = untimed(text), untimed(whole)
        if given != wanted[: len(given)] or (complete and len(given) != len(wanted)):
            run.wrong.append(f"{name}: not the first lines of an undisturbed run's")
        if name == "frames.csv":
            rows = len(given) - 1
            run.lost = max(0, run.shown - rows)
            if run.lost > 8:  # a thread holds at most five frames
                run.wrong.append(f"{run.shown} frames shown as done, {rows} rows")
    if complete:
        try:
            if stable(json.loads((out / "summary.json").read_text())) != stable(
                json.loads((reference / "summary.json").read_text())
            ):
                run.wrong.append("summary.json: not as undisturbed")
        except ValueError as error:
            run.wrong.append(f"summary.json: {error}")
    if "report.html" in files and not (out / "report.html").read_text().rstrip().endswith("</html>"):
        run.wrong.append("report.html: not whole")
    return rows


def untimed(text: str) -> list[list[str]]:
    """Return the cells, without those of times."""
    rows = list(csv.reader(text.splitlines()))
    head = rows[0] if rows else []
    kept = [index for index, name in enumerate(head) if not name.startswith("t_")] if "stamp_ns" in head else None
    if kept is None:
        return rows
    return [[row[index] for index in kept] if len(row) == len(head) else row for row in rows]


def stable(summary: dict[str, Any]) -> dict[str, Any]:
    """Return what of a summary is the same whenever it runs."""
    return {k: v for k, v in summary.items() if k not in ("frames_per_s", "seconds", "total_ms", "stage_ms")}


def messages(bag: Path) -> list[tuple[str, int, bytes]]:
    with Reader(bag) as reader:
        # What `status` says of times differs.
        return [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages() if c.topic != "/status"]


def check_bag(run: Killed, bag: Path, reference: Path, complete: bool) -> None:
    try:
        given, wanted = messages(bag), messages(reference)
    except Exception as error:
        run.wrong.append(f"{bag.name}: rosbags cannot read it: {error}")
        return
    if given != wanted[: len(given)] or (complete and len(given) != len(wanted)):
        run.wrong.append(f"{bag.name}: not the first messages of an undisturbed run's")
    if run.rows is not None and run.code in (130, 143) and len({stamp for _, stamp, _ in given}) > run.rows:
        run.wrong.append(f"{bag.name}: more frames than rows")


def read_as_far_as_it_goes(run: Killed, path: Path) -> None:
    try:
        with open_bag([path]) as bag:
            for _ in bag.raw_messages():
                pass
    except ImguError as error:
        if path.stat().st_size > 100_000:  # before the first chunk there is nothing to be read
            run.wrong.append(f"{path.name}: {error}")


def look_again(run: Killed, out: Path) -> None:
    """The next run with --overwrite must be able to clear what is left."""
    listed = replay_contents(["poster"])
    if run.command == "simulate":
        listed = _contents(out.with_name("out"), default_targets(1, 0), "mcap")
    try:
        check_output_folder(out, listed, overwrite=True)
    except ImguError as error:
        run.wrong.append(f"cannot be overwritten: {error}")


def look_at_end(run: Killed, place: Path, text: str) -> None:
    """Check exit code, last line and temporary copies."""
    last = text.replace("\r", "\n").split("\n")
    last_line = next((line for line in reversed(last) if line.strip()), "").removeprefix("\x1b[A")
    kind = run.kind.removesuffix(" to all")
    # Else the interpreter had not come to the command yet, or had done with it.
    has_begun = run.code not in (-signal.SIGINT, -signal.SIGTERM) and "init_import_site" not in text
    if run.code != 0 and has_begun and run.code not in _CODES[kind]:
        run.wrong.append(f"exit code {run.code}")
    if not has_begun and run.state not in ("nothing", "earlier", "complete"):  # complete: it had ended
        run.wrong.append(f"exit code {run.code} of a run that had begun")
    if has_begun and ("Traceback" in text or "Exception ignored" in text):
        # The last line alone: the others name folders of this machine.
        run.wrong.append(f"traceback: {text.strip().splitlines()[-1][:300]}")
    expected = {130: "imgu: interrupted", 143: "imgu: terminated", 1: "imgu: error: "}.get(run.code or 0, "")
    if has_begun and not last_line.startswith(expected):
        run.wrong.append(f"last line {last_line!r}")
    left = [path.name for path in (place / "tmp").iterdir()]
    if left and kind != "SIGKILL":
        run.wrong.append(f"temporary copies are left: {left}")


if __name__ == "__main__":
    sys.exit(main())
