# SPDX-License-Identifier: Apache-2.0
"""Measures of error: definitions, invariances, and the gold standard against the full problem of scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.projective.errors import (
    algebraic_error,
    reprojection_error,
    sampson_error,
    symmetric_transfer_error,
    transfer_error,
)
from imgu_ros.vision.projective.fit import fit_homography
from imgu_ros.vision.projective.homography import normalised_homography, tangent_basis
from imgu_ros.vision.projective.inhomogeneous import homography_inhomogeneous
from imgu_ros.vision.projective.reprojection import ReprojectionProblem, corrected_points
from imgu_ros.vision.projective.transform import transform

H_TRUE = normalised_homography([[0.8, -0.3, 200.0], [0.25, 0.9, 50.0], [2e-4, -1e-4, 1.0]])
GEOMETRIC = (transfer_error, symmetric_transfer_error, reprojection_error, sampson_error)


def scene(count: int, noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    src = rng.uniform(0, 1000, (count, 2))
    return src + rng.normal(0, noise, src.shape), transform(H_TRUE, src) + rng.normal(0, noise, src.shape)


@pytest.mark.parametrize("error", [algebraic_error, *GEOMETRIC])
def test_zero_where_they_agree_and_positive_elsewhere(error) -> None:
    src, _ = scene(8, 0, 0)
    dst = transform(H_TRUE, src)
    assert_allclose(error(H_TRUE, src, dst), 0, atol=1e-12)
    assert (error(H_TRUE, src, dst + [3, 0]) > 0).all()
    assert_allclose(error(-5 * H_TRUE, src, dst + 1), error(H_TRUE, src, dst + 1))


def test_algebraic_error_by_definition() -> None:
    """The first two components of dst x (H src), H of unit norm."""
    src, dst = scene(10, 3, 1)
    for s, d, error in zip(src, dst, algebraic_error(7 * H_TRUE, src, dst), strict=True):
        cross = np.cross([*d, 1], H_TRUE @ [*s, 1])
        assert error == pytest.approx(cross[0] ** 2 + cross[1] ** 2)


def test_transfer_errors_by_definition() -> None:
    src, dst = scene(10, 3, 1)
    forward = ((transform(H_TRUE, src) - dst) ** 2).sum(axis=1)
    backward = ((transform(np.linalg.inv(H_TRUE), dst) - src) ** 2).sum(axis=1)
    assert_allclose(transfer_error(H_TRUE, src, dst), forward)
    assert_allclose(symmetric_transfer_error(H_TRUE, src, dst), forward + backward)


def test_reprojection_error_is_the_least_there_is() -> None:
    src, dst = scene(6, 20, 2)
    ours = reprojection_error(H_TRUE, src, dst)
    for i in range(6):
        reference = least_squares(
            lambda p, i=i: np.r_[p - src[i], transform(H_TRUE, p[None])[0] - dst[i]], src[i], xtol=1e-15, ftol=1e-15
        )
        assert ours[i] == pytest.approx(2 * reference.cost, rel=1e-9)
    pair = corrected_points(H_TRUE, src, dst)
    assert_allclose(transform(H_TRUE, pair.src), pair.dst)
    assert (ours <= np.minimum(transfer_error(H_TRUE, src, dst), symmetric_transfer_error(H_TRUE, src, dst))).all()
    assert_allclose(sampson_error(H_TRUE, src, dst), ours, rtol=0.05)  # to first order
    near = src + 1e-3 * (pair.src - src), dst + 1e-3 * (pair.dst - dst)
    assert_allclose(sampson_error(H_TRUE, *near), reprojection_error(H_TRUE, *near), rtol=0.05)


@given(st.integers(0, 2**32 - 1))
def test_geometric_errors_are_invariant_to_motions_of_either_picture(seed: int) -> None:
    rng = np.random.default_rng(seed)
    src, dst = scene(6, 3, seed)

    def motion() -> np.ndarray:
        a, (x, y) = rng.uniform(-3, 3), rng.uniform(-100, 100, 2)
        return np.array([[np.cos(a), -np.sin(a), x], [np.sin(a), np.cos(a), y], [0, 0, 1]])

    E, F = motion(), motion()
    moved = F @ H_TRUE @ np.linalg.inv(E), transform(E, src), transform(F, dst)
    for error in GEOMETRIC:
        assert_allclose(error(*moved), error(H_TRUE, src, dst), rtol=1e-6)
    assert not np.allclose(algebraic_error(*moved), algebraic_error(H_TRUE, src, dst), rtol=1e-3)


def full_problem(src: np.ndarray, dst: np.ndarray) -> float:
    """HZ's gold standard without elimination: 8 + 2 N unknowns, the corrected points among them."""

    def residuals(p: np.ndarray) -> np.ndarray:
        points = p[8:].reshape(-1, 2)
        return np.r_[(points - src).ravel(), (transform(np.append(p[:8], 1).reshape(3, 3), points) - dst).ravel()]

    start = np.r_[(H_TRUE / H_TRUE[2, 2]).ravel()[:8], src.ravel()]
    scale = np.r_[np.abs(start[:8]), np.full(src.size, 100.0)]
    return 2 * least_squares(residuals, start, x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-15).cost


@pytest.mark.parametrize("method", ["steepest_descent", "gauss_newton", "levenberg_marquardt"])
def test_gold_standard_reaches_the_optimum_of_the_full_problem(method: str) -> None:
    src, dst = scene(15, 4, 3)
    estimate = fit_homography(src, dst, error="reprojection", refine=method)
    assert reprojection_error(estimate.H, src, dst).sum() == pytest.approx(full_problem(src, dst), rel=1e-6)
    for other in ("transfer", "symmetric", "sampson"):
        rival = fit_homography(src, dst, error=other).H
        assert reprojection_error(estimate.H, src, dst).sum() <= reprojection_error(rival, src, dst).sum() * (1 + 1e-9)


def test_reprojection_derivative_against_finite_differences() -> None:
    src, dst = scene(10, 0, 4)
    dst = transform(H_TRUE, src) + np.random.default_rng(0).normal(0, 1e-4, dst.shape)
    src, dst = src / 500 - 1, dst / 500 - 1
    S = np.array([[1 / 500, 0, -1], [0, 1 / 500, -1], [0, 0, 1]])
    H = normalised_homography(S @ H_TRUE @ np.linalg.inv(S))
    problem = ReprojectionProblem(src, dst)
    numeric = np.stack(
        [
            (problem.residuals(problem.step(H, d)) - problem.residuals(problem.step(H, -d))) / 2e-5
            for d in np.eye(8) * 1e-5
        ],
        axis=2,
    )
    assert_allclose(problem.linearise(H).jacobian, numeric, atol=1e-5)


def test_covariance_of_the_gold_standard_passes_a_chi_square_test() -> None:
    squared = []
    for seed in range(60):
        src, dst = scene(40, 0.5, 100 + seed)
        estimate = fit_homography(src, dst, error="reprojection")
        B = tangent_basis(estimate.H)
        d = B.T @ (H_TRUE - estimate.H).ravel()
        squared.append(d @ np.linalg.solve(B.T @ estimate.covariance @ B, d))
    assert 6.8 < np.mean(squared) < 10.0  # 8.2 expected; standard error 0.55


def test_singular_and_misfitting() -> None:
    src, dst = scene(5, 0, 0)
    for error in (algebraic_error, *GEOMETRIC):
        with pytest.raises(DegenerateConfiguration, match="singular"):
            error(np.ones((3, 3)), src, dst)
        with pytest.raises(ShapeError, match="dst"):
            error(H_TRUE, src, dst[:3])
    with pytest.raises(DegenerateConfiguration):
        transfer_error([[1, 0, 0], [0, 1, 0], [1, 0, 0]], src, dst)


def test_inhomogeneous_least_squares() -> None:
    src, _ = scene(20, 0, 5)
    assert_allclose(homography_inhomogeneous(src[:4], transform(H_TRUE, src[:4])), H_TRUE, atol=1e-10)
    assert_allclose(homography_inhomogeneous(src, transform(H_TRUE, src)), H_TRUE, atol=1e-12)
    with pytest.raises(DegenerateConfiguration):
        homography_inhomogeneous([[0, 0], [1, 1], [2, 2], [5, 7]], [[0, 0], [1, 1], [2, 2], [5, 7]])


def test_noise_covariance_is_the_transfer_error_weighted() -> None:
    """With a covariance it is the maximum-likelihood estimate for exact src: scipy's, of whitened transfer errors."""
    rng = np.random.default_rng(6)
    src = rng.uniform(0, 1000, (25, 2))
    factors = rng.normal(size=(25, 2, 2)) + 2 * np.eye(2)
    C = factors @ np.swapaxes(factors, 1, 2)
    dst = transform(H_TRUE, src) + (factors @ rng.normal(size=(25, 2, 1)))[:, :, 0]
    W = np.linalg.inv(np.linalg.cholesky(C))

    def cost(H: np.ndarray) -> float:
        return float(((W @ (transform(H, src) - dst)[:, :, None]) ** 2).sum())

    start = H_TRUE.ravel() / H_TRUE[2, 2]
    reference = least_squares(
        lambda h: (W @ (transform(np.append(h, 1).reshape(3, 3), src) - dst)[:, :, None]).ravel(),
        start[:8],
        x_scale=np.abs(start[:8]),
        xtol=1e-15,
        ftol=1e-15,
    )
    weighted = cost(homography_inhomogeneous(src, dst, C))
    assert weighted == pytest.approx(2 * reference.cost, rel=1e-3)
    assert weighted < cost(homography_inhomogeneous(src, dst))
    full = np.zeros((50, 50))
    for i in range(25):
        full[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = C[i]
    assert_allclose(homography_inhomogeneous(src, dst, full), homography_inhomogeneous(src, dst, C), atol=1e-12)
