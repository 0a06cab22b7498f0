# SPDX-License-Identifier: Apache-2.0
"""The linear homography: exact from four points, refusal of degenerate sets, normalisation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.vision.projective.dlt import design_matrix, homography_dlt, normalisation
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.transform import transform

H_TRUE = normalised_homography([[0.9, -0.3, 220.0], [0.25, 1.1, 40.0], [2e-4, -1e-4, 1.0]])
SQUARE = np.array([[0.0, 0], [640, 0], [640, 480], [0, 480]])


def test_exact_from_four_points() -> None:
    assert_allclose(homography_dlt(SQUARE, transform(H_TRUE, SQUARE)), H_TRUE, atol=1e-12)


def test_exact_from_many_points() -> None:
    src = np.random.default_rng(0).uniform(0, 1000, (50, 2))
    assert_allclose(homography_dlt(src, transform(H_TRUE, src)), H_TRUE, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_exact_for_random_views(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = np.eye(3) + rng.uniform(-0.4, 0.4, (3, 3)) * [[1, 1, 100], [1, 1, 100], [5e-4, 5e-4, 0]]
    src = rng.uniform(0, 500, (12, 2))
    dst = transform(H, src)
    assert_allclose(transform(homography_dlt(src, dst), src), dst, atol=1e-6)


def test_weights_leave_an_outlier_out() -> None:
    src = np.random.default_rng(1).uniform(0, 1000, (20, 2))
    dst = transform(H_TRUE, src)
    dst[3] += 100
    weights = np.ones(20)
    weights[3] = 0
    assert_allclose(homography_dlt(src, dst, weights), H_TRUE, atol=1e-12)


def test_equivariant_to_similarities_of_either_side() -> None:
    """Normalisation makes the answer independent of the unit and origin of the coordinates (HZ 4.4.2)."""
    rng = np.random.default_rng(2)
    src = rng.uniform(0, 500, (30, 2))
    dst = transform(H_TRUE, src) + rng.normal(0, 1, (30, 2))
    S = np.array([[0.02, -0.01, 5], [0.01, 0.02, -7], [0, 0, 1]])
    moved = homography_dlt(src, transform(S, dst))
    assert_allclose(moved, normalised_homography(S @ homography_dlt(src, dst)), atol=1e-9)


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0], [1, 1], [2, 2], [3, 3]],
        [[0, 0], [1, 0], [2, 0], [5, 7]],
        [[0, 0], [0, 0], [5, 3], [1, 7]],
        [[4, 4]] * 6,
        [[0, 0], [1, 2], [2, 4], [3, 6], [4, 8], [5, 10]],
    ],
)
def test_degenerate_points_raise(points: list[list[float]]) -> None:
    src = np.array(points, float)
    with pytest.raises(DegenerateConfiguration):
        homography_dlt(src, transform(H_TRUE, src))
    with pytest.raises(DegenerateConfiguration):
        homography_dlt(transform(H_TRUE, src), src)


def test_too_few_and_misshapen_points() -> None:
    with pytest.raises(TooFewPoints, match="3 and 3"):
        homography_dlt(SQUARE[:3], SQUARE[:3])
    with pytest.raises(TooFewPoints):
        homography_dlt(SQUARE, SQUARE[:3])
    with pytest.raises(ShapeError, match="need"):
        homography_dlt(np.zeros((4, 3)), SQUARE)
    with pytest.raises(ShapeError, match="finite"):
        homography_dlt(SQUARE * np.nan, SQUARE)


def test_normalisation_centres_and_scales() -> None:
    points = np.random.default_rng(3).uniform(-50, 900, (40, 2))
    mapped = transform(normalisation(points), points)
    assert_allclose(mapped.mean(axis=0), 0, atol=1e-12)
    assert np.hypot(*mapped.T).mean() == pytest.approx(np.sqrt(2))
    scene = np.random.default_rng(4).uniform(-3, 90, (40, 3))
    moved = np.column_stack((scene, np.ones(40))) @ normalisation(scene).T
    assert_allclose(moved[:, :3].mean(axis=0), 0, atol=1e-12)
    assert np.linalg.norm(moved[:, :3], axis=1).mean() == pytest.approx(np.sqrt(3))
    assert_allclose(moved[:, 3], 1)
    with pytest.raises(ShapeError, match=r"\(N, 2\) or \(N, 3\)"):
        normalisation(np.zeros((5, 4)))


def test_normalised_beats_unnormalised() -> None:
    """HZ section 4.4.4: far from the origin, noise makes the plain DLT several times worse."""
    plain, normalised = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        src = rng.uniform(1500, 1700, (12, 2))
        dst = transform(H_TRUE, src)
        noisy = dst + rng.normal(0, 0.5, dst.shape)
        h = np.linalg.svd(design_matrix(src, noisy).reshape(-1, 9))[2][-1].reshape(3, 3)
        for H, errors in ((h, plain), (homography_dlt(src, noisy), normalised)):
            errors.append(np.sqrt(((transform(H, src) - dst) ** 2).sum(axis=1).mean()))
    assert np.median(normalised) < 0.8
    assert np.median(plain) > 1.5 * np.median(normalised)


def test_bad_weights() -> None:
    for weights in ([1, 1, 1, -1], [1, 1, 1], [1, 1, 1, np.nan]):
        with pytest.raises(ShapeError, match="weights"):
            homography_dlt(SQUARE, SQUARE + 1, weights)
    with pytest.raises(ShapeError, match="need less"):
        homography_dlt(SQUARE * 1e200, SQUARE)
