# SPDX-License-Identifier: Apache-2.0
"""Checks of what a disturbed run left, for `kills.py`: by code of its own, against a run that was left alone."""

from __future__ import annotations

import csv
import json
import os
import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader

from imgu_ros.bags.reading import open_bag
from imgu_ros.errors import ImguError
from imgu_ros.replay.output_folder import check_output_folder
from imgu_ros.replay.recording import simulation_files
from imgu_ros.replay.result_files import replay_contents
from imgu_ros.simulate.sequence import default_targets

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
_SIMULATED = ("poster.png", "params.yaml", "truth.csv", "exposure.csv", "out.mcap", "metadata.yaml")
_HIDDEN = {".imgu_lock", ".imgu_files.json"}


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
        listed = simulation_files(out.with_name("out"), default_targets(1, 0), "mcap")
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
