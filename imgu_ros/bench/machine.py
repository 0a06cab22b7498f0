# SPDX-License-Identifier: Apache-2.0
"""Where figures were taken: processor, cores, threads, versions, and what else ran there meanwhile."""

from __future__ import annotations

import os
import platform
import time
from dataclasses import dataclass
from pathlib import Path

import cv2

from imgu_ros.report.versions import versions


@dataclass(frozen=True, slots=True, eq=False)
class Machine:
    """What the figures depend on beside the code.

    Attributes
    ----------
    processor : its name, as the system says
    cores : that this process may use
    opencv_threads : of every method alike
    blas_threads : as the environment says; empty: the library's default
    load : average number of running processes over the last minute, before the run
    system : kernel and architecture
    versions : of the package, Python and the libraries
    """

    processor: str
    cores: int
    opencv_threads: int
    blas_threads: str
    load: float
    system: str
    versions: dict[str, str]

    def described(self) -> str:
        """Return it as one line."""
        v = self.versions
        return (
            f"{self.processor}, {self.cores} cores, load {self.load:.1f}; {self.opencv_threads} OpenCV threads; "
            f"imgu_ros {v['imgu_ros']}, OpenCV {v['opencv']}, NumPy {v['numpy']}, Python {v['python']}"
        )


def this_machine() -> Machine:
    """Return where this process runs."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return Machine(
        _processor(),
        cores,
        cv2.getNumThreads(),
        os.environ.get("OPENBLAS_NUM_THREADS", ""),
        round(load, 2),
        f"{platform.system()} {platform.release()} {platform.machine()}",
        versions(),
    )


#: Share of all cores that others may take before wall times say more of them than of what is measured.
_QUIET_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class ProcessorTimes:
    """Clocks at one moment, s: wall time; work of all cores; what the host of a virtual machine took; our own work."""

    wall: float
    busy: float
    stolen: float
    own: float


@dataclass(frozen=True, slots=True)
class ProcessorUse:
    """Who used the processors over some time, in cores on average.

    Attributes
    ----------
    seconds : how long
    cores : of the machine
    own : this process and those that it started
    others : all other processes
    stolen : the host of a virtual machine
    """

    seconds: float
    cores: int
    own: float
    others: float
    stolen: float

    @property
    def quiet(self) -> bool:
        """Whether wall times can be compared: others took at most a tenth of the cores."""
        return self.others + self.stolen <= _QUIET_SHARE * self.cores

    def described(self) -> str:
        """Return it as a sentence; it says so when wall times cannot be compared."""
        text = f"other processes used {self.others:.2f} and the host {self.stolen:.2f} of {self.cores} cores"
        if self.quiet:
            return f"{text}: quiet"
        return f"{text}: TOO LOADED to compare wall times (ms); compare processor times (cpu ms), or measure again"


def processor_times() -> ProcessorTimes | None:
    """Return the clocks now; None where the system does not tell them (no /proc/stat)."""
    try:
        with open("/proc/stat", encoding="ascii") as file:
            numbers = [int(number) for number in file.readline().split()[1:]]
    except (OSError, ValueError):
        return None
    user, nice, system, _idle, _waiting, irq, softirq, stolen = numbers[:8]
    ticks = os.sysconf("SC_CLK_TCK")
    own = sum(os.times()[:4])
    return ProcessorTimes(time.monotonic(), (user + nice + system + irq + softirq) / ticks, stolen / ticks, own)


def processor_use(before: ProcessorTimes, after: ProcessorTimes) -> ProcessorUse:
    """Return who used the processors between two moments."""
    seconds = max(after.wall - before.wall, 1e-3)
    own = (after.own - before.own) / seconds
    # The two clocks tick apart: a difference below zero is none.
    others = max((after.busy - before.busy) / seconds - own, 0.0)
    return ProcessorUse(seconds, os.cpu_count() or 1, own, others, (after.stolen - before.stolen) / seconds)


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
