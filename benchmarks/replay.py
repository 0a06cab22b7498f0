# SPDX-License-Identifier: Apache-2.0
"""Measure `imgu replay`: the whole command over a long bag, its speed and its memory.

    python benchmarks/replay.py --size 1920x1080 --frames 3000 --dir /some/disk --out replay.json

Writes a simulated Bayer bag first (a motion that is repeated with new stamps; 2 MB a frame at 1920x1080), runs the
command as a process of its own, start-up, results bag and report included, and removes the bag. Prints as JSON: frames
a second over the whole command, its CPU time, its peak of resident memory, and how flat its memory is: the median of
resident less shared memory over the last 5 % of the frames, minus that over the 10th to the 15th %. The command's
processes count together; of the peak, pages that they share count twice.
"""

from __future__ import annotations

import argparse
import compileall
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from live import write_bag

import imgu_ros

_SAMPLE_S = 0.2
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Figures:
    """What was measured; memory in MB of 10^6 bytes."""

    size: str
    frames: int
    motion_frames: int
    found: int
    seconds: float
    frames_per_s: float
    frames_per_s_without_start_and_report: float
    cpu_s: float
    peak_rss_mb: float
    own_mb_early: float
    own_mb_late: float
    growth_mb: float
    cpu_count: int
    load_average_before: float


@dataclass(frozen=True)
class _Run:
    """One run of the command; `samples`: (bytes of frames.csv, bytes of own memory) over time."""

    seconds: float
    cpu_s: float
    peak_rss_mb: float
    samples: np.ndarray


def main() -> int:
    """Measure and print."""
    arguments = _arguments()
    width, height = (int(part) for part in arguments.size.split("x"))
    with tempfile.TemporaryDirectory(prefix="imgu_replay_", dir=arguments.dir) as name:
        folder = Path(name)
        write_bag(folder, (width, height), arguments.rate, arguments.frames, arguments.motion_frames)
        os.sync()  # what is still to be written to the disk would hold up those who read from it
        load = os.getloadavg()[0]
        run = _timed(folder, folder / "out", arguments.parameters)
        summary = json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))
    early, late = _own_mb(run.samples, 0.10, 0.15), _own_mb(run.samples, 0.95, 1.0)
    figures = Figures(
        size=arguments.size,
        frames=summary["frames"],
        motion_frames=arguments.motion_frames,
        found=summary["targets"][0]["found"],
        seconds=round(run.seconds, 2),
        frames_per_s=round(summary["frames"] / run.seconds, 1),
        frames_per_s_without_start_and_report=round(summary["frames_per_s"], 1),
        cpu_s=round(run.cpu_s, 2),
        peak_rss_mb=round(run.peak_rss_mb, 1),
        own_mb_early=round(early, 2),
        own_mb_late=round(late, 2),
        growth_mb=round(late - early, 2),
        cpu_count=os.cpu_count() or 0,
        load_average_before=round(load, 2),
    )
    text = json.dumps(asdict(figures), indent=2)
    print(text)
    if arguments.out:
        arguments.out.write_text(text + "\n", encoding="utf-8")
    return 0


def _timed(folder: Path, out: Path, parameters: list[str]) -> _Run:
    """Run the command and watch it."""
    compileall.compile_dir(Path(imgu_ros.__file__).parent, quiet=1)  # as pip does, whatever the environment says
    targets = ["-p", f"targets.images:=[{folder / 'poster.png'}]", "-p", "targets.widths_m:=[0.5]"]
    more = [part for value in parameters for part in ("-p", value)]
    imgu = [sys.executable, "-m", "imgu_ros.cli.main"]
    started = time.monotonic()
    process = subprocess.Popen(
        [*imgu, "replay", str(folder / "bag"), "--out", str(out), *targets, *more], stdout=subprocess.DEVNULL
    )
    samples: list[tuple[int, int]] = []
    peak_kib = 0
    due = started
    while True:
        ended, status, usage = os.wait4(process.pid, os.WNOHANG)
        if ended:
            seconds = time.monotonic() - started
            break
        if time.monotonic() >= due:
            due += _SAMPLE_S
            family = _family(process.pid)
            samples.append((_bytes(out / "frames.csv"), sum(map(_own_bytes, family))))
            peak_kib = max(peak_kib, sum(map(_peak_kib, family)))
        time.sleep(0.005)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"imgu replay: exit code {process.returncode}")
    # What was sampled after the last frame belongs to the report.
    final = _bytes(out / "frames.csv")
    samples = [sample for sample in samples if sample[0] < final]
    kept = np.array(samples, float).reshape(-1, 2)
    kept[:, 0] /= final
    return _Run(seconds, usage.ru_utime + usage.ru_stime, peak_kib * 1024 / 1e6, kept)


def _own_mb(samples: np.ndarray, first: float, last: float) -> float:
    """Return the median of the own memory while that share of the frames passed."""
    inside = samples[(samples[:, 0] >= first) & (samples[:, 0] <= last), 1]
    return float(np.median(inside)) / 1e6 if len(inside) else float("nan")


def _bytes(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def _family(pid: int) -> list[int]:
    """Return the process and those that it started."""
    try:
        threads = list(Path(f"/proc/{pid}/task").iterdir())
        children = [int(child) for thread in threads for child in (thread / "children").read_text().split()]
    except OSError:
        return [pid]
    return [pid, *(found for child in children for found in _family(child))]


def _peak_kib(pid: int) -> int:
    """Return the most that was resident so far; what the kernel tells at the end counts this process's memory too."""
    try:
        text = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    except OSError:
        return 0
    return int(text.partition("VmHWM:")[2].split()[0]) if "VmHWM:" in text else 0


def _own_bytes(pid: int) -> int:
    """Return the resident memory less what is shared, as files that are mapped are."""
    try:
        pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()
    except OSError:
        return 0
    return (int(pages[1]) - int(pages[2])) * _PAGE


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="1920x1080", metavar="WxH")
    parser.add_argument("--frames", type=int, default=3000, metavar="N")
    parser.add_argument("--rate", type=float, default=30.0, metavar="HZ", help="of the stamps")
    parser.add_argument("--motion-frames", type=int, default=120, metavar="N", help="frames of the motion")
    parser.add_argument("--dir", type=Path, metavar="DIR", help="folder for the bag and the results")
    parser.add_argument(
        "-p", dest="parameters", action="append", default=[], metavar="NAME:=VALUE", help="parameter of the replay"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the JSON there too")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
