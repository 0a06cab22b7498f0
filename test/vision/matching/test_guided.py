# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError
from imgu_ros.vision.matching.guided import guided_homography, match_guided
from imgu_ros.vision.matching.nearest import match

seeds = st.integers(0, 2**32).map(np.random.default_rng)
VIEW = np.array([[0.9, -0.2, 60.0], [0.25, 1.0, -20.0], [1e-4, -2e-4, 1.0]])


def mapped(H, xy):
    p = np.column_stack((xy, np.ones(len(xy)))) @ H.T
    return p[:, :2] / p[:, 2:]


def differing(a, b):
    return sum((int(x) ^ int(y)).bit_count() for x, y in zip(a, b, strict=True))


def by_loops(src, dst, src_xy, dst_xy, H, radius, ratio, mutual, same_place):
    near = {}
    for i, p in enumerate(mapped(H, src_xy)):
        for j, q in enumerate(dst_xy):
            if math.dist(p, q) <= radius:
                near[i, j] = differing(src[i], dst[j])
    found = {}
    for i in range(len(src)):
        mine = {j: d for (k, j), d in near.items() if k == i}
        if not mine:
            continue
        best = min(mine.values())
        j = min(k for k, d in mine.items() if d == best)
        rivals = [d for k, d in mine.items() if max(abs(dst_xy[k] - dst_xy[j])) > same_place]
        quotient = 0.0 if not rivals else best / min(rivals) if min(rivals) else 1.0
        if (ratio >= 1 or quotient < ratio) and (
            not mutual or best == min(d for (_, column), d in near.items() if column == j)
        ):
            found[i] = (j, best)
    return found


@given(seeds, st.integers(0, 25), st.integers(0, 25), st.sampled_from([0.7, 0.95, 1.0]), st.booleans())
def test_against_loops(rng, n, m, ratio, mutual):
    src, dst = rng.integers(0, 4, (n, 2), np.uint8), rng.integers(0, 4, (m, 2), np.uint8)
    src_xy, dst_xy = rng.uniform(0, 60, (n, 2)), rng.uniform(0, 60, (m, 2))
    H = np.array([[1, 0.1, 2], [-0.1, 0.9, 5], [1e-3, 0, 1]]) * rng.choice([-2.0, 3.0])
    got = match_guided(src, dst, src_xy, dst_xy, H, 20.0, ratio=ratio, mutual=mutual, same_place_px=4.0)
    rows = zip(got.index_src.tolist(), got.index_dst.tolist(), got.distance.tolist(), strict=True)
    assert {i: (j, d) for i, j, d in rows} == by_loops(src, dst, src_xy, dst_xy, H, 20.0, ratio, mutual, 4.0)


@pytest.mark.parametrize("metric", ["euclidean", "cosine", "ssd", "zmssd", "ncc"])
def test_with_a_radius_over_all_it_is_plain_matching(metric):
    rng = np.random.default_rng(1)
    src, dst = (rng.normal(size=(k, 12)).astype(np.float32) for k in (40, 50))
    src_xy, dst_xy = rng.uniform(0, 100, (40, 2)), rng.uniform(0, 100, (50, 2))
    got = match_guided(src, dst, src_xy, dst_xy, np.eye(3), 1e6, metric, 0.9, same_place_px=5.0)
    expected = match(src, dst, metric, 0.9, True, dst_xy, 5.0)
    np.testing.assert_array_equal(got.index_src, expected.index_src)
    np.testing.assert_array_equal(got.index_dst, expected.index_dst)
    np.testing.assert_allclose(got.distance, expected.distance, rtol=1e-9)


def test_what_lies_beyond_the_horizon_is_not_matched():
    H = np.array([[1, 0, 0], [0, 1, 0], [-0.02, 0, 1]])  # the horizon is x = 50
    xy = np.array([[10.0, 0], [20, 5], [30, 3], [90, 0]])
    rows = np.arange(8, dtype=np.uint8).reshape(4, 2)
    got = match_guided(rows, rows, xy, mapped(H, xy), H)
    assert sorted(got.index_src.tolist()) == [0, 1, 2]
    assert sorted(match_guided(rows, rows, xy, mapped(H, xy), -5 * H).index_src.tolist()) == [0, 1, 2]


def scene(seed, noise_px=0.3):
    """A repetitive target: every row has a twin elsewhere, so that matching by rows alone drops or mistakes it."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 500, (300, 2))
    rows = rng.integers(0, 256, (300, 32), np.uint8)
    rows[150:] = rows[:150]  # twins
    view = rows ^ np.packbits(rng.random((300, 256)) < 0.08, axis=1)
    image_xy = mapped(VIEW, xy) + rng.normal(0, noise_px, xy.shape)
    clutter = rng.uniform(-100, 700, (200, 2)), rng.integers(0, 256, (200, 32), np.uint8)
    order = rng.permutation(500)
    image_xy, view = np.vstack([image_xy, clutter[0]])[order], np.vstack([view, clutter[1]])[order]
    return rows, view, xy, image_xy, np.argsort(order)[:300]


def corner_error(H):
    corners = np.array([[0.0, 0], [500, 0], [500, 500], [0, 500]])
    return np.linalg.norm(mapped(H, corners) - mapped(VIEW, corners), axis=1).mean()


@pytest.mark.parametrize("seed", range(4))
def test_matches_lost_to_twins_come_back_and_converge(seed):
    rows, view, xy, image_xy, truth = scene(seed)
    plain = match(rows, view, ratio=0.85)
    assert (plain.index_dst == truth[plain.index_src]).sum() < 130  # by rows alone they are ambiguous or mistaken
    start = VIEW + np.array([[0, 0, 2.0], [0, 0, -1.5], [0, 0, 0]])
    got = guided_homography(rows, view, xy, image_xy, start)
    right = got.matches.index_dst == truth[got.matches.index_src]
    assert right.sum() > 285 and right.mean() > 0.97
    assert corner_error(got.homography.H) < 0.15 < corner_error(start)
    assert 2 <= got.homography.iterations < 10
    # Converged: starting from the answer gives the answer.
    again = guided_homography(rows, view, xy, image_xy, got.homography.H)
    np.testing.assert_array_equal(again.matches.index_dst, got.matches.index_dst)
    np.testing.assert_allclose(again.homography.H, got.homography.H, atol=1e-9)
    inside = np.linalg.norm(
        mapped(got.homography.H, xy[got.matches.index_src]) - image_xy[got.matches.index_dst], axis=1
    )
    np.testing.assert_array_equal(got.homography.inliers, inside <= 3.0)


def test_covariance_agrees_with_the_errors():
    # 25 runs: H's normalised squared error has 8 degrees of freedom.
    total = 0.0
    for seed in range(25):
        rows, view, xy, image_xy, _ = scene(100 + seed)
        estimate = guided_homography(rows, view, xy, image_xy, VIEW).homography
        error = (estimate.H - VIEW / np.linalg.norm(VIEW)).ravel()
        total += error @ np.linalg.pinv(estimate.covariance, rcond=1e-10, hermitian=True) @ error
    assert 6 < total / 25 < 11


def test_no_consensus_and_lines():
    rows, view, xy, image_xy, _ = scene(5)
    with pytest.raises(NoConsensus, match="need 5"):
        guided_homography(rows, view, xy, image_xy + 5000, VIEW)
    xy[:, 1] = 3 * xy[:, 0]
    with pytest.raises(DegenerateConfiguration):
        guided_homography(rows, view[:300], xy, mapped(VIEW, xy), VIEW, ratio=1.0)


def test_nothing_to_match():
    none, some = np.zeros((0, 4), np.uint8), np.zeros((3, 4), np.uint8)
    for a, b in ((none, some), (some, none), (none, none)):
        assert len(match_guided(a, b, np.zeros((len(a), 2)), np.zeros((len(b), 2)), np.eye(3))) == 0


F = np.arange(12, dtype=np.float32).reshape(3, 4)
XY = np.array([[0.0, 0], [9, 0], [0, 9]])


@pytest.mark.parametrize(
    "change",
    [
        {"src": F.astype(np.int64)},
        {"dst": F[:, :3]},
        {"src_xy": XY[:2]},
        {"dst_xy": XY[:2]},
        {"src_xy": XY * np.nan},
        {"dst_xy": XY * 1e300},
        {"src_xy": XY * 1e300},
        {"radius_px": -1.0},
        {"radius_px": math.nan},
        {"radius_px": 1e300},
        {"ratio": 0.0},
        {"metric": "hamming"},
        {"same_place_px": math.nan},
        {"H_dst_src": np.eye(2)},
        {"H_dst_src": np.zeros((3, 3))},
    ],
)
def test_bad_arguments_are_refused(change):
    good = {"src": F, "dst": F, "src_xy": XY, "dst_xy": XY, "H_dst_src": np.eye(3)}
    with pytest.raises((ShapeError, DegenerateConfiguration), match="need"):
        match_guided(**(good | change))


@pytest.mark.parametrize("change", [{"min_inliers": 4}, {"max_rounds": 0}, {"threshold_px": -1}, {"error": "l1"}])
def test_bad_options_are_refused(change):
    rows, view, xy, image_xy, _ = scene(6)
    with pytest.raises((ShapeError, ValueError)):
        guided_homography(rows, view, xy, image_xy, VIEW, **change)
