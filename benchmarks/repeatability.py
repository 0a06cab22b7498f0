# SPDX-License-Identifier: Apache-2.0
"""Repeatability of the keypoint detectors on real pictures, ours beside OpenCV's, and their time and memory.

    python benchmarks/repeatability.py --data ../shared/data --markdown docs/repeatability.md --json repeatability.json

After Schmid, Mohr & Bauckhage (2000) and Mikolajczyk et al. (2005): of two pictures' keypoints, those count that the
true homography maps into the other picture. Two are the same when each, mapped into the other's picture, lies within
3 px of it there (both ways, so that a zoom helps nobody), nearest pairs first, every keypoint at most once.
Repeatability is their number over the smaller of the two counts. Each detector gives its 1000 best keypoints in each
picture; picture 1 of a sequence is compared with pictures 2 to 6.

Time (median of 5) and peak memory (of a process that does nothing else, over what the imports take) are for one
picture of 1920x1080, a `bark` picture enlarged.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.types import Image, Matrix3, Points
from imgu_ros.vision.keypoints import FastParameters, detect, repeatability
from imgu_ros.vision.methods import DETECTORS
from imgu_ros.vision.scale_space import build_pyramid

COUNT = 1000
TOLERANCE_PX = 3.0
SEQUENCES = ("bark", "iguazu")
READING = """The first rows are `keypoints.detector` on the pipeline's fine pyramid, spread over the picture; `pairs` is
the mean number of keypoints found again. Spreading has its price under noise (`iguazu`): half of the keypoints (of
`dog` a third) are chosen for their place; OpenCV's are the 1000 strongest, wherever they lie. OpenCV 5.0's MSER drops
the stable regions (its issue 29652); ours does not.
Made by `python benchmarks/repeatability.py`."""


@dataclass(frozen=True)
class Figures:
    """One detector: share repeated and number of pairs of each of the five picture pairs, time and memory on 1080p."""

    detector: str
    repeated: dict[str, list[float]]
    pairs: dict[str, list[int]]
    ms: float
    peak_mb: float


def ours(detector: str, parameters: FastParameters | None = None) -> Callable[[Image], Points]:
    """Return the detector as the pipeline calls it: on a fine pyramid, spread."""
    return lambda image: detect(build_pyramid(image, "fine"), detector, COUNT, parameters=parameters).xy


def strongest(detector: cv2.Feature2D) -> Callable[[Image], Points]:
    """Return OpenCV's detector with its keypoints of the largest response."""

    def found(image: Image) -> Points:
        keypoints = sorted(detector.detect(image, None), key=lambda k: -k.response)[:COUNT]
        return np.array(cv2.KeyPoint.convert(keypoints), float).reshape(-1, 2)

    return found


def good_features(image: Image) -> Points:
    """Return OpenCV's Harris corners."""
    found = cv2.goodFeaturesToTrack(image, COUNT, 1e-4, 1, useHarrisDetector=True, k=0.04)
    return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(float)


WAYS: dict[str, Callable[[Image], Points]] = {
    **{name: ours(name) for name in DETECTORS},
    "fast, arc 12": ours("fast", FastParameters(arc=12)),
    "OpenCV ORB": strongest(cv2.ORB.create(COUNT)),
    "OpenCV FAST": strongest(cv2.FastFeatureDetector.create()),
    "OpenCV Harris": good_features,
    "OpenCV SIFT": strongest(cv2.SIFT.create(COUNT)),
    "OpenCV MSER": strongest(cv2.MSER.create()),
}


def pictures(data: Path, sequence: str) -> Iterator[tuple[Image, Matrix3]]:
    """Yield the pictures of a sequence, grey, with the homographies from the first one."""
    folder = data / "homography" / sequence
    for k, path in enumerate(sorted(folder.glob("img?.p?m")), 1):
        yield cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.eye(3) if k == 1 else np.loadtxt(folder / f"H1to{k}p")


def large(data: Path) -> Image:
    """Return a picture of 1920x1080."""
    image = cv2.imread(str(data / "homography" / "bark" / "img1.ppm"), cv2.IMREAD_GRAYSCALE)
    return cv2.resize(image, (1920, 1080), interpolation=cv2.INTER_CUBIC)


def measured(name: str, data: Path) -> Figures:
    """Measure one detector."""
    found = WAYS[name]
    repeated: dict[str, list[float]] = {}
    pairs: dict[str, list[int]] = {}
    for sequence in SEQUENCES:
        keypoints = [(found(image), H, image.shape[1::-1]) for image, H in pictures(data, sequence)]
        xy, _, size = keypoints[0]
        rows = [repeatability(xy, other, H, size, other_size, TOLERANCE_PX) for other, H, other_size in keypoints[1:]]
        repeated[sequence], pairs[sequence] = [row.share for row in rows], [len(row.index_src) for row in rows]
    image = large(data)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        found(image)
        times.append(1000 * (time.perf_counter() - start))
    peak = subprocess.run(
        [sys.executable, __file__, "--data", str(data), "--peak-of", name], check=True, capture_output=True, text=True
    )
    return Figures(name, repeated, pairs, float(np.median(times)), float(peak.stdout))


def peak_mb(name: str, data: Path) -> float:
    """Return how much larger this process got at most while it detected."""
    image = large(data)
    WAYS[name](image[:64, :64].copy())  # libraries load
    Path("/proc/self/clear_refs").write_text("5")  # Linux: the peak is forgotten
    before = _memory_kb("VmRSS")
    WAYS[name](image)
    return (_memory_kb("VmHWM") - before) / 1024


def _memory_kb(what: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(what))


def table(figures: list[Figures]) -> str:
    """Return the figures as a table in Markdown."""
    head = "| detector | " + " | ".join(f"{s}, mean (1-2 ... 1-6) | pairs" for s in SEQUENCES) + " | ms | peak MB |"
    lines = [head, "|---|" + "---|---:|" * len(SEQUENCES) + "---:|---:|"]
    for f in figures:
        cells = [
            f"**{np.mean(f.repeated[s]):.2f}** ({_listed(f.repeated[s])}) | {np.mean(f.pairs[s]):.0f}"
            for s in SEQUENCES
        ]
        lines.append(f"| {f.detector} | {' | '.join(cells)} | {f.ms:.0f} | {f.peak_mb:.0f} |")
    return "\n".join(lines)


def _listed(shares: list[float]) -> str:
    return " ".join(f"{share:.2f}" for share in shares)


def main() -> None:
    """Print the table; write it as Markdown and JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with homography/")
    parser.add_argument("--markdown", type=Path, help="write the page to this file")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--peak-of", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.peak_of:
        print(peak_mb(arguments.peak_of, arguments.data))
        return
    figures = [measured(name, arguments.data) for name in WAYS]
    text = table(figures)
    print(text)
    if arguments.markdown:
        said = (__doc__ or "").split("\n\n")
        versions = f"OpenCV {cv2.__version__}, {cv2.getNumThreads()} threads."
        page = ["# Repeatability of the detectors", said[2], text, said[3].strip() + " " + versions, READING]
        arguments.markdown.write_text("\n\n".join(page) + "\n", encoding="utf-8")
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(f) for f in figures], indent=2) + "\n")


if __name__ == "__main__":
    main()
