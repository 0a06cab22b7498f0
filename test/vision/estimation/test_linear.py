# SPDX-License-Identifier: Apache-2.0
"""Linear least squares against closed forms, the scatter of estimates, and scipy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares as scipy_least_squares

from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.vision.estimation.linear import homogeneous_least_squares, least_squares, total_least_squares


def test_equals_the_normal_equations() -> None:
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(30, 4)), rng.normal(size=30)
    root = rng.normal(size=(30, 30))
    C = root @ root.T + np.eye(30)
    W = np.linalg.inv(C)
    assert_allclose(least_squares(A, b).x, np.linalg.solve(A.T @ A, A.T @ b))
    weighted = least_squares(A, b, C)
    assert_allclose(weighted.x, np.linalg.solve(A.T @ W @ A, A.T @ W @ b))
    assert_allclose(weighted.covariance, np.linalg.inv(A.T @ W @ A))
    variances = rng.uniform(0.1, 4, 30)
    assert_allclose(least_squares(A, b, variances).x, least_squares(A, b, np.diag(variances)).x)


def test_covariance_is_the_scatter_and_weighting_lessens_it() -> None:
    rng = np.random.default_rng(1)
    A = np.column_stack((np.ones(20), np.arange(20)))
    sigma = np.where(np.arange(20) % 2, 0.1, 2.0)
    plain, weighted = [], []
    for _ in range(2000):
        b = A @ [3, 0.5] + sigma * rng.normal(size=20)
        plain.append(least_squares(A, b).x)
        weighted.append(least_squares(A, b, sigma**2))
    scatter = np.cov(np.array([w.x for w in weighted]).T)
    assert_allclose(weighted[0].covariance, scatter, rtol=0.15)
    assert np.var(plain, axis=0)[1] > 20 * scatter[1, 1]
    assert np.mean([w.rms**2 for w in weighted]) == pytest.approx(18 / 20, rel=0.02)


def test_twice_the_digits_of_the_normal_equations() -> None:
    A = np.vander(np.linspace(0, 1, 20), 10)
    x = np.ones(10)
    ours = np.abs(least_squares(A, A @ x).x - x).max()
    assert ours < np.abs(np.linalg.solve(A.T @ A, A.T @ (A @ x)) - x).max() / 10


def test_total_least_squares_is_orthogonal_regression() -> None:
    rng = np.random.default_rng(2)
    x = rng.uniform(-5, 5, 50)
    A = x[:, None] + rng.normal(0, 0.3, (50, 1))
    b = 2 * x + rng.normal(0, 0.3, 50)
    reference = scipy_least_squares(lambda m: (A[:, 0] * m[0] - b) / np.hypot(1, m[0]), [1.0], xtol=1e-15).x
    assert_allclose(total_least_squares(A, b), reference, rtol=1e-6)
    # Errors in A attenuate the ordinary slope; total least squares is consistent.
    slopes = []
    for seed in range(200):
        r = np.random.default_rng(seed)
        noisy, c = x[:, None] + r.normal(0, 1, (50, 1)), 2 * x + r.normal(0, 1, 50)
        slopes.append((least_squares(noisy, c).x[0], total_least_squares(noisy, c)[0]))
    ordinary, total = np.mean(slopes, axis=0)
    assert ordinary < 1.85 < 1.95 < total < 2.05


def test_homogeneous_is_the_last_singular_vector() -> None:
    A = np.random.default_rng(3).normal(size=(20, 5))
    x = homogeneous_least_squares(A)
    values = np.linalg.eigvalsh(A.T @ A)
    assert np.linalg.norm(x) == pytest.approx(1)
    assert ((A @ x) ** 2).sum() == pytest.approx(values[0])
    exact = homogeneous_least_squares([[1, 0, -1], [0, 1, -1]])  # as many equations as unknowns less one
    assert_allclose(exact, np.ones(3) / np.sqrt(3))


def test_what_does_not_determine_x() -> None:
    with pytest.raises(TooFewPoints, match="1 equations"):
        least_squares([[1, 2]], [1])
    with pytest.raises(DegenerateConfiguration, match="depend"):
        least_squares([[1, 2], [2, 4], [3, 6]], [1, 2, 3])
    with pytest.raises(DegenerateConfiguration, match="column is zero"):
        least_squares([[1, 0], [2, 0]], [1, 2])
    with pytest.raises(DegenerateConfiguration, match="positive definite"):
        least_squares(np.eye(2), [1, 2], -np.eye(2))
    with pytest.raises(DegenerateConfiguration, match="variance"):
        least_squares(np.eye(2), [1, 2], [1, 0])
    with pytest.raises(ShapeError, match="symmetric"):
        least_squares(np.eye(2), [1, 2], [[1, 2], [0, 1]])
    with pytest.raises(DegenerateConfiguration, match="infinity"):
        total_least_squares([[0.0], [0.0]], [1, 2])
    with pytest.raises(DegenerateConfiguration, match="equally good"):
        homogeneous_least_squares([[1, 0, 0], [2, 0, 0]])
    with pytest.raises(TooFewPoints):
        homogeneous_least_squares([[1, 0, 0]])
    with pytest.raises(ShapeError, match="need"):
        homogeneous_least_squares([[[1.0]]])
