# SPDX-License-Identifier: Apache-2.0
"""Robust homographies from real tentative matches, and a simulated twin that is never skipped."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from imgu_ros.errors import EstimationError
from imgu_ros.vision.matching.nearest import match
from imgu_ros.vision.projective.estimate import estimate_homography
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.transform import transform


@dataclass(frozen=True)
class Tentative:
    src: np.ndarray
    dst: np.ndarray
    true: np.ndarray
    #: Smaller is better.
    rank: np.ndarray

    def shuffled(self, seed: int) -> Tentative:
        p = np.random.default_rng(seed).permutation(len(self.src))
        return Tentative(self.src[p], self.dst[p], self.true[p], self.rank[p])

    def ranked(self) -> Tentative:
        p = np.argsort(self.rank, kind="stable")
        return Tentative(self.src[p], self.dst[p], self.true[p], self.rank[p])

    def rmse(self, H: np.ndarray) -> float:
        return float(np.sqrt(((transform(H, self.src[self.true]) - self.dst[self.true]) ** 2).sum(axis=1).mean()))


def evd(data: Path, name: str) -> Tentative:
    path = data / "homography" / "evd" / f"{name}_pts.txt"
    if not path.exists():
        pytest.skip(f"{path} is missing")
    rows = np.array(
        [[float(x) for x in (*line.split()[:6], line.split()[8])] for line in path.read_text().splitlines()]
    )
    return Tentative(rows[:, :2], rows[:, 2:4], rows[:, 6] == 1, rows[:, 4])


def simulated(seed: int) -> Tentative:
    """25 % inliers, most of them in the better half of the ranking."""
    rng = np.random.default_rng(seed)
    H = np.array([[0.8, -0.3, 200.0], [0.25, 0.9, 50.0], [2e-4, -1e-4, 1.0]])
    src = rng.uniform(0, 800, (400, 2))
    dst = np.where(
        np.arange(400)[:, None] < 100, transform(H, src) + rng.normal(0, 0.7, (400, 2)), rng.uniform(0, 800, (400, 2))
    )
    true = np.arange(400) < 100
    return Tentative(src, dst, true, rng.uniform(0, 1, 400) + np.where(true, 0, 0.6))


def errors_and_draws(cases: list[Tentative], sampler: str, score: str) -> tuple[np.ndarray, np.ndarray]:
    """Of ten fits of each case, shuffled first; PROSAC then sorts by rank."""
    errors, draws = [], []
    for case in cases:
        for seed in range(10):
            matches = case.shuffled(seed)
            matches = matches.ranked() if sampler == "prosac" else matches
            try:
                found = estimate_homography(
                    matches.src, matches.dst, np.random.default_rng(seed), sampler=sampler, score=score
                )
            except EstimationError:
                errors.append(np.inf)
                draws.append(2000)
            else:
                errors.append(matches.rmse(found.H))
                draws.append(found.iterations)
    return np.array(errors), np.array(draws)


def require_fewer_draws_and_no_worse(cases: list[Tentative], score: str = "truncated") -> None:
    uniform, many = errors_and_draws(cases, "uniform", score)
    prosac, few = errors_and_draws(cases, "prosac", score)
    assert few.sum() < many.sum()
    assert np.median(prosac) <= np.median(uniform) + 0.05
    assert np.mean(prosac <= 5) >= np.mean(uniform <= 5)


def test_prosac_on_simulated_matches() -> None:
    require_fewer_draws_and_no_worse([simulated(0), simulated(1)])


def test_prosac_on_extreme_views(data_dir: Path) -> None:
    """Ranked by s1, the published ratio of distances."""
    require_fewer_draws_and_no_worse([evd(data_dir, name) for name in ("adam", "face", "graf")], "truncated")


def test_prosac_on_our_matches(data_dir: Path) -> None:
    """`bark` 1-2, 1-4 and `graf` 1-3 ranked by our ratio of distances."""
    cv2 = pytest.importorskip("cv2")
    folder = data_dir / "homography"
    if not folder.exists():
        pytest.skip(f"{folder} is missing")
    storage = cv2.FileStorage(str(folder / "graf" / "H1to3p.xml"), cv2.FILE_STORAGE_READ)
    pairs = [
        (folder / "graf" / "graf1.png", folder / "graf" / "graf3.png", storage.getFirstTopLevelNode().mat()),
        *(
            (folder / "bark" / "img1.ppm", folder / "bark" / f"img{k}.ppm", np.loadtxt(folder / "bark" / f"H1to{k}p"))
            for k in (2, 4)
        ),
    ]
    cases = []
    for first, second, H in pairs:
        found = []
        for path in (first, second):
            picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            keypoints, descriptors = cv2.ORB.create(800).detectAndCompute(picture, None)
            found.append((np.array([k.pt for k in keypoints]), descriptors))
        (xy1, d1), (xy2, d2) = found
        matches = match(d1, d2, "hamming", 0.95, mutual=True)
        src, dst = xy1[matches.index_src], xy2[matches.index_dst]
        true = np.hypot(*(transform(H, src) - dst).T) < 3
        cases.append(Tentative(src, dst, true, np.arange(len(src), dtype=float)))  # they come best first
    require_fewer_draws_and_no_worse(cases)


@pytest.mark.parametrize("name", ["adam", "face", "fox", "graf"])
def test_extreme_views_are_found(data_dir: Path, name: str) -> None:
    case = evd(data_dir, name)
    errors = []
    for seed in range(3):
        matches = case.shuffled(seed)
        errors.append(matches.rmse(estimate_homography(matches.src, matches.dst, np.random.default_rng(seed)).H))
    assert np.median(errors) < 3.5


def test_few_inliers_among_simulated_matches() -> None:
    """One in eight is right: within the draws allowed, the thorough score finds it more often."""
    found = {"truncated": 0, "biweight": 0}
    for seed in range(6):
        case = simulated(seed)
        few = np.r_[:30, 100:310]
        for score in found:
            try:
                H = estimate_homography(
                    case.src[few], case.dst[few], np.random.default_rng(seed), score=score, max_iterations=2000
                ).H
            except EstimationError:
                continue
            found[score] += case.rmse(H) < 3
    assert found["biweight"] >= 5
    assert found["biweight"] >= found["truncated"]


def test_weighted_fits_of_many_hypotheses_at_once() -> None:
    """Weights of 0 and 1 around the truth give the least-squares homography of those points."""
    case = simulated(2)
    model = HomographyModel(case.src, case.dst, symmetric=True)
    samples = np.array([[0, 1, 2, 3], [4, 5, 6, 7]])
    hypotheses = model.generate(samples)
    for _ in range(8):
        hypotheses = model.refit_weighted(hypotheses, np.tile(case.true.astype(float), (len(hypotheses), 1)))
    for hypothesis in hypotheses:
        assert case.rmse(model.denormalised(hypothesis)) < 1.1
