# SPDX-License-Identifier: Apache-2.0
"""Consensus on a model of the test's own: a line through points of the plane."""

import numpy as np
import pytest

from imgu_ros.errors import NoConsensus, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Indices, Mask
from imgu_ros.vision.estimation.ransac import iterations_needed, ransac


class Line:
    """a x + b y + c = 0 with a^2 + b^2 = 1, as rows (B, 3)."""

    sample_size = 2

    def __init__(self, points: Floats) -> None:
        self.points = points

    @property
    def count(self) -> int:
        return len(self.points)

    def generate(self, samples: Indices) -> Floats:
        p, q = self.points[samples[:, 0]], self.points[samples[:, 1]]
        normal = np.column_stack((p[:, 1] - q[:, 1], q[:, 0] - p[:, 0]))
        length = np.linalg.norm(normal, axis=1)
        good = length > 1e-12
        normal = normal[good] / length[good][:, None]
        return np.column_stack((normal, -np.einsum("bi,bi->b", normal, p[good])))

    def squared_errors(self, hypotheses: Floats) -> Floats:
        return (hypotheses[:, :2] @ self.points.T + hypotheses[:, 2:]) ** 2

    def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
        points = self.points[inliers]
        centre = points.mean(axis=0)
        normal = np.linalg.svd(points - centre)[2][1]
        return np.r_[normal, -normal @ centre]


def points_on_a_vertical_line(outliers: int) -> Floats:
    rng = np.random.default_rng(0)
    good = np.column_stack((5 + rng.normal(0, 0.01, 60), rng.uniform(0, 100, 60)))
    return np.concatenate((good, rng.uniform(0, 100, (outliers, 2))))


@pytest.mark.parametrize("outliers", [0, 60, 140])
def test_vertical_line_among_outliers(outliers: int) -> None:
    consensus = ransac(Line(points_on_a_vertical_line(outliers)), 0.05, np.random.default_rng(1))
    a, b, c = consensus.hypothesis
    assert abs(b / a) < 1e-3
    assert -c / a == pytest.approx(5, abs=0.02)
    assert np.count_nonzero(consensus.inliers[:60]) >= 59


def test_as_many_draws_as_the_share_of_inliers_asks_for() -> None:
    """HZ table 4.3: s = 4, 50 % outliers, p = 0.99: 72 samples; s = 2, 20 %: 5; s = 7, 30 %: 54; s = 8, 50 %: 1177."""
    assert [iterations_needed(1 - e, s, 0.99) for s, e in ((4, 0.5), (2, 0.2), (7, 0.3), (8, 0.5), (3, 0.4))] == [
        72,
        5,
        54,
        1177,
        19,
    ]
    assert iterations_needed(1.0, 4, 0.99) == 1
    assert iterations_needed(0.0, 4, 0.99) > 10**15
    consensus = ransac(Line(points_on_a_vertical_line(60)), 0.05, np.random.default_rng(2), confidence=0.99)
    assert consensus.iterations <= 64  # one batch: 17 were enough


def test_bounds() -> None:
    model = Line(np.random.default_rng(3).uniform(0, 1e6, (50, 2)))
    with pytest.raises(NoConsensus, match=r"after 100 samples; need 10"):
        ransac(model, 1e-3, np.random.default_rng(0), max_iterations=100, min_inliers=10)
    with pytest.raises(TooFewPoints):
        ransac(Line(np.zeros((1, 2))), 1.0, np.random.default_rng(0))
    with pytest.raises(NoConsensus):
        ransac(Line(np.zeros((9, 2))), 1.0, np.random.default_rng(0), max_iterations=50)
    with pytest.raises(ShapeError, match="threshold"):
        ransac(model, 0.0, np.random.default_rng(0))


HZ_TABLE_4_3 = {  # sample size: samples at 5, 10, 20, 25, 30, 40, 50 % outliers, p = 0.99
    2: (2, 3, 5, 6, 7, 11, 17),
    3: (3, 4, 7, 9, 11, 19, 35),
    4: (3, 5, 9, 13, 17, 34, 72),
    5: (4, 6, 12, 17, 26, 57, 146),
    6: (4, 7, 16, 24, 37, 97, 293),
    7: (4, 8, 20, 33, 54, 163, 588),
    8: (5, 9, 26, 44, 78, 272, 1177),
}


@pytest.mark.parametrize("size", HZ_TABLE_4_3)
def test_table_of_hartley_and_zisserman(size: int) -> None:
    shares = (0.05, 0.1, 0.2, 0.25, 0.3, 0.4, 0.5)
    assert tuple(iterations_needed(1 - e, size, 0.99) for e in shares) == HZ_TABLE_4_3[size]


def test_biweight_depends_less_on_the_threshold() -> None:
    """A model without a weighted fit of its own; thresholds from a third of the right one to three times it."""
    points = points_on_a_vertical_line(60)
    spread = {}
    for score in ("truncated", "biweight"):
        offsets = [
            -c / a
            for t in (0.01, 0.03, 0.1)
            for a, _, c in [ransac(Line(points), t, np.random.default_rng(4), score=score).hypothesis]
        ]
        assert np.abs(np.array(offsets) - 5).max() < 0.05
        spread[score] = np.ptp(offsets)
    assert spread["biweight"] <= spread["truncated"] + 0.005


def test_hypotheses_that_cannot_be_refitted_are_passed_over() -> None:
    class Strict(Line):
        def refit(self, hypothesis: Floats, inliers: Mask) -> Floats:
            if np.count_nonzero(inliers) < 20:
                raise TooFewPoints("inliers: too few")
            return super().refit(hypothesis, inliers)

    consensus = ransac(Strict(points_on_a_vertical_line(60)), 0.05, np.random.default_rng(5), score="biweight")
    assert -consensus.hypothesis[2] / consensus.hypothesis[0] == pytest.approx(5, abs=0.02)
    assert np.count_nonzero(consensus.inliers[:60]) >= 59


def test_unknown_choices() -> None:
    model = Line(points_on_a_vertical_line(0))
    with pytest.raises(ShapeError, match="truncated"):
        ransac(model, 0.1, np.random.default_rng(0), score="best")
    with pytest.raises(ShapeError, match="prosac"):
        ransac(model, 0.1, np.random.default_rng(0), sampler="best")
    with pytest.raises(ShapeError, match="inlier_share"):
        iterations_needed(1.5, 4, 0.99)
