# SPDX-License-Identifier: Apache-2.0
"""Nonlinear least squares: steepest descent, Gauss-Newton and Levenberg-Marquardt on one contract.

IU 7.3.2 to 7.3.5; HZ appendix 6.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from imgu_ros.arguments import shown_value
from imgu_ros.errors import DegenerateConfiguration, EstimationError, ShapeError
from imgu_ros.types import Choice, Floats, as_matrix
from imgu_ros.vision.estimation.linear import shape_of
from imgu_ros.vision.estimation.losses import Loss

#: A nearly undamped step that promises to lower the cost by less than this share, and fails, has met rounding.
_ROUNDING = 1e-12


class Minimiser(Choice):
    """Methods of minimisation."""

    STEEPEST_DESCENT = "steepest_descent"
    GAUSS_NEWTON = "gauss_newton"
    LEVENBERG_MARQUARDT = "levenberg_marquardt"


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """A problem at one estimate.

    Attributes
    ----------
    residuals : (N, D), N measurements of D coordinates
    jacobian : (N, D, P), derivative of the residuals by the step
    """

    residuals: Floats
    jacobian: Floats


class LeastSquaresProblem(Protocol):
    """What a minimiser needs to know of a problem; the estimate is an array of any shape."""

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals and their derivative by a step of P parameters.

        May raise an EstimationError where the residuals are not defined; such a step is not taken.
        """

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        """Return the estimate moved by the step `delta`, (P,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where a minimisation ended.

    Attributes
    ----------
    estimate : the best estimate
    linearisation : the problem there
    weights : (N,) weight of each measurement there, 0 to 1
    iterations : steps tried
    converged : whether a further step would be below the tolerance
    """

    estimate: Floats
    linearisation: Linearisation
    weights: Floats
    iterations: int
    converged: bool

    @property
    def normal_matrix(self) -> Floats:
        """J^T W J, (P, P)."""
        weighted = self.linearisation.jacobian * np.sqrt(self.weights)[:, None, None]
        flat = weighted.reshape(-1, weighted.shape[2])
        return flat.T @ flat


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def minimise(
    problem: LeastSquaresProblem,
    start: Floats,
    method: Minimiser | str = Minimiser.LEVENBERG_MARQUARDT,
    *,
    loss: Loss | None = None,
    max_iterations: int = 50,
    tolerance: float = 1e-8,
) -> Minimum:
    """Minimise the sum of (robustified) squared residuals.

    Parameters
    ----------
    problem, start : the problem and where to start
    method : Gauss-Newton takes every step; Levenberg-Marquardt only those that lower the cost, and damps the
        others (Marquardt's scaling by the diagonal); steepest descent goes down the gradient, tens of times as many
        steps
    loss : robust loss, applied by iterative reweighting; None: plain least squares
    max_iterations : most steps tried
    tolerance : stop when no parameter's step exceeds this share of its own standard deviation at unit noise,
        or when the cost falls by less than this share

    Raises
    ------
    DegenerateConfiguration
        If the measurements do not determine the parameters, or the residuals are not finite at the start.
    ShapeError
        If the start is not an array of finite numbers.

    Examples
    --------
    The mean of three numbers, as the least squares of their distances:

    >>> class Mean:
    ...     def linearise(self, estimate):
    ...         return Linearisation(estimate - np.array([[1.0], [2.0], [6.0]]), np.ones((3, 1, 1)))
    ...     def step(self, estimate, delta):
    ...         return estimate + delta
    >>> minimum = minimise(Mean(), np.array([0.0]), "gauss_newton")
    >>> minimum.estimate.round(9).tolist(), minimum.converged
    ([3.0], True)
    """
    if not (hasattr(problem, "linearise") and hasattr(problem, "step")):
        raise ShapeError(f"problem: {shown_value(problem)}; need an object that linearises and steps")
    if loss is not None and not callable(loss):
        raise ShapeError(f"loss: {shown_value(loss)}; need huber, cauchy or tukey of a scale, or None")
    if not (isinstance(max_iterations, int | np.integer) and isinstance(tolerance, float | int) and tolerance < 1e100):
        raise ShapeError(
            f"max_iterations, tolerance: {shown_value(max_iterations)}, {shown_value(tolerance)}; "
            "need an integer, and a number below 1e100"
        )
    method = Minimiser(method)
    start = as_matrix(start, shape_of(start, "start"), "start")
    guarded = method is not Minimiser.GAUSS_NEWTON
    # Steepest descent goes on for long with little gain at each step.
    enough = tolerance**2 if method is Minimiser.STEEPEST_DESCENT else tolerance
    estimate = start
    current = problem.linearise(estimate)
    weights, cost = _weighted(current.residuals, loss)
    caution = _FIRST_CAUTION[method]
    converged = False
    iterations = 0
    while iterations < max_iterations and not converged:
        normal, gradient = _normal_equations(current, None if loss is None else weights)
        accepted = False
        while iterations < max_iterations and not accepted:
            delta = _STEPS[method](normal, gradient, caution)
            length = float(delta @ normal @ delta)
            if length <= tolerance**2:
                converged = True
                break
            iterations += 1
            moved = problem.step(estimate, delta)
            try:
                # Most steps are accepted: their derivative will be needed, and comes at little more than the residuals.
                trial = problem.linearise(moved)
                new_weights, new_cost = _weighted(trial.residuals, loss)
            except EstimationError:
                if not guarded:
                    raise
                new_weights, new_cost = weights, math.inf  # out of the problem's domain: a step too long
            accepted = new_cost <= cost or not guarded
            if accepted:
                converged = abs(cost - new_cost) <= enough * cost
                estimate, current, weights, cost = moved, trial, new_weights, new_cost
                caution = max(caution / 10, 1e-12) if guarded else 0.0
            elif caution > 1e12 or (caution <= 1 and length <= _ROUNDING * cost):
                converged = True
                break
            else:
                caution *= 10
    return Minimum(estimate, current, weights, iterations, converged)


def _weighted(residuals: Floats, loss: Loss | None) -> tuple[Floats, float]:
    if loss is None:
        weights, cost = np.ones(len(residuals)), float(np.vdot(residuals, residuals))
    else:
        weights, costs = loss(np.einsum("nd,nd->n", residuals, residuals))
        cost = float(costs.sum())
    if not math.isfinite(cost):
        raise DegenerateConfiguration("residuals: not finite; need an estimate at which they are defined")
    return weights, cost


def _normal_equations(current: Linearisation, weights: Floats | None) -> tuple[Floats, Floats]:
    jacobian, residuals = current.jacobian, current.residuals
    if weights is not None:
        root = np.sqrt(weights)
        jacobian, residuals = jacobian * root[:, None, None], residuals * root[:, None]
    flat = jacobian.reshape(-1, jacobian.shape[2])
    return flat.T @ flat, flat.T @ residuals.ravel()


def _newton_step(normal: Floats, gradient: Floats, damping: float) -> Floats:
    scale = _scale(normal)
    scaled = normal / (scale[:, None] * scale)
    scaled.ravel()[:: len(scale) + 1] += damping
    # Of a few rows, OpenCV is three times as fast as numpy.
    regular, step = cv2.solve(scaled, (gradient / scale)[:, None], flags=cv2.DECOMP_CHOLESKY)
    if not regular:
        raise DegenerateConfiguration("normal equations: singular; need measurements that determine every parameter")
    return np.asarray(-step[:, 0] / scale, np.float64)


def _descent_step(normal: Floats, gradient: Floats, caution: float) -> Floats:
    """Return the step down the gradient of parameters in units of their own effect, to the least predicted cost.

    A tenth less than that breaks the zigzag of exact steps (Raydan & Svaiter 2002), several times faster.
    """
    scale = _scale(normal)
    downhill = -gradient / scale
    curvature = float(downhill / scale @ normal @ (downhill / scale))
    if curvature <= 0:
        return np.zeros_like(gradient)
    return np.asarray(0.9 / (1 + caution) * float(downhill @ downhill) / curvature * downhill / scale, np.float64)


def _scale(normal: Floats) -> Floats:
    scale = np.sqrt(normal.diagonal())
    if not (math.isfinite(float(normal.sum())) and scale.min() > 0):
        raise DegenerateConfiguration(
            "normal equations: a parameter has no effect; need measurements that determine it"
        )
    return np.asarray(scale, np.float64)


#: Marquardt's damping, or the shortening of a descent, at the start; both are raised while steps fail.
_FIRST_CAUTION = {
    Minimiser.STEEPEST_DESCENT: 1e-4,
    Minimiser.GAUSS_NEWTON: 0.0,
    Minimiser.LEVENBERG_MARQUARDT: 1e-4,
}
_STEPS: dict[Minimiser, Callable[[Floats, Floats, float], Floats]] = {
    Minimiser.STEEPEST_DESCENT: _descent_step,
    Minimiser.GAUSS_NEWTON: _newton_step,
    Minimiser.LEVENBERG_MARQUARDT: _newton_step,
}
