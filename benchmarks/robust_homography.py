# SPDX-License-Identifier: Apache-2.0
"""Robust homographies from real tentative matches: ours beside OpenCV's estimators on the same matches, in one run.

    python benchmarks/robust_homography.py --data ../shared/data --json robust_homography.json

`homogr` (8 pairs) and `evd` (8 extreme views, 2 to 50 % inliers). The matches are shuffled by the seed, the same for
every method; 3 px, the same confidence and number of iterations. RMSE of the labelled inliers in the second picture;
no answer counts as infinite.

Then simulated matches whose truth is known (`imgu_ros.simulate.plane_matches`): targets that take 1 to 0.05 of the
frame's width among wrong matches of six kinds, NEES (8 expected), share of the true matches found and median corner
error, beside USAC_MAGSAC; and how often random pairs are taken for a plane (OpenCV's: with 5 inliers or more).
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

from imgu_ros.errors import EstimationError
from imgu_ros.simulate.plane_matches import KINDS, plane_matches
from imgu_ros.types import Floats, Mask, Matrix3, Points
from imgu_ros.vision.projective.estimate import estimate_homography

THRESHOLD_PX = 3.0
FOUND_PX = 5.0
SETS = ("homogr", "evd")
SCALES = (1.0, 0.4, 0.2, 0.1, 0.05)
FEWEST = 5
#: Runs of each shape and threshold at ten trials, by the number of pairs.
RANDOM_RUNS = {
    "biweight": {8: 35, 12: 35, 20: 30, 50: 12, 200: 3, 2000: 1},
    "truncated": {8: 40, 12: 40, 20: 40, 50: 40, 200: 20, 2000: 3},
    "USAC_MAGSAC": {8: 40, 12: 40, 20: 40, 50: 40, 200: 20, 2000: 3},
}
OPENCV = {
    "RANSAC": cv2.RANSAC,
    "USAC_DEFAULT": cv2.USAC_DEFAULT,
    "USAC_ACCURATE": cv2.USAC_ACCURATE,
    "USAC_MAGSAC": cv2.USAC_MAGSAC,
}


@dataclass(frozen=True)
class Pair:
    """Tentative matches of two pictures, and which of them are labelled as inliers."""

    name: str
    src: Points
    dst: Points
    labelled: Mask


@dataclass(frozen=True)
class Figures:
    """One method on one set of pairs."""

    set: str
    method: str
    median_rmse_px: float
    share_found: float
    mean_ms: float
    median_ms: float


@dataclass(frozen=True)
class OutlierFigures:
    """Both methods on views of one width among wrong matches of one kind, 40 and 80 % of all."""

    kind: str
    scale: float
    nees: float
    recall: float
    corner_px: float
    failed: float
    magsac_recall: float
    magsac_corner_px: float


@dataclass(frozen=True)
class RandomFigures:
    """How often one method takes random pairs for a plane: `accepted` of `runs`."""

    method: str
    count: int
    runs: int
    accepted: int


@dataclass(frozen=True)
class Options:
    """What every method is given."""

    seeds: int
    iterations: int
    confidence: float


def pairs(data: Path, name: str) -> Iterator[Pair]:
    """Yield the pairs of a set."""
    columns = (0, 1, 3, 4) if name == "homogr" else (0, 1, 2, 3)
    for path in sorted((data / "homography" / name).glob("*_pts.txt")):
        rows = [line.split() for line in path.read_text().splitlines()]
        xy = np.array([[float(row[c]) for c in columns] for row in rows])
        labelled = np.array([float(row[-1]) == 1 for row in rows])
        yield Pair(path.name.removesuffix("_pts.txt"), xy[:, :2].copy(), xy[:, 2:].copy(), labelled)


def ours(score: str, options: Options) -> Callable[[Points, Points, int], Matrix3 | None]:
    """Return `estimate_homography` with a score."""

    def estimate(src: Points, dst: Points, seed: int) -> Matrix3 | None:
        try:
            return estimate_homography(
                src,
                dst,
                np.random.default_rng(seed),
                threshold_px=THRESHOLD_PX,
                score=score,
                confidence=options.confidence,
                max_iterations=options.iterations,
            ).H
        except EstimationError:
            return None

    return estimate


def opencv(method: int, options: Options) -> Callable[[Points, Points, int], Matrix3 | None]:
    """Return `findHomography` with a method."""

    def estimate(src: Points, dst: Points, seed: int) -> Matrix3 | None:
        del seed
        H, _ = cv2.findHomography(
            src, dst, method, THRESHOLD_PX, maxIters=options.iterations, confidence=options.confidence
        )
        return H

    return estimate


def rmse(H: Matrix3 | None, pair: Pair) -> float:
    """Return the root mean square distance of the mapped labelled inliers from their matches, px."""
    if H is None or not np.isfinite(H).all():
        return np.inf
    mapped = pair.src[pair.labelled] @ H[:, :2].T + H[:, 2]
    if (mapped[:, 2] == 0).any():
        return np.inf
    distance: Floats = mapped[:, :2] / mapped[:, 2:] - pair.dst[pair.labelled]
    return float(np.sqrt((distance**2).sum(axis=1).mean()))


def main() -> None:
    """Print the table; write it as JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with homography/homogr, evd")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--trials", type=int, default=10, help="seeds of the simulated matches")
    parser.add_argument("--iterations", type=int, default=2000, help="OpenCV's default is 2000")
    parser.add_argument("--confidence", type=float, default=0.9999)
    parser.add_argument("--json", type=Path, help="write the figures to this JSON file")
    arguments = parser.parse_args()
    options = Options(arguments.seeds, arguments.iterations, arguments.confidence)
    methods = {
        "ours (biweight)": ours("biweight", options),
        "ours (truncated)": ours("truncated", options),
        **{name: opencv(method, options) for name, method in OPENCV.items()},
    }
    print(
        f"OpenCV {cv2.__version__}, NumPy {np.__version__}; {options.seeds} seeds, {THRESHOLD_PX:g} px, "
        f"{options.iterations} iterations, confidence {options.confidence}"
    )
    print(f"{'set':8} {'method':18} {'median RMSE px':>14} {'share <= 5 px':>14} {'mean ms':>9} {'median ms':>9}")
    figures = []
    for name in SETS:
        loaded = list(pairs(arguments.data, name))
        if not loaded:
            raise SystemExit(f"{arguments.data}: no homography/{name}; need the data folder")
        figures += _measured(name, loaded, methods, options)
        _print_verdict(name, figures)
    trials = [_outliers(kind, scale, arguments.trials) for kind in KINDS for scale in SCALES]
    chance = _random_pairs(arguments.trials)
    if arguments.json:
        report = {"sets": figures, "outliers": trials, "random": chance}
        arguments.json.write_text(json.dumps({k: [asdict(f) for f in v] for k, v in report.items()}, indent=2) + "\n")


def _measured(
    name: str,
    loaded: list[Pair],
    methods: dict[str, Callable[[Points, Points, int], Matrix3 | None]],
    options: Options,
) -> list[Figures]:
    errors: dict[str, list[float]] = {method: [] for method in methods}
    times: dict[str, list[float]] = {method: [] for method in methods}
    for pair in loaded:
        for seed in range(options.seeds):
            order = np.random.default_rng(seed).permutation(len(pair.src))
            src, dst = pair.src[order], pair.dst[order]
            for method, estimate in methods.items():
                start = time.perf_counter()
                H = estimate(src, dst, seed)
                times[method].append(1000 * (time.perf_counter() - start))
                errors[method].append(rmse(H, pair))
    figures = []
    for method in methods:
        e, t = np.array(errors[method]), times[method]
        figures.append(
            Figures(
                name, method, float(np.median(e)), float(np.mean(e <= FOUND_PX)), float(np.mean(t)), float(np.median(t))
            )
        )
        f = figures[-1]
        print(
            f"{name:8} {method:18} {f.median_rmse_px:14.3f} {f.share_found:14.3f} {f.mean_ms:9.1f} {f.median_ms:9.1f}"
        )
    return figures


def _outliers(kind: str, scale: float, seeds: int) -> OutlierFigures:
    """Measure both methods among wrong matches of a kind."""
    nees, recall, corners, theirs, their_corners, runs = [], [], [], [], [], 0
    for share in (0.4, 0.8):
        for seed in range(seeds):
            runs += 1
            matches = plane_matches(kind, share, scale, seed)
            try:
                found = estimate_homography(matches.src, matches.dst, np.random.default_rng(seed))
            except EstimationError:
                pass
            else:
                nees.append(matches.nees(found))
                recall.append(float(found.inliers[matches.true].mean()))
                corners.append(matches.corner_error(found.H))
            H, mask = cv2.findHomography(
                matches.src, matches.dst, cv2.USAC_MAGSAC, THRESHOLD_PX, maxIters=2000, confidence=0.9999
            )
            theirs.append(0.0 if H is None else float(mask.ravel()[matches.true].mean()))
            their_corners.append(np.inf if H is None else matches.corner_error(H))
    if kind == KINDS[0] and scale == SCALES[0]:
        print(f"{'wrong matches':18} {'scale':>6} {'NEES':>7} {'recall':>7} {'corner':>7} {'none':>5} | MAGSAC")
    f = OutlierFigures(
        kind,
        scale,
        *(float(np.mean(x)) if x else float("nan") for x in (nees, recall)),
        float(np.median(corners)) if corners else float("nan"),
        1 - len(nees) / runs,
        float(np.mean(theirs)),
        float(np.median(their_corners)),
    )
    print(
        f"{kind:18} {scale:6.2f} {f.nees:7.2f} {f.recall:7.3f} {f.corner_px:7.2f} {f.failed:5.2f} | "
        f"{f.magsac_recall:.3f} {f.magsac_corner_px:8.2f}",
        flush=True,
    )
    return f


def _random_pairs(trials: int) -> list[RandomFigures]:
    """Count how often random pairs agree, in frames of three shapes, with thresholds of 1, 3 and 10 px."""
    figures = []
    for method, repeats in RANDOM_RUNS.items():
        for count, repeat in repeats.items():
            runs = accepted = 0
            for extent in ((640, 480), (100, 100), (3000, 60)):
                for threshold in (1.0, 3.0, 10.0):
                    for seed in range(max(1, repeat * trials // 10)):
                        rng = np.random.default_rng((seed, count))
                        src, dst = rng.uniform(0, 1, (2, count, 2)) * extent
                        runs += 1
                        accepted += int(_accepted(method, src, dst, threshold, rng))
            figures.append(RandomFigures(method, count, runs, accepted))
            print(f"random pairs: {method:18} {count:5} pairs: {accepted} of {runs} accepted", flush=True)
    return figures


def _accepted(method: str, src: Points, dst: Points, threshold: float, rng: np.random.Generator) -> bool:
    if method in OPENCV:
        H, mask = cv2.findHomography(src, dst, OPENCV[method], threshold, maxIters=2000, confidence=0.9999)
        return H is not None and int(np.count_nonzero(mask)) >= FEWEST
    try:
        estimate_homography(src, dst, rng, threshold_px=threshold, score=method)
    except EstimationError:
        return False
    return True


def _print_verdict(name: str, figures: list[Figures]) -> None:
    of_set = [f for f in figures if f.set == name]
    best_px = min(f.median_rmse_px for f in of_set if f.method in OPENCV)
    best_share = max(f.share_found for f in of_set if f.method in OPENCV)
    f = of_set[0]
    good = f.median_rmse_px <= best_px + 0.05 and f.share_found >= best_share - 0.02
    print(
        f"{name}: {f.method} {f.median_rmse_px:.3f} px, {f.share_found:.3f}; "
        f"best of OpenCV's {best_px:.3f} px, {best_share:.3f}: {'not worse' if good else 'WORSE'}"
    )


if __name__ == "__main__":
    main()
