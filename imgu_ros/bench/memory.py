"""How much memory a method takes: in a process that does nothing else, and over many frames."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from imgu_ros.errors import FileError, ImguError

_STATUS = Path("/proc/self/status")
_FRAMES = 4
_LIMIT_S = 300


@dataclass(frozen=True, slots=True)
class PeakMemory:
    """Peak of the resident size of a process with one method: all of it, and over what it had before the frames, MB."""

    method: str
    size: str
    peak_mb: float
    over_start_mb: float


def peak_memory(method: str, width: int, height: int) -> PeakMemory:
    """Measure one method in a process of its own.

    Parameters
    ----------
    method : a name in `lineup.METHODS`
    width, height : of the frames, px

    Raises
    ------
    FileError
        If the process cannot be measured: the system has no /proc, or the process ended badly.
    """
    if not _STATUS.is_file():
        raise FileError(f"{_STATUS}: not there; need Linux to measure memory")
    command = [sys.executable, "-m", "imgu_ros.bench.memory", method, str(width), str(height)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no output"]
        raise FileError(f"memory of {method}: {last[0]}; need a process that ends well")
    peak, start = (float(x) for x in done.stdout.split())
    return PeakMemory(method, f"{width}x{height}", peak, peak - start)


def resident_mb() -> float:
    """Return the resident size less shared memory of this process, MB; Linux only."""
    fields = Path("/proc/self/statm").read_text(encoding="ascii").split()
    return (int(fields[1]) - int(fields[2])) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Run a method on some frames; print peak and start, MB."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("method")
    parser.add_argument("width", type=int)
    parser.add_argument("height", type=int)
    arguments = parser.parse_args()
    from imgu_ros.bench.lineup import make_method
    from imgu_ros.simulate.conditions import PLAIN
    from imgu_ros.simulate.trials import Trial, known_targets, trial_frames

    trial = Trial(PLAIN, arguments.width, arguments.height, frames=_FRAMES)
    try:
        frames = list(trial_frames(trial))
        method = make_method(arguments.method, known_targets(trial))
    except ImguError as error:
        sys.exit(str(error))
    # From here on only: making frames took more.
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    start = _peak_mb()
    for simulated in frames:
        method.answer(simulated.frame)
    print(_peak_mb(), start)


def _peak_mb() -> float:
    for line in _STATUS.read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / 1e6
    raise FileError(f"{_STATUS}: no VmHWM; need Linux")


if __name__ == "__main__":
    main()
