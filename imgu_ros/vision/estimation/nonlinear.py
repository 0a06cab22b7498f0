"""Nonlinear least squares: Gauss-Newton and Levenberg-Marquardt on one contract (notes 7.3; HZ appendix 6)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np

from imgu_ros.errors import DegenerateConfiguration, EstimationError
from imgu_ros.types import Floats


class Minimiser(StrEnum):
    """Methods of minimisation."""

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
    iterations : linear systems solved
    converged : whether the last step was below the tolerance
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


#: A robust loss: weight (N,) and cost (N,) of the measurements' squared lengths (N,).
Loss = Callable[[Floats], tuple[Floats, Floats]]


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
        others (Marquardt's scaling by the diagonal)
    loss : robust loss, applied by iterative reweighting; None: plain least squares
    max_iterations : most linear systems solved
    tolerance : stop when no parameter's step exceeds this share of its own standard deviation at unit noise,
        or when the cost falls by less than this share

    Raises
    ------
    DegenerateConfiguration
        If the measurements do not determine the parameters.
    """
    damped = Minimiser(method) is Minimiser.LEVENBERG_MARQUARDT
    estimate = start
    current = problem.linearise(estimate)
    weights, cost = _weighted(current.residuals, loss)
    damping = 1e-4 if damped else 0.0
    converged = False
    iterations = 0
    while iterations < max_iterations and not converged:
        normal, gradient = _normal_equations(current, weights)
        accepted = False
        while iterations < max_iterations and not accepted:
            iterations += 1
            delta = _solved(normal, gradient, damping)
            moved = problem.step(estimate, delta)
            try:
                # Most steps are accepted: their derivative will be needed, and comes at little more than the residuals.
                trial = problem.linearise(moved)
                new_weights, new_cost = _weighted(trial.residuals, loss)
            except EstimationError:
                if not damped:
                    raise
                new_weights, new_cost = weights, math.inf  # out of the problem's domain: a step too long
            accepted = new_cost <= cost or not damped
            small = float(delta @ normal @ delta) <= tolerance**2
            if accepted:
                converged = small or abs(cost - new_cost) <= tolerance * cost
                estimate, current, weights, cost = moved, trial, new_weights, new_cost
                damping = max(damping / 10, 1e-12) if damped else 0.0
            elif small or damping > 1e12:
                converged = True
                break
            else:
                damping *= 10
    return Minimum(estimate, current, weights, iterations, converged)


def huber(scale: float) -> Loss:
    """Return Huber's loss: quadratic to `scale`, linear beyond (Huber 1964)."""

    def loss(squared: Floats) -> tuple[Floats, Floats]:
        length = np.sqrt(squared)
        far = length > scale
        safe = np.where(far, length, 1.0)
        return np.where(far, scale / safe, 1.0), np.where(far, 2 * scale * length - scale**2, squared)

    return loss


def _weighted(residuals: Floats, loss: Loss | None) -> tuple[Floats, float]:
    squared = np.einsum("nd,nd->n", residuals, residuals)
    if loss is None:
        return np.ones(len(squared)), float(squared.sum())
    weights, costs = loss(squared)
    return weights, float(costs.sum())


def _normal_equations(current: Linearisation, weights: Floats) -> tuple[Floats, Floats]:
    root = np.sqrt(weights)
    jacobian = (current.jacobian * root[:, None, None]).reshape(-1, current.jacobian.shape[2])
    residuals = (current.residuals * root[:, None]).ravel()
    return jacobian.T @ jacobian, jacobian.T @ residuals


def _solved(normal: Floats, gradient: Floats, damping: float) -> Floats:
    scale = np.sqrt(np.diag(normal))
    if not (np.isfinite(normal).all() and (scale > 0).all()):
        raise DegenerateConfiguration(
            "normal equations: a parameter has no effect; need measurements that determine it"
        )
    scaled = normal / np.outer(scale, scale) + damping * np.eye(len(normal))
    try:
        return np.linalg.solve(scaled, -gradient / scale) / scale
    except np.linalg.LinAlgError:
        raise DegenerateConfiguration(
            "normal equations: singular; need measurements that determine every parameter"
        ) from None
