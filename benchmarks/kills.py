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
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.kill_checks import (
    Killed,
    contents,
    is_users,
    look,
    look_again,
    look_at_end,
)
from imgu_ros.bags.compression import zstd
from imgu_ros.file_access.text_files import write_text

KINDS = ("SIGKILL", "SIGKILL to all", "SIGTERM", "SIGTERM to all", "SIGINT", "full disk", "folder removed",
         "folder renamed")  # fmt: skip
_SIGNALS = {"SIGKILL": signal.SIGKILL, "SIGTERM": signal.SIGTERM, "SIGINT": signal.SIGINT}
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


if __name__ == "__main__":
    sys.exit(main())
