# SPDX-License-Identifier: Apache-2.0
"""Robust homographies from real tentative matches: ours beside OpenCV's estimators on the same matches, in one run.

    python benchmarks/robust_homography.py --data ../shared/data --json robust_homography.json

`homogr` (8 pairs) and `evd` (8 extreme views, 2 to 50 % inliers). The matches are shuffled by the seed, the same for
every method; 3 px, the same confidence and number of iterations. RMSE of the labelled inliers in the second picture;
no answer counts as infinite.

Then simulated matches whose truth is known (`imgu_ros.simulate.plane_matches`): targets that take 1 to 0.05 of the
frame's width among wrong matches of six kinds, NEES (8 expected), share of the true matches found and median corner
error, beside USAC_MAGSAC; and how often random pairs are taken for a plane (OpenCV's: with 5 inliers or more).

Then the choices of `homography.estimator` beside each other: on simulated matches by the share of wrong ones and the
width of the view, on random pairs, and in the whole pipeline on simulated frames, where a target is in view or not
(`--only estimators` runs this part alone, without the data folder).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.detect import robust_fit
from imgu_ros.errors import EstimationError
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.conditions import condition_named
from imgu_ros.simulate.plane_matches import KINDS, plane_matches
from imgu_ros.simulate.trials import Trial, known_targets, trial_frames
from imgu_ros.simulate.truth import corner_error
from imgu_ros.types import Floats, Mask, Matrix3, Points
from imgu_ros.vision.methods import ESTIMATORS
from imgu_ros.vision.projective.estimate import estimate_homography
from imgu_ros.vision.projective.robust import HomographyEstimator, RansacParameters, RobustHomography, UsacParameters

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
#: Of the part about the choices of `homography.estimator`: shares of wrong matches, runs of random pairs for each trial
#: and threshold, conditions of simulated frames, and the corner error from which on a result is false.
WRONG_SHARES = (0.2, 0.4, 0.6, 0.8, 0.9)
ESTIMATOR_RUNS = {8: 10, 12: 10, 20: 10, 50: 10, 200: 3}
CONDITIONS = (
    "plain", "occlusion-60", "outside-50", "blur-15", "noise-snr-10", "size-10", "size-300", "tilt-60", "tilt-70",
    "repeated-texture", "two-copies", "look-alikes", "no-target",
)  # fmt: skip
FALSE_PX = 10.0
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
class EstimatorFigures:
    """One choice of `homography.estimator` on views of one width with one share of wrong matches.

    `found` of `runs` give an answer, with the mean share of the true matches and the median corner error of these;
    `ms` is processor time.
    """

    estimator: str
    wrong_share: float
    scale: float
    runs: int
    found: int
    recall: float
    corner_px: float
    ms: float


@dataclass(frozen=True)
class PipelineFigures:
    """One choice of `homography.estimator` in the pipeline, on frames under one condition.

    `false` counts frames in which a target is reported that is not there, or more than 10 px from there; `ms` is
    processor time of the estimation of homographies in a frame, all search passes together, `frame_ms` that of all.
    """

    estimator: str
    condition: str
    frames: int
    found: int
    false: int
    corner_px: float
    ms: float
    frame_ms: float


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
    parser.add_argument("--only", choices=("estimators",), help="a part alone")
    parser.add_argument("--frames", type=int, default=12, help="simulated frames of each condition")
    parser.add_argument("--json", type=Path, help="write the figures to this JSON file")
    arguments = parser.parse_args()
    if arguments.only == "estimators":
        report = _estimators(arguments.trials, arguments.frames)
        if arguments.json:
            known = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
            arguments.json.write_text(json.dumps({**known, **report}, indent=2) + "\n")
        return
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
    estimators = _estimators(arguments.trials, arguments.frames)
    if arguments.json:
        sets = {"sets": figures, "outliers": trials, "random": chance}
        report = {k: [asdict(f) for f in v] for k, v in sets.items()}
        arguments.json.write_text(json.dumps(report | estimators, indent=2) + "\n")


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


def _estimators(trials: int, frames: int) -> dict[str, list[dict[str, object]]]:
    """Measure the choices of `homography.estimator`, as the pipeline calls them, in turn on the same matches."""
    made = {name: row.made(_uniform(name)) for name, row in ESTIMATORS.items()}
    ratios = [
        _of_estimator(name, made[name], share, scale, trials)
        for share in WRONG_SHARES
        for scale in SCALES[::2]
        for name in made
    ]
    chance = []
    for name, estimator in made.items():
        for count, repeat in ESTIMATOR_RUNS.items():
            runs = accepted = 0
            for threshold in (1.0, 3.0, 10.0):
                for seed in range(repeat * trials):
                    src, dst = np.random.default_rng((seed, count)).uniform(0, 1, (2, count, 2)) * (640, 480)
                    runs += 1
                    accepted += _gives_an_answer(estimator, src, dst, threshold, seed)
            chance.append(RandomFigures(name, count, runs, accepted))
            print(f"random pairs: {name:18} {count:5} pairs: {accepted} of {runs} accepted", flush=True)
    pipeline = [f for condition in CONDITIONS for f in _in_pipeline(condition, frames)]
    for name in made:
        of = [f for f in pipeline if f.estimator == name]
        print(
            f"pipeline, all conditions: {name:18} found {sum(f.found for f in of)} of {sum(f.frames for f in of)}, "
            f"false {sum(f.false for f in of)}, mean {np.mean([f.ms for f in of]):.2f} ms"
        )
    parts = {"estimators": ratios, "estimators_random": chance, "estimators_pipeline": pipeline}
    return {name: [asdict(f) for f in part] for name, part in parts.items()}


def _uniform(name: str) -> RansacParameters | UsacParameters:
    """Return parameters of an estimator for matches in no order."""
    if name == "usac_magsac":
        return UsacParameters(max_iterations=2000, min_inliers=FEWEST)
    return RansacParameters(sampler="uniform", max_iterations=2000, min_inliers=FEWEST)


def _of_estimator(
    name: str, estimator: HomographyEstimator, share: float, scale: float, trials: int
) -> EstimatorFigures:
    recall, corners, times = [], [], []
    for kind in KINDS:
        for seed in range(trials):
            matches = plane_matches(kind, share, scale, seed)
            start = time.process_time()
            try:
                found = estimator(matches.src, matches.dst, THRESHOLD_PX, seed)
            except EstimationError:
                continue
            finally:
                times.append(1000 * (time.process_time() - start))
            recall.append(float(found.inliers[matches.true].mean()))
            corners.append(matches.corner_error(found.H))
    f = EstimatorFigures(
        name,
        share,
        scale,
        len(times),
        len(recall),
        float(np.mean(recall)) if recall else 0.0,
        float(np.median(corners)) if corners else float("inf"),
        float(np.mean(times)),
    )
    print(
        f"{share:.0%} wrong, scale {scale:.2f}: {name:18} {f.found:3} of {f.runs} found, recall {f.recall:.3f}, "
        f"corner {f.corner_px:7.2f} px, {f.ms:6.2f} ms",
        flush=True,
    )
    return f


def _gives_an_answer(estimator: HomographyEstimator, src: Points, dst: Points, threshold_px: float, seed: int) -> bool:
    try:
        estimator(src, dst, threshold_px, seed)
    except EstimationError:
        return False
    return True


def _in_pipeline(condition: str, frames: int) -> list[PipelineFigures]:
    trial = Trial(condition_named(condition), 1280, 720, frames, seed=5, unrelated=True)
    images, size = known_targets(trial), (trial.width, trial.height)
    localizers, figures = {}, []
    for name in ESTIMATORS:
        parameters = parameters_from({"tracking.enabled": False, "homography.estimator": name})
        localizers[name] = Localizer(parameters, prepare_references(images, parameters))
        localizers[name].prepare()
    found, false, corners = ({name: [] for name in localizers} for _ in range(3))
    stage, total = ({name: [] for name in localizers} for _ in range(2))
    for simulated in trial_frames(trial):
        truths = {truth.target: truth for truth in simulated.truths}
        for name, localizer in localizers.items():
            with _stage_time(stage[name]):
                start = time.process_time()
                result = localizer.process(simulated.frame)
                total[name].append(1000 * (time.process_time() - start))
            errors = [
                corner_error(r.homography.H, truths[r.name].H, _size(images, r.name), size, simulated.frame.camera)
                if r.name in truths
                else np.inf
                for r in result
                if r.homography is not None
            ]
            found[name].append(sum(e <= FALSE_PX for e in errors))
            false[name].append(any(e > FALSE_PX for e in errors))
            corners[name] += [e for e in errors if e <= FALSE_PX]
    for name in localizers:
        f = PipelineFigures(
            name,
            condition,
            len(found[name]),
            sum(found[name]),
            sum(false[name]),
            float(np.median(corners[name])) if corners[name] else float("nan"),
            float(np.mean(stage[name])),
            float(np.mean(total[name])),
        )
        print(
            f"pipeline, {condition:16} {name:18} found {f.found:3} of {f.frames}, false {f.false}, corner "
            f"{f.corner_px:.3f} px, {f.ms:6.2f} ms of {f.frame_ms:6.1f} ms",
            flush=True,
        )
        figures.append(f)
    return figures


@contextmanager
def _stage_time(into: list[float]) -> Iterator[None]:
    """Add the processor time that the robust estimator takes meanwhile, ms."""
    made, spent = robust_fit.homography_estimator, [0.0]

    def timed(parameters: Parameters) -> HomographyEstimator:
        estimator = made(parameters)

        def estimate(*given: Any, **named: Any) -> RobustHomography:
            start = time.process_time()
            try:
                return estimator(*given, **named)
            finally:
                spent[0] += 1000 * (time.process_time() - start)

        return estimate

    robust_fit.homography_estimator = timed
    try:
        yield
    finally:
        robust_fit.homography_estimator = made
        into.append(spent[0])


def _size(images: Sequence[TargetImage], name: str) -> tuple[int, int]:
    return next((i.pixels.shape[1], i.pixels.shape[0]) for i in images if i.name == name)


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
