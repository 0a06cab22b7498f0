# SPDX-License-Identifier: Apache-2.0
"""Minimisers on problems with known minima."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats
from imgu_ros.vision.estimation.losses import huber
from imgu_ros.vision.estimation.nonlinear import Linearisation, minimise


class Decay:
    """y = a exp(-b x): parameters (a, b)."""

    def __init__(self, x: Floats, y: Floats) -> None:
        self.x, self.y = x, y

    def residuals(self, estimate: Floats) -> Floats:
        return (estimate[0] * np.exp(-estimate[1] * self.x) - self.y)[:, None]

    def linearise(self, estimate: Floats) -> Linearisation:
        e = np.exp(-estimate[1] * self.x)
        return Linearisation(self.residuals(estimate), np.stack((e, -estimate[0] * self.x * e), axis=1)[:, None, :])

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        return estimate + delta


def noisy(outlier: float = 0.0) -> Decay:
    x = np.linspace(0, 4, 40)
    y = 3 * np.exp(-0.7 * x) + np.random.default_rng(0).normal(0, 0.02, 40)
    y[10] += outlier
    return Decay(x, y)


@pytest.mark.parametrize("method", ["gauss_newton", "levenberg_marquardt"])
def test_same_minimum_as_scipy(method: str) -> None:
    problem = noisy()
    minimum = minimise(problem, np.array([2.5, 0.6]), method)
    reference = least_squares(lambda e: problem.residuals(e).ravel(), [2.5, 0.6], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert minimum.converged
    assert minimum.iterations <= 12
    assert_allclose(minimum.estimate, reference.x, rtol=1e-6)
    assert_allclose(minimum.normal_matrix, reference.jac.T @ reference.jac, rtol=1e-4)


def test_levenberg_marquardt_survives_a_far_start() -> None:
    minimum = minimise(noisy(), np.array([8.0, 3.0]), max_iterations=200)
    assert_allclose(minimum.estimate, [3, 0.7], atol=0.05)


def test_huber_bounds_an_outlier() -> None:
    problem = noisy(outlier=5.0)
    plain = minimise(problem, np.array([2.5, 0.6])).estimate
    robust = minimise(problem, np.array([2.5, 0.6]), loss=huber(0.05))
    assert np.abs(robust.estimate - [3, 0.7]).max() < 0.02 < np.abs(plain - [3, 0.7]).max()
    assert robust.weights[10] < 0.02
    reference = least_squares(
        lambda e: problem.residuals(e).ravel(), [2.5, 0.6], loss="huber", f_scale=0.05, xtol=1e-14, ftol=1e-14
    )
    assert_allclose(robust.estimate, reference.x, rtol=1e-4)


def test_undetermined_parameters_raise() -> None:
    with pytest.raises(DegenerateConfiguration):
        minimise(Decay(np.zeros(5), np.ones(5)), np.array([1.0, 1.0]))


def test_no_iteration_still_linearises() -> None:
    minimum = minimise(noisy(), np.array([2.5, 0.6]), max_iterations=0)
    assert minimum.iterations == 0
    assert not minimum.converged
    assert minimum.normal_matrix.shape == (2, 2)


def test_steepest_descent_comes_to_the_same_minimum_in_more_steps() -> None:
    problem = noisy()
    newton = minimise(problem, np.array([2.5, 0.6]))
    descent = minimise(problem, np.array([2.5, 0.6]), "steepest_descent", max_iterations=500)
    assert descent.converged
    assert newton.iterations < descent.iterations < 200
    assert_allclose(descent.estimate, newton.estimate, rtol=1e-5)


@pytest.mark.parametrize("method", ["steepest_descent", "levenberg_marquardt"])
def test_no_step_raises_the_cost(method: str) -> None:
    problem, costs = noisy(), []
    for steps in range(15):
        minimum = minimise(problem, np.array([8.0, 3.0]), method, max_iterations=steps)
        assert minimum.iterations <= steps
        costs.append((minimum.linearisation.residuals**2).sum())
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] < costs[0] / 4


def test_start_and_method_are_checked() -> None:
    with pytest.raises(ShapeError, match="start"):
        minimise(noisy(), np.array([np.nan, 1.0]))
    with pytest.raises(ShapeError, match="steepest_descent"):
        minimise(noisy(), np.array([1.0, 1.0]), "newton")
    with pytest.raises(DegenerateConfiguration, match="finite"):
        minimise(noisy(), np.array([1.0, -1e6]))


class Logarithm:
    """Residuals log(a x) - y, defined for a > 0 alone: full steps from far above end below 0."""

    def __init__(self, a: float) -> None:
        self.x = np.array([0.5, 1.0, 2.0, 4.0])
        self.y = np.log(a * self.x) + [0.01, -0.01, 0.02, -0.02]

    def linearise(self, estimate: Floats) -> Linearisation:
        if not estimate[0] > 0:
            raise DegenerateConfiguration("a: not positive")
        return Linearisation((np.log(estimate[0] * self.x) - self.y)[:, None], np.full((4, 1, 1), 1 / estimate[0]))

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        return estimate + delta


@pytest.mark.parametrize("method", ["levenberg_marquardt", "steepest_descent"])
def test_steps_that_leave_the_domain_are_shortened(method: str) -> None:
    # At a = 30 the full step is -30 log(30 / 3), to -39.
    minimum = minimise(Logarithm(3.0), np.array([30.0]), method, max_iterations=200)
    assert_allclose(minimum.estimate, [3.0], rtol=1e-6)  # the noise of y has mean 0
    with pytest.raises(DegenerateConfiguration, match="not positive"):
        minimise(Logarithm(3.0), np.array([30.0]), "gauss_newton")


@pytest.mark.parametrize("method", ["steepest_descent", "gauss_newton", "levenberg_marquardt"])
def test_a_start_at_the_minimum_stays(method: str) -> None:
    x = np.linspace(0, 4, 10)
    exact = Decay(x, 3 * np.exp(-0.7 * x))
    minimum = minimise(exact, np.array([3.0, 0.7]), method)
    assert minimum.converged
    assert_allclose(minimum.estimate, [3.0, 0.7], atol=1e-15)
