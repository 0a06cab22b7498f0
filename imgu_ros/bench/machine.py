"""Where figures were taken: processor, cores, threads, versions."""

from __future__ import annotations

import os
import platform
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


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
