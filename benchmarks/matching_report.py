# SPDX-License-Identifier: Apache-2.0
"""Matching of real pictures by every kind of descriptor, ours beside OpenCV's.

    python benchmarks/matching_report.py --data ../shared/data --markdown docs/matching.md --json matching.json

Each picture gives its 2000 best keypoints; picture 1 of `bark` (zoom and rotation) and of `iguazu` (rising noise) is
matched to pictures 2 to 6, that of `graf` (steep view) to picture 3. A match is correct when the published homography
takes its first keypoint to within 3 px of the second. The figures are means over a sequence's pairs: matches that pass
the tests, those of them that are correct, and the share of these.

Ours: `detect` on the pipeline's fine pyramid, `describe`, and `match`: ratio test of 0.8 against the nearest descriptor
at another place, mutual. OpenCV's: its own detector and descriptor, BFMatcher.knnMatch and the ratio test of 0.8.
Time is for both pictures and the matching; its ratio is the median over the pairs, ours and OpenCV's taken in turns.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.types import Image, Matrix3, Points
from imgu_ros.vision.descriptors.describe import describe
from imgu_ros.vision.keypoints.detect import detect
from imgu_ros.vision.matching.metrics import metric_for
from imgu_ros.vision.matching.nearest import match
from imgu_ros.vision.methods import DESCRIPTORS
from imgu_ros.vision.projective.transform import transform
from imgu_ros.vision.scale_space.pyramid import build_pyramid

COUNT = 2000
RATIO = 0.8
TOLERANCE_PX = 3.0
SEQUENCES = ("bark", "graf", "iguazu")
READING = """OpenCV's main modules have neither BRIEF nor patches as descriptors. `brief` does not turn with the
picture, which `bark` does: it is for cameras that stay upright. The mutual check, and rivals sought at other places
only, make the share of correct matches at least OpenCV's within 0.01; spreading the keypoints over the picture instead
of crowding them where it is busiest has its price in the number of matches (`orb` on `iguazu`, `dog` on `graf`).
Made by `python benchmarks/matching_report.py`."""


@dataclass(frozen=True)
class Pair:
    """Two pictures and the homography from the first to the second."""

    sequence: str
    first: Image
    second: Image
    H: Matrix3


@dataclass(frozen=True)
class Tentative:
    """Matched points of two pictures, (N, 2) each."""

    first: Points
    second: Points


@dataclass(frozen=True)
class Figures:
    """One way of matching: of each pair, by sequence, the matches and how many are correct; and its time."""

    name: str
    matches: dict[str, list[int]]
    correct: dict[str, list[int]]
    ms: list[float]


#: For each kind of descriptor the detector that suits it, and OpenCV's way, if it has one.
OURS = {
    "orb": "orb",
    "sift": "dog",
    "rootsift": "dog",
    "brief": "orb",
    "patch": "harris",
}


def ours(kind: str) -> Callable[[Image, Image], Tentative]:
    """Return the pipeline's way with a kind of descriptor."""

    def matched(first: Image, second: Image) -> Tentative:
        a, b = (
            describe(pyramid, detect(pyramid, OURS[kind], COUNT), kind)
            for pyramid in (build_pyramid(image, "fine") for image in (first, second))
        )
        found = match(a.descriptors, b.descriptors, metric_for(kind), RATIO, dst_xy=b.keypoints.xy)
        return Tentative(a.keypoints.xy[found.index_src], b.keypoints.xy[found.index_dst])

    return matched


def opencv(feature: Callable[[], cv2.Feature2D], norm: int, root: bool = False) -> Callable[[Image, Image], Tentative]:
    """Return OpenCV's way with one of its features."""

    def described(image: Image) -> tuple[Points, Image]:
        keypoints, rows = feature().detectAndCompute(image, None)
        if root:
            rows = np.sqrt(rows / rows.sum(axis=1, keepdims=True))
        return np.array([k.pt for k in keypoints]), rows

    def matched(first: Image, second: Image) -> Tentative:
        (a, rows_a), (b, rows_b) = described(first), described(second)
        nearest = cv2.BFMatcher(norm).knnMatch(rows_a, rows_b, k=2)
        kept = [p[0] for p in nearest if len(p) == 2 and p[0].distance < RATIO * p[1].distance]
        at_first, at_second = ([getattr(m, name) for m in kept] for name in ("queryIdx", "trainIdx"))
        return Tentative(a[at_first].reshape(-1, 2), b[at_second].reshape(-1, 2))

    return matched


OPENCV = {
    "orb": opencv(lambda: cv2.ORB.create(COUNT), cv2.NORM_HAMMING),
    "sift": opencv(lambda: cv2.SIFT.create(COUNT), cv2.NORM_L2),
    "rootsift": opencv(lambda: cv2.SIFT.create(COUNT), cv2.NORM_L2, root=True),
}


def pairs(data: Path) -> Iterator[Pair]:
    """Yield the pairs of the data's sequences."""
    folder = data / "homography"
    for sequence in SEQUENCES:
        suffix = "graf?.png" if sequence == "graf" else "img?.p?m"
        files = sorted((folder / sequence).glob(suffix))
        first = cv2.imread(str(files[0]), cv2.IMREAD_GRAYSCALE)
        for path in files[1:]:
            name = folder / sequence / f"H1to{path.stem[-1]}p"
            if sequence == "graf":
                stored = cv2.FileStorage(str(name.with_suffix(".xml")), cv2.FILE_STORAGE_READ)
                H = stored.getFirstTopLevelNode().mat()
            else:
                H = np.loadtxt(name) if name.exists() else np.eye(3)
            yield Pair(sequence, first, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), H)


def measured(ways: dict[str, Callable[[Image, Image], Tentative]], data: Path) -> list[Figures]:
    """Match every pair in every way, in turns."""
    figures = [Figures(name, {s: [] for s in SEQUENCES}, {s: [] for s in SEQUENCES}, []) for name in ways]
    for pair in pairs(data):
        for row, way in zip(figures, ways.values(), strict=True):
            start = time.perf_counter()
            found = way(pair.first, pair.second)
            row.ms.append(1000 * (time.perf_counter() - start))
            off = np.linalg.norm(transform(pair.H, found.first) - found.second, axis=1)
            row.matches[pair.sequence].append(len(off))
            row.correct[pair.sequence].append(int((off <= TOLERANCE_PX).sum()))
    return figures


def table(figures: list[Figures]) -> str:
    """Return the figures as a table in Markdown."""
    lines = [
        "| way | " + " | ".join(f"{s}: matches | correct | share" for s in SEQUENCES) + " | ms | ours / OpenCV's |",
        "|---|" + "---:|" * (3 * len(SEQUENCES) + 2),
    ]
    by_name = {f.name: f for f in figures}
    for f in figures:
        cells = []
        for s in SEQUENCES:
            share = sum(f.correct[s]) / max(1, sum(f.matches[s]))
            cells.append(f"{np.mean(f.matches[s]):.0f} | {np.mean(f.correct[s]):.0f} | **{share:.2f}**")
        other = by_name.get(f"OpenCV {f.name.split(' ')[0]}")
        ratio = f"{np.median(np.divide(f.ms, other.ms)):.2f}" if other else ""
        lines.append(f"| {f.name} | {' | '.join(cells)} | {np.median(f.ms):.0f} | {ratio} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table; write it as Markdown and JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with homography/")
    parser.add_argument("--markdown", type=Path, help="write the page to this file")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    ways: dict[str, Callable[[Image, Image], Tentative]] = {}
    for kind in DESCRIPTORS:
        ways[f"{kind} on {OURS[kind]}"] = ours(kind)
        if kind in OPENCV:
            ways[f"OpenCV {kind}"] = OPENCV[kind]
    figures = measured(ways, arguments.data)
    text = table(figures)
    print(text)
    if arguments.markdown:
        said = (__doc__ or "").split("\n\n")
        versions = f"OpenCV {cv2.__version__}, {cv2.getNumThreads()} threads."
        page = ["# Matching of real pictures", said[2], text, said[3].strip() + " " + versions, READING]
        arguments.markdown.write_text("\n\n".join(page) + "\n", encoding="utf-8")
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(f) for f in figures], indent=2) + "\n")


if __name__ == "__main__":
    main()
