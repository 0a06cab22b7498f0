# SPDX-License-Identifier: Apache-2.0
"""Every choice of the pipeline beside every other one, on a short simulated bag: a pairwise covering array.

Most faults of options that meet need two of them (Kuhn, Wallace & Gallo 2004): runs in which every pair of values
appears find them, with some fifty runs for some hundred million combinations.
"""

from __future__ import annotations

import csv
import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest

from imgu_ros.config.checks import method_conflict
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import (
    DescriptorParameters,
    KeypointsParameters,
    MatchingParameters,
    Parameters,
    PreprocessParameters,
    PyramidParameters,
    declaration,
    declarations,
)
from imgu_ros.config.values import parameters_from
from imgu_ros.reference.templates import TargetImage
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.simulate.path import CameraMotion
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import corner_error, read_truth

SIZE = (400, 300)
TEMPLATE = (640, 480)
FRAMES = 3
#: A path that starts upright, as BRIEF needs it.
SEED = 138
MOST_RUNS = 60

Combination = dict[str, object]

_GROUPS = {
    "keypoints": KeypointsParameters,
    "matching": MatchingParameters,
    "descriptor": DescriptorParameters,
    "pyramid": PyramidParameters,
}
_TOGETHER = ("preprocess.equalisation", "preprocess.edges", "preprocess.threshold")

#: Choices of which some exclude each other.
BOUND = (
    "keypoints.detector", "matching.metric", "descriptor.kind", "pyramid.kind", "preprocess.equalisation",
    "preprocess.edges", "preprocess.threshold",
)  # fmt: skip
#: Choices that go with every choice.
FREE = (
    "demosaic.method", "homography.error", "homography.refine", "pyramid.kernel", "homography.sampler",
    "homography.score", "preprocess.derivative", "matching.guided", "matching.mutual",
    "refinement.enabled", "tracking.enabled",
)  # fmt: skip
#: Each run takes the next choice: a pair with every weak detector would say nothing of the estimator.
IN_TURN = "homography.estimator"
#: Choices about which this bag says nothing: of frames with bands, of a live node, of a lens, of hundredths of a pixel;
#: and what has one value.
ELSEWHERE = {
    "raw.band_mode",
    "image_transport",
    "autostart",
    "publish_tf",
    "camera.rectified",
    "reference",
    "search.thorough",
    "compressed.format",
    "raw.transfer",
}


def values_of(name: str) -> tuple[object, ...]:
    known = declaration(name)
    return known.choices or (True, False)


def works_here(combination: Combination) -> bool:
    """Whether this bag shows that the bound choices work: its frames are darker than the target's picture."""
    return (
        combination["matching.metric"] != "ssd"
        or combination["preprocess.equalisation"] != "none"
        or combination["pyramid.kind"] == "laplacian"
    )


def fitting(run: Combination) -> Combination:
    """Return the numbers that go with a threshold: this bag's light, and smoothing, or noise has corners too."""
    if run["preprocess.threshold"] == "none":
        return {}
    value = 50.0 if run["preprocess.equalisation"] == "none" else 118.0
    return {"preprocess.threshold_value": value, "preprocess.smoothing_px": 1.0}


def bound_combinations() -> list[Combination]:
    """Return those of the bound choices that make sense; built without `parameters_from`, for the sake of time."""
    groups = {
        (name, value): _GROUPS[name.partition(".")[0]](**{name.partition(".")[2]: value})
        for name in BOUND
        for value in values_of(name)
        if name not in _TOGETHER
    }
    found = []
    for chosen in itertools.product(*map(values_of, BOUND)):
        combination = dict(zip(BOUND, chosen, strict=True))
        made = {name.partition(".")[0]: groups[name, combination[name]] for name in BOUND if name not in _TOGETHER}
        preprocess = PreprocessParameters(**{name.partition(".")[2]: combination[name] for name in _TOGETHER})
        if not method_conflict(Parameters(preprocess=preprocess, **made)):
            found.append(combination)
    return found


def covering_array(bound: list[Combination]) -> list[Combination]:
    """Return combinations in which every pair of values that `bound` and `FREE` allow appears; greedily, few."""
    ids = {pair: i for i, pair in enumerate((name, value) for name in (*BOUND, *FREE) for value in values_of(name))}
    pairs = list(ids)
    cores = np.array([[ids[name, combination[name]] for name in BOUND] for combination in bound])
    free = [np.array([ids[name, value] for value in values_of(name)]) for name in FREE]
    missing = np.zeros((len(ids), len(ids)), bool)
    for i, j in itertools.combinations(range(len(BOUND)), 2):
        missing[cores[:, i], cores[:, j]] = True
    for k, values in enumerate(free):
        for others in (np.unique(cores), *free[:k]):
            missing[np.ix_(others, values)] = True
    missing |= missing.T
    used = np.zeros(len(ids), int)
    rows = []
    while missing.any():
        gain = sum(
            missing[cores[:, i], cores[:, j]].astype(int) for i, j in itertools.combinations(range(len(BOUND)), 2)
        )
        # Of those that bring equally many pairs: values that many free ones still wait for.
        wanted = missing[:, np.concatenate(free)].sum(1)[cores].sum(1)
        row = cores[np.lexsort((np.arange(len(cores)), -wanted, -gain))[0]].tolist()
        for values in sorted(free, key=len, reverse=True):
            gain = missing[np.ix_(values, row)].sum(1)
            row.append(int(values[np.lexsort((used[values], -missing[values].sum(1), -gain))[0]]))
        missing[np.ix_(row, row)] = False
        used[row] += 1
        rows.append({pairs[i][0]: pairs[i][1] for i in row})
    return rows


BOUND_COMBINATIONS = bound_combinations()
RUNS = [
    # Black and white images leave few inliers: there the estimator that copes best.
    {**run, IN_TURN: "ransac" if run["preprocess.threshold"] != "none" else estimator}
    for run, estimator in zip(
        covering_array([c for c in BOUND_COMBINATIONS if works_here(c)]),
        itertools.cycle(values_of(IN_TURN)),
        strict=False,
    )
]


def all_pairs(combinations: list[Combination]) -> set[frozenset[tuple[str, object]]]:
    return {frozenset(pair) for c in combinations for pair in itertools.combinations(c.items(), 2)}


@pytest.fixture(autouse=True)
def _no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imgu_ros.replay.reporting.write_report", lambda path, *_: path.touch())


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "bag"
    motion = CameraMotion(turns=0.0, tilt_rad=math.radians(20), zoom=1.2, fill=1.6, drift=0.03)
    simulation = Simulation(width=SIZE[0], height=SIZE[1], frames=FRAMES, rate_hz=15.0, seed=SEED, motion=motion)
    record_simulation(path, simulation, targets=[TargetImage("poster", procedural_texture(*TEMPLATE, seed=SEED), 0.5)])
    return path


def test_every_pair_of_values_is_there() -> None:
    """Of all choices that are declared; what only this bag cannot show is left out, value by value never."""
    choices = {known.name for known in declarations() if known.choices or known.type_name == "bool"}
    assert choices == {*BOUND, *FREE, IN_TURN} | ELSEWHERE
    assert len(RUNS) <= MOST_RUNS
    for run in RUNS:
        parameters_from(run)
    covered = all_pairs(RUNS)
    assert covered >= all_pairs([c for c in BOUND_COMBINATIONS if works_here(c)])
    for name, other in itertools.combinations((*BOUND, *FREE), 2):
        if other in FREE:
            assert all(frozenset(((name, a), (other, b))) in covered for a in values_of(name) for b in values_of(other))
    darker = frozenset((("matching.metric", "ssd"), ("preprocess.equalisation", "none")))
    assert all_pairs(BOUND_COMBINATIONS) - covered <= {darker}


@pytest.mark.parametrize("run", RUNS, ids=lambda run: "-".join(map(str, run.values())))
def test_the_target_is_found(run: Combination, bag: Path, tmp_path: Path) -> None:
    given = read_parameter_file(bag / "params.yaml")
    replay([bag], tmp_path / "out", parameters_from({**given, **run, **fitting(run)}))
    with (tmp_path / "out" / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == FRAMES
    found = 0
    for row, truth in zip(rows, read_truth(bag / "truth.csv"), strict=True):
        if row["status"] not in ("detected", "tracked") and run["preprocess.threshold"] != "none":
            # A black and white picture leaves a search few inliers: the reason says so.
            assert re.search("matches agree|corners are known to|looks as it should|seen too steeply", row["reason"])
            continue
        assert row["status"] in ("detected", "tracked"), row["reason"]
        found += 1
        H = np.array([float(row[f"h{i}{j}"]) for i in "123" for j in "123"]).reshape(3, 3)
        is_aligned = run["refinement.enabled"] or row["status"] == "tracked"
        # Black and white pictures leave a search few inliers.
        assert corner_error(H, truth.H, TEMPLATE, SIZE) < (0.15 if is_aligned else 6)
    assert found >= (FRAMES if run["preprocess.threshold"] == "none" else 1)
