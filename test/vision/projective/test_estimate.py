# SPDX-License-Identifier: Apache-2.0
"""Robust homographies: outliers, degenerate scenes, optimality, honest covariance."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError, TooFewPoints
from imgu_ros.vision.projective.estimate import estimate_homography
from imgu_ros.vision.projective.fit import fit_homography
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.refine import (
    HomographyError,
    SampsonProblem,
    SymmetricProblem,
    TransferProblem,
    tangent_basis,
)
from imgu_ros.vision.projective.transform import transform

H_TRUE = normalised_homography([[0.8, -0.3, 200.0], [0.25, 0.9, 50.0], [2e-4, -1e-4, 1.0]])
GEOMETRIC = (HomographyError.TRANSFER, HomographyError.SYMMETRIC, HomographyError.SAMPSON)


def scene(count: int, noise: float, seed: int, both: bool = False) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    src = rng.uniform(0, 1000, (count, 2))
    dst = transform(H_TRUE, src) + rng.normal(0, noise, (count, 2))
    return src + (rng.normal(0, noise, (count, 2)) if both else 0), dst


@pytest.mark.parametrize("sampler", ["uniform", "prosac"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
def test_outliers_are_told_apart(sampler: str, share: float) -> None:
    src, dst = scene(200, 0.3, 1)
    rng = np.random.default_rng(2)
    wrong = rng.permutation(200)[: int(share * 200)]
    dst[wrong] = rng.uniform(0, 1000, (len(wrong), 2))
    estimate = estimate_homography(src, dst, np.random.default_rng(3), sampler=sampler, threshold_px=2.0)
    true_inliers = np.hypot(*(transform(H_TRUE, src) - dst).T) < 2
    assert np.count_nonzero(estimate.inliers != true_inliers) <= 2
    assert np.abs(transform(estimate.H, src) - transform(H_TRUE, src)).max() < 0.5
    assert np.linalg.det(estimate.H) > 0
    assert np.linalg.norm(estimate.H) == pytest.approx(1)


def test_same_generator_same_answer() -> None:
    src, dst = scene(100, 0.5, 4)
    dst[::2] = np.random.default_rng(5).uniform(0, 1000, (50, 2))
    a, b = (estimate_homography(src, dst, np.random.default_rng(6)) for _ in range(2))
    assert np.array_equal(a.H, b.H)
    assert np.array_equal(a.covariance, b.covariance)


def test_prosac_needs_fewer_draws_when_the_best_come_first() -> None:
    src, dst = scene(300, 0.3, 7)
    dst[90:] = np.random.default_rng(8).uniform(0, 1000, (210, 2))  # 30 % inliers, all among the best
    count = {
        sampler: np.median(
            [estimate_homography(src, dst, np.random.default_rng(s), sampler=sampler).iterations for s in range(5)]
        )
        for sampler in ("uniform", "prosac")
    }
    assert count["prosac"] <= count["uniform"]


def test_no_consensus_among_random_points() -> None:
    rng = np.random.default_rng(9)
    with pytest.raises(NoConsensus, match="need 12"):
        estimate_homography(
            rng.uniform(0, 1000, (60, 2)), rng.uniform(0, 1000, (60, 2)), rng, min_inliers=12, max_iterations=500
        )


def test_mirrored_and_collinear_scenes_are_refused() -> None:
    src, dst = scene(50, 0.1, 10)
    with pytest.raises((NoConsensus, DegenerateConfiguration)):
        estimate_homography(src * [-1, 1], dst, np.random.default_rng(0))
    line = np.column_stack((np.linspace(0, 500, 40), np.linspace(0, 300, 40)))
    with pytest.raises((NoConsensus, DegenerateConfiguration)):
        estimate_homography(line, transform(H_TRUE, line), np.random.default_rng(0))
    with pytest.raises(DegenerateConfiguration, match="line"):
        fit_homography(line, transform(H_TRUE, line))
    with pytest.raises(DegenerateConfiguration, match="mirrored"):
        fit_homography(src * [-1, 1], dst)


def test_too_few_points() -> None:
    src, dst = scene(3, 0, 0)
    with pytest.raises(TooFewPoints):
        estimate_homography(src, dst, np.random.default_rng(0))
    with pytest.raises(ShapeError, match="dst"):
        estimate_homography(src, dst[:2], np.random.default_rng(0))


@pytest.mark.parametrize("error", [*GEOMETRIC, HomographyError.ALGEBRAIC])
def test_exact_points_give_the_exact_homography(error: HomographyError) -> None:
    src, dst = scene(20, 0, 11)
    estimate = fit_homography(src, dst, error=error)
    assert_allclose(estimate.H, H_TRUE, atol=1e-10)
    assert estimate.rms_px < 1e-8


@pytest.mark.parametrize("method", ["gauss_newton", "levenberg_marquardt"])
def test_transfer_error_reaches_the_minimum_that_scipy_finds(method: str) -> None:
    src, dst = scene(40, 1.0, 12)
    ours = fit_homography(src, dst, error=HomographyError.TRANSFER, refine=method)
    problem = TransferProblem(src, dst)

    start = H_TRUE.ravel()
    reference = least_squares(
        lambda h: problem.residuals(h.reshape(3, 3)).ravel(),
        start,
        x_scale=np.abs(start),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert (problem.residuals(ours.H) ** 2).sum() == pytest.approx(2 * reference.cost, rel=1e-9)


@pytest.mark.parametrize("problem", [TransferProblem, SymmetricProblem])
def test_derivatives_against_finite_differences(problem: type) -> None:
    src, dst = scene(10, 2.0, 13)
    src, dst = src / 500 - 1, dst / 500 - 1
    H = normalised_homography([[0.8, -0.3, 0.2], [0.25, 0.9, 0.1], [0.1, -0.05, 1.0]])
    p = problem(src, dst)
    numeric = np.stack(
        [(p.residuals(p.step(H, d)) - p.residuals(p.step(H, -d))) / 2e-6 for d in np.eye(8) * 1e-6], axis=2
    )
    assert_allclose(p.linearise(H).jacobian, numeric, atol=1e-7)


def test_sampson_derivative_is_exact_at_zero_residual() -> None:
    src = np.random.default_rng(14).uniform(-1, 1, (10, 2))
    H = normalised_homography([[0.8, -0.3, 0.2], [0.25, 0.9, 0.1], [0.1, -0.05, 1.0]])
    p = SampsonProblem(src, transform(H, src))
    numeric = np.stack(
        [(p.residuals(p.step(H, d)) - p.residuals(p.step(H, -d))) / 2e-6 for d in np.eye(8) * 1e-6], axis=2
    )
    assert_allclose(p.linearise(H).jacobian, numeric, atol=1e-7)


def test_tangent_basis_is_orthonormal_and_orthogonal_to_h() -> None:
    for seed in range(20):
        H = normalised_homography(np.random.default_rng(seed).normal(size=(3, 3)))
        B = tangent_basis(H)
        assert_allclose(B.T @ B, np.eye(8), atol=1e-12)
        assert_allclose(H.ravel() @ B, 0, atol=1e-12)


@pytest.mark.parametrize("error", GEOMETRIC)
def test_covariance_passes_a_chi_square_test(error: HomographyError) -> None:
    """The normalised squared error of H has mean 8 (8 degrees of freedom; a little more, as sigma is estimated)."""
    both = error is not HomographyError.TRANSFER
    squared = []
    for seed in range(150):
        src, dst = scene(60, 0.5, 1000 + seed, both)
        estimate = fit_homography(src, dst, error=error)
        B = tangent_basis(estimate.H)
        d = B.T @ (H_TRUE - estimate.H).ravel()
        squared.append(d @ np.linalg.solve(B.T @ estimate.covariance @ B, d))
        assert np.linalg.matrix_rank(estimate.covariance, tol=1e-14 * np.abs(estimate.covariance).max()) <= 8
    assert 7.0 < np.mean(squared) < 9.4  # 8.15 expected; standard error of the mean 0.34


def test_known_noise_scales_the_covariance() -> None:
    src, dst = scene(50, 0.5, 15)
    a = fit_homography(src, dst, noise_px=0.5)
    b = fit_homography(src, dst, noise_px=1.0)
    assert_allclose(b.covariance, 4 * a.covariance)
