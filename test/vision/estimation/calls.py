# SPDX-License-Identifier: Apache-2.0
"""A valid call of every public function of vision/estimation, for test_hostile.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.types import as_matrix
from imgu_ros.vision.estimation.chance import binomial_tail, pair_probability, shares_of_places
from imgu_ros.vision.estimation.covariance import propagated_covariance, selection_efficiency, window_correlation
from imgu_ros.vision.estimation.directions import DirectionsModel, align_directions
from imgu_ros.vision.estimation.line import LineModel, fit_line
from imgu_ros.vision.estimation.linear import homogeneous_least_squares, least_squares, shape_of, total_least_squares
from imgu_ros.vision.estimation.losses import cauchy, huber, tukey
from imgu_ros.vision.estimation.nonlinear import Linearisation, Minimum, minimise
from imgu_ros.vision.estimation.ransac import Proposal, accepted, iterations_needed, ransac
from imgu_ros.vision.estimation.sampling import draw_samples
from imgu_ros.vision.estimation.settling import InlierFit


class Linear:
    """A x = b."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.A, self.b = rng.normal(size=(6, 1, 2)), rng.normal(size=(6, 1))

    def linearise(self, estimate: np.ndarray) -> Linearisation:
        estimate = as_matrix(estimate, (2,), "estimate")
        return Linearisation(self.A @ estimate - self.b, self.A)

    def step(self, estimate: np.ndarray, delta: np.ndarray) -> np.ndarray:
        return estimate + delta


def weights_and_costs(loss: str, scale: float, squared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return {"huber": huber, "cauchy": cauchy, "tukey": tukey}[loss](scale)(np.abs(squared).astype(float))


def _minimum(rng: np.random.Generator) -> Minimum:
    return minimise(Linear(rng), np.zeros(2))


def _mean_of_nine() -> InlierFit[float]:
    values = np.arange(9.0)
    return InlierFit(lambda mask: float(values[mask].mean()), lambda mean: np.abs(values - mean) < 3, 2, 9)


CALLS: dict[Callable[..., object], Callable[[np.random.Generator], dict[str, object]]] = {
    propagated_covariance: lambda rng: {"minimum": _minimum(rng), "noise": 0.5, "correlation": np.eye(6)},
    selection_efficiency: lambda _: {"mean_square": 2.0, "threshold": 3.0},
    binomial_tail: lambda _: {"count": 20, "successes": 3, "probability": 0.1},
    pair_probability: lambda rng: {
        "mapped": rng.uniform(0, 100, (9, 2)),
        "measured": rng.uniform(0, 100, (9, 2)),
        "threshold": 3.0,
    },
    shares_of_places: lambda rng: {"points": rng.uniform(0, 20, (9, 2)), "size": 3.0},
    window_correlation: lambda rng: {"xy": rng.uniform(0, 20, (5, 2)), "side": 15.0},
    align_directions: lambda rng: {
        "src": rng.normal(size=(5, 3)),
        "dst": rng.normal(size=(5, 3)),
        "weights": rng.uniform(0.5, 1, 5),
    },
    DirectionsModel: lambda rng: {"src": rng.normal(size=(5, 3)), "dst": rng.normal(size=(5, 3))},
    fit_line: lambda rng: {"points": rng.normal(size=(6, 2)) * [5, 1], "weights": rng.uniform(0.5, 1, 6)},
    LineModel: lambda rng: {"points": rng.normal(size=(6, 2))},
    least_squares: lambda rng: {
        "A": rng.normal(size=(6, 2)),
        "b": rng.normal(size=6),
        "covariance": np.diag(rng.uniform(0.5, 1, 6)),
    },
    total_least_squares: lambda rng: {"A": rng.normal(size=(6, 2)), "b": rng.normal(size=6)},
    homogeneous_least_squares: lambda rng: {"A": rng.normal(size=(6, 3))},
    shape_of: lambda rng: {"array": rng.normal(size=(6, 2)), "name": "A"},
    huber: lambda _: {"scale": 1.0},
    cauchy: lambda _: {"scale": 1.0},
    tukey: lambda _: {"scale": 1.0},
    minimise: lambda rng: {"problem": Linear(rng), "start": rng.normal(size=2)},
    accepted: lambda rng: {
        "model": LineModel(np.column_stack((np.arange(9.0), np.zeros(9)))),
        "proposal": Proposal(np.array([[0.0, 1.0, 0.0]]), 10),
        "threshold": 0.5,
    },
    ransac: lambda rng: {
        "model": LineModel(np.column_stack((np.arange(9.0), np.zeros(9)))),
        "threshold": 0.5,
        "rng": rng,
        "confidence": 0.9,
    },
    iterations_needed: lambda _: {"inlier_share": 0.5, "sample_size": 4, "confidence": 0.99},
    InlierFit.settled: lambda _: {"self": _mean_of_nine(), "inliers": np.arange(9) < 4},
    draw_samples: lambda rng: {"sampler": "prosac", "count": 9, "sample_size": 4, "rng": rng},
}
