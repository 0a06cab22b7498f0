# SPDX-License-Identifier: Apache-2.0
"""Homographies of real image pairs: `imgu match` beside SIFT + MAGSAC++ on the same files, in one run.

    python benchmarks/image_pairs.py --data ../shared/data --out image_pairs.json

Pairs: `bark` 1-2 to 1-6 (zoom and rotation) and `graf` 1-3 (viewpoint) of the Oxford VGG sequences, with their true
homographies. Corner error: mean distance over the first image's four corners, px.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.cli.main import main as imgu
from imgu_ros.types import Image, Matrix3
from imgu_ros.vision.projective.transform import transform


@dataclass(frozen=True)
class Pair:
    """Two image files and the true homography from the first to the second."""

    name: str
    first: Path
    second: Path
    H: Matrix3


@dataclass(frozen=True)
class Figures:
    """One pair's corner errors (None: not found) and times, both methods on the same files."""

    pair: str
    ours_px: float | None
    sift_px: float | None
    ours_ms: float
    sift_ms: float


def pairs(data: Path) -> Iterator[Pair]:
    """Yield the pairs that the data folder holds."""
    bark = data / "homography" / "bark"
    for k in range(2, 7):
        yield Pair(f"bark 1-{k}", bark / "img1.ppm", bark / f"img{k}.ppm", np.loadtxt(bark / f"H1to{k}p"))
    graf = data / "homography" / "graf"
    storage = cv2.FileStorage(str(graf / "H1to3p.xml"), cv2.FILE_STORAGE_READ)
    yield Pair("graf 1-3", graf / "graf1.png", graf / "graf3.png", storage.getFirstTopLevelNode().mat())


def ours(pair: Pair) -> Matrix3 | None:
    """Return H by `imgu match` with default parameters."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        out = Path(folder) / "match.json"
        imgu(["match", str(pair.first), str(pair.second), "--json", str(out)])
        H = json.loads(out.read_text())["H"]
    return None if H is None else np.array(H)


def sift_and_magsac(pair: Pair) -> Matrix3 | None:
    """Return H by the usual recipe: SIFT (2000), ratio test 0.8, findHomography with USAC_MAGSAC at 3 px."""
    first, second = (cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in (pair.first, pair.second))
    sift = cv2.SIFT.create(2000)
    keypoints1, descriptors1 = sift.detectAndCompute(first, None)
    keypoints2, descriptors2 = sift.detectAndCompute(second, None)
    found = cv2.BFMatcher().knnMatch(descriptors1, descriptors2, k=2)
    good = [m for m, n in found if m.distance < 0.8 * n.distance]
    src = np.array([keypoints1[m.queryIdx].pt for m in good])
    dst = np.array([keypoints2[m.trainIdx].pt for m in good])
    H, _ = cv2.findHomography(src, dst, cv2.USAC_MAGSAC, 3.0, maxIters=10_000, confidence=0.999)
    return H


def corner_error(H: Matrix3 | None, pair: Pair, picture: Image) -> float | None:
    """Return the mean distance of the four corners from where the truth puts them."""
    if H is None:
        return None
    height, width = picture.shape[:2]
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], float)
    return float(np.hypot(*(transform(H, corners) - transform(pair.H, corners)).T).mean())


def measured(pair: Pair) -> Figures:
    """Measure both methods on a pair; each runs once before it is timed."""
    picture = cv2.imread(str(pair.first))
    rows = []
    for method in (ours, sift_and_magsac):
        method(pair)
        start = time.perf_counter()
        H = method(pair)
        rows.append((corner_error(H, pair, picture), 1000 * (time.perf_counter() - start)))
    return Figures(pair.name, rows[0][0], rows[1][0], rows[0][1], rows[1][1])


def main() -> None:
    """Print the table; write it as JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--data", type=Path, default=Path("../shared/data"), help="folder with homography/bark and graf"
    )
    parser.add_argument("--out", type=Path, help="write the figures to this JSON file")
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, {cv2.getNumThreads()} threads; file to homography, corner error px / ms")
    print(f"{'pair':10} {'imgu match':>18} {'SIFT + MAGSAC++':>18} {'error ratio':>12}")
    figures = [measured(pair) for pair in pairs(arguments.data)]
    for f in figures:
        ratio = f"{f.ours_px / f.sift_px:12.2f}" if f.ours_px is not None and f.sift_px else f"{'-':>12}"
        print(f"{f.pair:10} {_cell(f.ours_px, f.ours_ms)} {_cell(f.sift_px, f.sift_ms)} {ratio}")
    if arguments.out:
        arguments.out.write_text(json.dumps([asdict(f) for f in figures], indent=2) + "\n")


def _cell(error: float | None, ms: float) -> str:
    return f"{'-' if error is None else f'{error:.2f}':>9} /{ms:7.0f}"


if __name__ == "__main__":
    main()
