# SPDX-License-Identifier: Apache-2.0
"""Covariance by propagation, against the scatter of many estimates."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats
from imgu_ros.vision.estimation.covariance import propagated_covariance, window_correlation
from imgu_ros.vision.estimation.nonlinear import Linearisation, minimise


class Plane:
    """Two coordinates that each follow a x + b: linear, so that the truth is known in closed form."""

    def __init__(self, x: Floats, y: Floats) -> None:
        self.x, self.y = x, y
        self.design = np.zeros((len(x), 2, 4))
        self.design[:, 0, 0] = self.design[:, 1, 2] = x
        self.design[:, 0, 1] = self.design[:, 1, 3] = 1

    def residuals(self, estimate: Floats) -> Floats:
        return self.design @ estimate - self.y

    def linearise(self, estimate: Floats) -> Linearisation:
        return Linearisation(self.residuals(estimate), self.design)

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        return estimate + delta


TRUTH = np.array([2.0, -1.0, 0.5, 3.0])


@pytest.mark.parametrize("correlated", [False, True])
def test_agrees_with_the_scatter_of_estimates(correlated: bool) -> None:
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(0, 60, 30))
    C = window_correlation(np.column_stack((x, np.zeros(30))), 15.0) if correlated else np.eye(30)
    root = np.linalg.cholesky(C + 1e-12 * np.eye(30))
    estimates, covariances = [], []
    for _ in range(1500):
        noise = 0.3 * root @ rng.normal(size=(30, 2))
        problem = Plane(x, Plane(x, np.zeros((30, 2))).design @ TRUTH + noise)
        minimum = minimise(problem, np.zeros(4))
        estimates.append(minimum.estimate)
        covariances.append(propagated_covariance(minimum, correlation=C if correlated else None))
    scatter = np.cov(np.array(estimates).T)
    assert_allclose(np.diag(np.mean(covariances, axis=0)), np.diag(scatter), rtol=0.12)


def test_known_noise_and_closed_form() -> None:
    x = np.arange(10.0)
    minimum = minimise(Plane(x, np.zeros((10, 2))), np.ones(4))
    A = np.column_stack((x, np.ones(10)))
    expected = 0.25 * np.linalg.inv(A.T @ A)
    covariance = propagated_covariance(minimum, noise=0.5)
    assert_allclose(covariance[:2, :2], expected)
    assert_allclose(covariance[:2, 2:], 0, atol=1e-15)
    assert_allclose(propagated_covariance(minimum, noise=0.5, correlation=np.eye(10)), covariance, atol=1e-12)


def test_window_correlation_by_hand() -> None:
    xy = np.array([[0.0, 0], [5, 0], [5, 10], [100, 0]])
    expected = np.array([[1, 2 / 3, 2 / 9, 0], [2 / 3, 1, 1 / 3, 0], [2 / 9, 1 / 3, 1, 0], [0, 0, 0, 1]])
    assert_allclose(window_correlation(xy, 15), expected)


def test_undetermined_and_misshapen() -> None:
    problem = Plane(np.ones(5), np.zeros((5, 2)))
    with pytest.raises(DegenerateConfiguration):
        propagated_covariance(minimise(problem, np.ones(4), max_iterations=0))
    fine = minimise(Plane(np.arange(5.0), np.zeros((5, 2))), np.ones(4))
    with pytest.raises(ShapeError, match="correlation"):
        propagated_covariance(fine, correlation=np.eye(4))
