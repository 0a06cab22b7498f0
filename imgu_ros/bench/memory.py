# SPDX-License-Identifier: Apache-2.0
"""How much memory a method takes: in a process that does nothing else, and over many frames."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from imgu_ros.errors import FileError, ImguError

_STATUS = Path("/proc/self/status")
_FRAMES = 4
_LIMIT_S = 300


@dataclass(frozen=True, slots=True)
class PeakMemory:
    """Peak of the resident size of a process with imports, one method, its targets and some frames.

    Attributes
    ----------
    method, size : who worked on what
    peak_mb : of the whole process
    imports_mb : what it had after the imports
    """

    method: str
    size: str
    peak_mb: float
    imports_mb: float


def peak_memory(method: str, width: int, height: int) -> PeakMemory:
    """Measure one method in a process of its own; frames are made here, for making them takes more.

    Parameters
    ----------
    method : a name in `lineup.METHODS`
    width, height : of the frames, px

    Raises
    ------
    ParameterError
        If there is no such method.
    FileError
        If the process cannot be measured: the system has no /proc, or the process ended badly.
    """
    import numpy as np

    from imgu_ros.bench.recipes import check_method
    from imgu_ros.simulate.conditions import PLAIN
    from imgu_ros.simulate.trials import Trial, trial_frames

    check_method(method)
    if not _STATUS.is_file():
        raise FileError(f"{_STATUS}: not there; need Linux to measure memory")
    with tempfile.TemporaryDirectory(prefix="imgu_bench_") as folder:
        path = Path(folder) / "frames.npy"
        trial = Trial(PLAIN, width, height, frames=_FRAMES)
        np.save(path, np.stack([simulated.frame.image.pixels for simulated in trial_frames(trial)]))
        command = [sys.executable, "-m", "imgu_ros.bench.memory", method, str(path)]
        # The package may be a source folder that only this process has on its path.
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False, env=environment)
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no output"]
        raise FileError(f"memory of {method}: {last[0]}; need a process that ends well")
    peak, imports = (float(x) for x in done.stdout.split())
    return PeakMemory(method, f"{width}x{height}", peak, imports)


def resident_mb() -> float:
    """Return the resident size less shared memory of this process, MB.

    Raises
    ------
    FileError
        If the system has no /proc.
    """
    try:
        fields = Path("/proc/self/statm").read_text(encoding="ascii").split()
    except OSError as error:
        raise FileError(f"/proc/self/statm: {error.strerror}; need Linux to measure memory") from None
    return (int(fields[1]) - int(fields[2])) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Run a method on the frames of a file; print the peak and what the imports take, MB."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("method")
    parser.add_argument("frames", type=Path)
    arguments = parser.parse_args()
    import numpy as np

    from imgu_ros.bench.recipes import make_method
    from imgu_ros.frame import Frame
    from imgu_ros.simulate.conditions import PLAIN
    from imgu_ros.simulate.sequence import default_camera
    from imgu_ros.simulate.trials import Trial, known_targets
    from imgu_ros.vision.formation.cfa import BayerPattern
    from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

    imports = _status_mb("VmHWM")
    frames = np.load(arguments.frames, mmap_mode="r")
    height, width = frames.shape[1:]
    layout = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
    try:
        # A target's picture comes from a file as a rule; making it here takes more than the method.
        targets = known_targets(Trial(PLAIN, width, height))
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        method = make_method(arguments.method, targets)
        for index, pixels in enumerate(frames):
            image = RawImage(np.ascontiguousarray(pixels), layout)
            method.answer(Frame(image, index * 33_333_333, "camera", default_camera(width, height)))
    except ImguError as error:
        sys.exit(str(error))
    print(_status_mb("VmHWM"), imports)


def _status_mb(name: str) -> float:
    for line in _STATUS.read_text(encoding="ascii").splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024 / 1e6
    raise FileError(f"{_STATUS}: no {name}; need Linux")


if __name__ == "__main__":
    main()
