# SPDX-License-Identifier: Apache-2.0
"""What wrong matches may do to a homography: nothing. Where they lie, how many, and whether there are any others."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, EstimationError, NoConsensus, TooFewPoints
from imgu_ros.simulate.plane_matches import KINDS, PlaneMatches, plane_matches
from imgu_ros.vision.projective.dlt import homography_dlt
from imgu_ros.vision.projective.estimate import estimate_homography
from imgu_ros.vision.projective.fit import fit_homography
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.transform import transform


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scale", [1.0, 0.4, 0.1, 0.05])
def test_covariance_and_recall_whatever_the_wrong_matches_are(kind: str, scale: float) -> None:
    """NEES 8 expected, a little more as sigma is estimated; of 8 x 2 scenes the mean has a standard error of 1.

    Of errors of 1 px in x and y, exp(-9/2) = 1.1 % lie beyond 3 px.
    """
    squared, recall = [], []
    for share in (0.4, 0.8):
        for seed in range(8):
            given_matches = plane_matches(kind, share, scale, seed)
            estimate = estimate_homography(given_matches.src, given_matches.dst, seed)
            squared.append(given_matches.nees(estimate))
            recall.append(estimate.inliers[given_matches.true].mean())
    assert 5 < np.mean(squared) < (14 if kind == "near" else 11)  # near ones hide among the true ones
    assert np.mean(recall) > 0.975


@pytest.mark.parametrize(("noise", "recall"), [(0.3, 1.0), (1.0, 0.989), (1.5, 0.865)])
def test_the_covariance_allows_for_what_the_threshold_cuts_off(noise: float, recall: float) -> None:
    """1.5 px against a threshold of 3: an eighth of the true matches are beyond, and the others look too good."""
    squared, kept = [], []
    for seed in range(40):
        given_matches = plane_matches("uniform", 0.5, 0.4, seed, noise)
        estimate = estimate_homography(given_matches.src, given_matches.dst, seed)
        squared.append(given_matches.nees(estimate))
        kept.append(estimate.inliers[given_matches.true].mean())
    assert 6 < np.mean(squared) < 10  # standard error 0.6
    assert np.mean(kept) == pytest.approx(recall, abs=0.01)


def test_the_answer_is_that_of_the_inliers_that_are_returned() -> None:
    for seed in range(10):
        given_matches = plane_matches("uniform", 0.5, 0.3, seed)
        estimate = estimate_homography(given_matches.src, given_matches.dst, seed)
        again = fit_homography(given_matches.src[estimate.inliers], given_matches.dst[estimate.inliers])
        assert_allclose(estimate.H, again.H, atol=1e-9)
        assert estimate.rms_px == pytest.approx(again.rms_px, rel=1e-6)
        ratio = (
            estimate.covariance[np.abs(again.covariance) > 1e-12] / again.covariance[np.abs(again.covariance) > 1e-12]
        )
        assert ratio.min() >= 1 and np.ptp(ratio) < 1e-3  # the same but for one factor: the share cut off
        mapped = np.hypot(*(transform(estimate.H, given_matches.src) - given_matches.dst).T)
        assert np.array_equal(mapped <= 3, estimate.inliers)


@pytest.mark.parametrize("score", ["biweight", "truncated"])
@pytest.mark.parametrize(
    ("count", "threshold", "extent"),
    [(5, 3, (640, 480)), (8, 10, (3000, 60)), (12, 10, (100, 100)), (20, 1, (4000, 3000)), (60, 3, (640, 480)),
     (60, 10, (100, 100)), (300, 10, (640, 480)), (1000, 3, (640, 480))],
)  # fmt: skip
def test_random_pairs_agree_on_nothing(score: str, count: int, threshold: float, extent: tuple[int, int]) -> None:
    """benchmarks/robust_homography.py repeats this thousands of times."""
    runs = 1 if count == 1000 and score == "biweight" else 12 if count < 100 else 4
    for seed in range(runs):
        rng = np.random.default_rng((seed, count))
        src, dst = rng.uniform(0, 1, (count, 2)) * extent, rng.uniform(0, 1, (count, 2)) * extent
        with pytest.raises((NoConsensus, DegenerateConfiguration)):
            estimate_homography(src, dst, rng, threshold_px=threshold, score=score, max_iterations=500)


def test_chance_is_named_with_how_many_would_be_no_chance() -> None:
    given_matches = plane_matches("uniform", 0.5, 1.0, 0, true=6)
    rng = np.random.default_rng(0)
    src = np.vstack((given_matches.src, rng.uniform(0, 1000, (2000, 2))))
    dst = np.vstack((given_matches.dst, rng.uniform(0, 1000, (2000, 2))))
    with pytest.raises(NoConsensus, match=r"as many agree by chance; need \d+") as caught:
        estimate_homography(src, dst, 0, threshold_px=3, max_iterations=200, score="truncated")
    assert caught.value.inliers >= 5
    # The caller who knows better says so.
    model = HomographyModel(src, dst)
    assert model.count == 2012
    found = estimate_homography(src, dst, 0, max_by_chance=math.inf, max_iterations=200, score="truncated")
    assert np.count_nonzero(found.inliers) >= 5


@pytest.mark.parametrize("true", [7, 9])
def test_few_true_matches_among_few_wrong_ones_are_no_chance(true: int) -> None:
    for seed in range(10):
        given_matches = plane_matches("uniform", 0.5, 0.5, seed, noise=0.5, true=true)
        estimate = estimate_homography(given_matches.src, given_matches.dst, seed)
        assert estimate.inliers[given_matches.true].all() and given_matches.corner_error(estimate.H) < 20


def test_one_match_many_times_is_one_match() -> None:
    """Five matches that agree by chance, one of them fifty times, are five; so are near copies."""
    rng = np.random.default_rng(1)
    H = plane_matches("uniform", 0.0, 0.6, 1).H
    src = rng.uniform(0, 1000, (400, 2))
    dst = rng.uniform(0, 1000, (400, 2))
    dst[:5] = transform(H, src[:5]) + rng.normal(0, 1, (5, 2))
    for jitter in (0.0, 0.3):
        copies = np.repeat([0], 50)
        many_src = np.vstack((src, src[copies] + rng.normal(0, jitter, (50, 2))))
        many_dst = np.vstack((dst, dst[copies] + rng.normal(0, jitter, (50, 2))))
        with pytest.raises(NoConsensus, match="as many agree by chance"):
            estimate_homography(many_src, many_dst, 0, score="truncated")
    # True ones are found all the same, however often one is repeated.
    given_matches = plane_matches("uniform", 0.5, 0.4, 2)
    repeated = np.concatenate((np.arange(200), np.repeat(np.flatnonzero(~given_matches.true)[:1], 500)))
    estimate = estimate_homography(given_matches.src[repeated], given_matches.dst[repeated], 0)
    assert given_matches.corner_error(estimate.H) < 2


def test_mirrored_planes_where_they_are_allowed() -> None:
    """A map with y up, seen by a camera with y down."""
    for seed in range(5):
        given_matches = plane_matches("uniform", 0.5, 0.4, seed)
        up = given_matches.src * [1, -1] + [0, 1000]
        to_up = np.array([[1, 0, 0], [0, -1, 1000], [0, 0, 1.0]])
        with pytest.raises(DegenerateConfiguration, match=r'mirrored .*orientation="mirrored" or "any"'):
            estimate_homography(up, given_matches.dst, seed)
        front = estimate_homography(given_matches.src, given_matches.dst, seed)
        for orientation in ("mirrored", "any"):
            estimate = estimate_homography(up, given_matches.dst, seed, orientation=orientation)
            assert (
                np.linalg.det(estimate.H) < 0
                and (up @ estimate.H[2, :2] + estimate.H[2, 2])[given_matches.true].min() > 0
            )
            known = PlaneMatches(
                given_matches.H @ to_up / np.linalg.norm(given_matches.H @ to_up), up, given_matches.dst, front.inliers
            )
            assert known.nees(estimate) < 26  # 99.9 % of chi-squared of 8
            assert np.array_equal(estimate.inliers, front.inliers)
            assert_allclose(transform(estimate.H, up), transform(front.H, given_matches.src), atol=1e-5)
        with pytest.raises(DegenerateConfiguration, match=r'from its front; need orientation="front"'):
            estimate_homography(given_matches.src, given_matches.dst, seed, orientation="mirrored")
        assert_allclose(
            estimate_homography(given_matches.src, given_matches.dst, seed, orientation="any").H, front.H, atol=1e-6
        )


def test_mirrored_planes_in_a_plain_fit() -> None:
    given_matches = plane_matches("uniform", 0.0, 0.4, 0)
    src, dst = given_matches.src, given_matches.dst
    front = fit_homography(src, dst)
    flipped = src * [-1, 1]
    with pytest.raises(DegenerateConfiguration, match="mirrored"):
        fit_homography(flipped, dst)
    for start in (None, front.H * [-1, 1, 1]):
        for orientation in ("mirrored", "any"):
            estimate = fit_homography(flipped, dst, orientation=orientation, start=start)
            assert_allclose(estimate.H, front.H * [-1, 1, 1], atol=1e-9)
            signs = np.tile([-1, 1, 1], 3)
            assert_allclose(estimate.covariance, front.covariance * np.outer(signs, signs), rtol=1e-5, atol=1e-18)
    with pytest.raises(DegenerateConfiguration, match="front"):
        fit_homography(src, dst, orientation="mirrored")


def test_four_exact_points() -> None:
    """`fit_homography` takes them, with the covariance of errors of 1 px; nothing tells a robust estimate anything."""
    src = np.array([[0, 0], [200, 10], [190, 180], [-5, 210]])
    H = plane_matches("uniform", 0.0, 0.3, 0).H
    four = fit_homography(src, transform(H, src))
    assert_allclose(four.H, H, atol=1e-10)
    assert np.array_equal(four.covariance, fit_homography(src, transform(H, src), noise_px=1.0).covariance)
    errors = [PlaneMatches(H, src, src, np.ones(4, bool)).nees(
        fit_homography(src, transform(H, src) + np.random.default_rng(s).normal(0, 1, (4, 2)), error="transfer")
    ) for s in range(200)]  # fmt: skip
    assert np.mean(errors) == pytest.approx(8, abs=1)
    with pytest.raises(TooFewPoints, match="at least 5, or fit_homography"):
        estimate_homography(src, transform(H, src), 0)
    five = np.vstack((src, [[90, 100]]))
    assert_allclose(estimate_homography(five, transform(H, five), 0).H, H, atol=1e-9)


finite = st.floats(-1e9, 1e9)


@given(st.lists(st.tuples(finite, finite, finite, finite), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_matches_of_weight_0_change_nothing(added: list[tuple[float, ...]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    given_matches = plane_matches("uniform", 0.0, 0.5, seed % 100, true=12)
    weights = rng.uniform(0.1, 1, 12)
    extra = np.array(added)
    at = rng.integers(0, 13, len(extra))
    src = np.insert(given_matches.src, at, extra[:, :2], axis=0)
    dst = np.insert(given_matches.dst, at, extra[:, 2:], axis=0)
    w = np.insert(weights, at, 0.0)
    assert_allclose(
        homography_dlt(src, dst, w), homography_dlt(given_matches.src, given_matches.dst, weights), atol=1e-12
    )
    model = HomographyModel(src, dst)
    fitted = model.refit_weighted(np.eye(3)[None], w[None])
    alone = HomographyModel(given_matches.src, given_matches.dst)
    expected = alone.refit_weighted(np.eye(3)[None], weights[None])
    assert len(fitted) == len(expected) == 1


def test_too_few_of_weight_above_0() -> None:
    given_matches = plane_matches("uniform", 0.0, 0.5, 0, true=6)
    with pytest.raises(TooFewPoints, match="weights: 3 above 0"):
        homography_dlt(given_matches.src, given_matches.dst, [1, 1, 1, 0, 0, 0])


def similarity(scale: float, angle: float, shift: tuple[float, float]) -> np.ndarray:
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    return np.array([[c, -s, shift[0]], [s, c, shift[1]], [0, 0, 1.0]])


@given(
    st.floats(-6, 6), st.floats(-3, 3), st.floats(-1e6, 1e6), st.booleans(), st.sampled_from(["biweight", "truncated"])
)
def test_a_change_of_coordinates_changes_no_inlier(
    log_scale: float, angle: float, shift: float, of_dst: bool, score: str
) -> None:
    """Of either side; the error is that in dst, since the others compare the units of both sides."""
    given_matches = plane_matches("million", 0.5, 0.3, 4, true=40)
    S = similarity(10.0**log_scale, angle, (shift * 10.0**log_scale, -shift * 10.0**log_scale))
    plain = estimate_homography(given_matches.src, given_matches.dst, 0, score=score, error="transfer")
    src, dst = given_matches.src, given_matches.dst
    threshold = 3.0
    if of_dst:
        dst, threshold = transform(S, dst), threshold * 10.0**log_scale
        expected = normalised_homography(S @ plain.H)
    else:
        src = transform(S, src)
        expected = normalised_homography(plain.H @ np.linalg.inv(S))
    moved = estimate_homography(src, dst, 0, score=score, threshold_px=threshold, error="transfer")
    assert np.array_equal(moved.inliers, plain.inliers)
    places = given_matches.src[given_matches.true]
    unit = 10.0**log_scale if of_dst else 1.0
    mapped = transform(moved.H, places if of_dst else transform(S, places))
    assert_allclose(mapped / unit, transform(expected, places if of_dst else transform(S, places)) / unit, atol=1e-4)


def test_the_order_of_the_matches_changes_no_inlier() -> None:
    for kind in ("uniform", "clump"):
        given_matches = plane_matches(kind, 0.5, 0.3, 3)
        plain = estimate_homography(given_matches.src, given_matches.dst, 0)
        for seed in range(4):
            order = np.random.default_rng(seed).permutation(len(given_matches.src))
            other = estimate_homography(given_matches.src[order], given_matches.dst[order], 0)
            assert np.array_equal(other.inliers, plain.inliers[order])
            assert_allclose(other.H, plain.H, atol=1e-9)


def test_lines_of_matches() -> None:
    """On two lines a homography is determined; on one it is not, whatever wrong matches agree beside it."""
    rng = np.random.default_rng(0)
    H = plane_matches("uniform", 0.0, 0.6, 0).H
    t = rng.uniform(0, 1000, 60)
    two = np.vstack((np.column_stack((t[:30], 200 + 0.3 * t[:30])), np.column_stack((t[30:], 800 - 0.2 * t[30:]))))
    wrong = rng.uniform(0, 1000, (40, 4))
    src = np.vstack((two, wrong[:, :2]))
    dst = np.vstack((transform(H, two) + rng.normal(0, 0.3, (60, 2)), wrong[:, 2:]))
    estimate = estimate_homography(src, dst, 0)
    assert estimate.inliers[:60].all()
    assert PlaneMatches(H, src, dst, estimate.inliers).corner_error(estimate.H) < 2
    one = np.column_stack((t, 200 + 0.3 * t))
    for seed in range(6):
        wrong = np.random.default_rng(seed).uniform(0, 1000, (60, 4))
        src = np.vstack((one, wrong[:, :2]))
        dst = np.vstack((transform(H, one) + rng.normal(0, 0.3, (60, 2)), wrong[:, 2:]))
        with pytest.raises(EstimationError):
            estimate_homography(src, dst, seed)


@pytest.mark.parametrize("dtype", [np.float32, np.int64])
def test_other_types_of_numbers(dtype: type) -> None:
    given_matches = plane_matches("uniform", 0.5, 0.5, 5)
    src, dst = given_matches.src.astype(dtype), given_matches.dst.astype(dtype)
    estimate = estimate_homography(src, dst, 0)
    assert given_matches.corner_error(estimate.H) < 2
    assert np.array_equal(estimate.H, estimate_homography(src.astype(float), dst.astype(float), 0).H)
