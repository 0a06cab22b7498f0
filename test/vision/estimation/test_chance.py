# SPDX-License-Identifier: Apache-2.0
"""Consensus and chance: wrong data agree on nothing, whatever the model; far data do no harm; weight 0 is none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import binom

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, TooFewPoints
from imgu_ros.vision.camera.camera_model import estimate_projection
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.pose_estimate import estimate_pose
from imgu_ros.vision.camera.rotation import exp_so3, log_so3
from imgu_ros.vision.camera.rotation_model import estimate_rotation
from imgu_ros.vision.estimation.chance import Agreement, binomial_tail, pair_probability, shares_of_places
from imgu_ros.vision.estimation.directions import DirectionsModel, align_directions
from imgu_ros.vision.estimation.line import LineModel, fit_line
from imgu_ros.vision.estimation.ransac import ransac

FRAME = np.array([1280.0, 720.0])
CAMERA = make_camera([[900, 0, 640], [0, 900, 360], [0, 0, 1]], (), "plumb_bob", 1280, 720)
R, T = exp_so3([0.3, 0.2, -0.4]), np.array([0.1, 0, 4.0])

Draw = Callable[[int, np.random.Generator], object]
RANDOM: dict[str, Draw] = {
    "line": lambda n, rng: ransac(LineModel(rng.uniform(0, 1, (n, 2)) * FRAME), 3.0, rng),
    "line in a strip": lambda n, rng: ransac(LineModel(rng.uniform(0, 1, (n, 2)) * [2000, 60]), 3.0, rng),
    "directions": lambda n, rng: ransac(
        DirectionsModel(rng.normal(size=(n, 3)), rng.normal(size=(n, 3))), 0.01, rng, max_iterations=500
    ),
    "rotation": lambda n, rng: estimate_rotation(
        rng.uniform(0, 1, (n, 2)) * FRAME, rng.uniform(0, 1, (n, 2)) * FRAME, CAMERA, CAMERA, rng, max_iterations=500
    ),
    "pose": lambda n, rng: estimate_pose(
        rng.uniform(-1, 1, (n, 3)), rng.uniform(0, 1, (n, 2)) * FRAME, CAMERA, rng, max_iterations=100
    ),
    "projection": lambda n, rng: estimate_projection(
        rng.uniform(-1, 1, (n, 3)), rng.uniform(0, 1, (n, 2)) * FRAME, rng, max_iterations=200
    ),
}


@pytest.mark.parametrize("kind", RANDOM)
@pytest.mark.parametrize("count", [7, 20, 60])
def test_random_data_agree_on_nothing(kind: str, count: int) -> None:
    for seed in range(25):
        with pytest.raises((NoConsensus, DegenerateConfiguration)):
            RANDOM[kind](count, np.random.default_rng(seed))


@pytest.mark.parametrize("far", [1e3, 1e5, 1e8])
def test_far_data_do_no_harm(far: float) -> None:
    """To poses, camera matrices and rotations; a third of the matches are far away on either side."""
    squared = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        points = rng.uniform(-1, 1, (60, 3))
        pixels = CAMERA.project(points @ R.T + T) + rng.normal(0, 0.7, (60, 2))
        pixels[:15] = rng.uniform(-far, far, (15, 2))
        points[15:17] = far
        estimate = estimate_pose(points, pixels, CAMERA, seed)
        pose = estimate.pose
        assert estimate.inliers[17:].all()
        error = np.r_[T - pose.t, log_so3(R @ pose.R.T)]
        squared.append(error @ np.linalg.solve(pose.covariance, error))
        assert estimate_projection(points, pixels, seed).inliers[17:].all()
        src = rng.uniform(200, 500, (60, 2))
        turned = np.column_stack((CAMERA.undistort(src)[0], np.ones(60))) @ exp_so3([0.05, 0.2, 0.3]).T
        dst = CAMERA.project(turned) + rng.normal(0, 0.7, (60, 2))
        dst[:15] = rng.uniform(-far, far, (15, 2))
        assert estimate_rotation(src, dst, CAMERA, CAMERA, seed).inliers[15:].all()
        line = np.column_stack((rng.uniform(0, 100, 40), rng.normal(0, 0.5, 40)))
        line = np.vstack((line, rng.uniform(-far, far, (20, 2))))
        assert ransac(LineModel(line), 2.0, seed).inliers[:40].all()
    assert np.mean(squared) < 12  # chi-squared of 6


def test_the_covariance_of_a_pose_allows_for_what_the_threshold_cuts_off() -> None:
    squared = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        points = rng.uniform(-1, 1, (60, 3))
        pixels = CAMERA.project(points @ R.T + T) + rng.normal(0, 1.4, (60, 2))
        pose = estimate_pose(points, pixels, CAMERA, seed).pose
        error = np.r_[T - pose.t, log_so3(R @ pose.R.T)]
        squared.append(error @ np.linalg.solve(pose.covariance, error))
    assert 4.5 < np.mean(squared) < 8  # 6 expected, standard error 0.5; 11 without


@given(st.integers(0, 60), st.integers(-2, 70), st.floats(0, 1))
def test_binomial_tail_is_that_of_scipy(count: int, successes: int, probability: float) -> None:
    assert_allclose(
        binomial_tail(count, successes, probability), binom.sf(successes - 1, count, probability), atol=1e-12
    )


def test_expected_by_chance_is_what_random_agreement_gives() -> None:
    """20 of 200 within the threshold, each with probability 0.05, one hypothesis: no more than chance; 40: far more."""

    def expected(agreeing: int, tested: int = 1) -> float:
        ratios = np.where(np.arange(200) < agreeing, 0.9, 2.0)
        return Agreement(np.ones(200), ratios, 4, 1, 0.05).expected_by_chance(tested)

    assert expected(20) > 1 and expected(60) < 1e-6
    assert expected(60, 1000) == pytest.approx(1000 * expected(60))
    assert expected(4) == np.inf
    agreement = Agreement(np.ones(200), np.zeros(200), 4, 1, 0.05)
    needed = agreement.needed(1000, 1e-3)
    assert expected(needed, 1000) <= 1e-3 < expected(needed - 1, 1000)
    # What agrees much better than the threshold asks says more.
    ratios = np.where(np.arange(200) < 20, 0.05, 2.0)
    assert Agreement(np.ones(200), ratios, 4, 1, 0.05).expected_by_chance(1) < 1e-6
    # Five of five within a large threshold are chance, and exactly so are not.
    assert Agreement(np.ones(5), np.full(5, 0.9), 4, 2, 0.01).expected_by_chance(5) > 1e-3
    assert Agreement(np.ones(5), np.full(5, 1e-4), 4, 2, 0.01).expected_by_chance(5) < 1e-3
    assert Agreement(np.ones(5), np.zeros(5), 4, 2, 0.01).needed(5, 1e-3) == 6


def test_probability_of_wrong_pairs_is_the_share_of_the_area() -> None:
    rng = np.random.default_rng(0)
    for extent in ((640, 480), (3000, 60)):
        for threshold in (1.0, 10.0):
            a, b = rng.uniform(0, 1, (2, 400, 2)) * extent
            share = np.pi * threshold**2 / (extent[0] * extent[1])
            assert share / 2 < pair_probability(a, b, threshold) < 2 * share
            far = np.vstack((b[:200], b[200:] + 1e6))
            assert share / 4 < pair_probability(a, far, threshold) < share


def test_shares_against_all_distances() -> None:
    rng = np.random.default_rng(1)
    for spread in ((100, 1), (1, 100), (30, 30)):
        points = rng.uniform(0, 1, (300, 2)) * spread
        near = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) <= 1.5
        assert_allclose(shares_of_places(points, 1.5), 1 / near.sum(axis=1))


places = st.tuples(*[st.floats(-1e9, 1e9)] * 2)


@given(st.lists(places, min_size=1, max_size=4), st.integers(0, 1000))
def test_what_has_no_weight_changes_nothing(added: list[tuple[float, float]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.column_stack((rng.uniform(0, 50, 9), rng.normal(0, 1, 9)))
    weights = rng.uniform(0.1, 1, 9)
    at = rng.integers(0, 10, len(added))
    a, b = fit_line(points, weights), fit_line(np.insert(points, at, added, axis=0), np.insert(weights, at, 0.0))
    assert_allclose(a.line, b.line, rtol=1e-12, atol=1e-12)
    assert_allclose(a.covariance, b.covariance, rtol=1e-10, atol=1e-15)
    assert a.rms == pytest.approx(b.rms, rel=1e-12)
    src, dst = rng.normal(size=(2, 9, 3))
    extra = np.column_stack((added, np.zeros(len(added)))) * rng.integers(0, 2)  # some are no directions at all
    turned = align_directions(
        np.insert(src, at, extra, axis=0), np.insert(dst, at, extra, axis=0), np.insert(weights, at, 0.0)
    )
    assert_allclose(turned, align_directions(src, dst, weights), atol=1e-12)


def test_too_few_of_weight_above_0() -> None:
    with pytest.raises(TooFewPoints, match="weights: 1 above 0"):
        fit_line([[0, 0], [1, 1], [2, 2]], [1, 0, 0])
    with pytest.raises(TooFewPoints, match="weights: 1 above 0"):
        align_directions(np.eye(3), np.eye(3), [1, 0, 0])
