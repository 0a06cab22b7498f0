# SPDX-License-Identifier: Apache-2.0
"""Robust losses: weights are the derivative of costs; scipy minimises the same."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats
from imgu_ros.vision.estimation.losses import cauchy, huber, tukey
from imgu_ros.vision.estimation.nonlinear import Linearisation, minimise


@pytest.mark.parametrize("loss", [huber, cauchy, tukey])
def test_weight_is_the_derivative_of_the_cost_by_the_square(loss) -> None:
    squared = np.linspace(0.01, 9, 50)
    step = 1e-6
    numeric = (loss(1.5)(squared + step)[1] - loss(1.5)(squared - step)[1]) / (2 * step)
    assert_allclose(loss(1.5)(squared)[0], numeric, atol=1e-6)
    weight, cost = loss(1.5)(np.array([0.0, 1e-12, 1e300, np.inf]))
    assert weight[0] == 1
    assert cost[0] == 0
    assert cost[1] == pytest.approx(1e-12, rel=1e-3)
    assert weight[2] < 1e-100
    assert not np.isnan(weight).any()


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("loss", [huber, cauchy, tukey])
def test_scale_is_positive(loss, scale: float) -> None:
    with pytest.raises(ShapeError, match="scale"):
        loss(scale)


class Location:
    def __init__(self, y: Floats) -> None:
        self.y = y

    def linearise(self, estimate: Floats) -> Linearisation:
        return Linearisation((estimate - self.y)[:, None], np.ones((len(self.y), 1, 1)))

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        return estimate + delta


def test_location_among_outliers_as_scipy_has_it() -> None:
    y = np.concatenate((np.random.default_rng(0).normal(2, 0.1, 40), [30.0, 50.0, 90.0]))
    for ours, name in ((huber(0.3), "huber"), (cauchy(0.3), "cauchy")):
        reference = least_squares(lambda m: m - y, [2.3], loss=name, f_scale=0.3, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        found = minimise(Location(y), np.array([2.3]), loss=ours, max_iterations=300, tolerance=1e-12)
        assert_allclose(found.estimate, reference.x, rtol=1e-5)
    # The biweight knows nothing of what lies beyond its scale.
    without = minimise(Location(y[:40]), np.array([2.3]), loss=tukey(0.6), max_iterations=300).estimate
    assert_allclose(minimise(Location(y), np.array([2.3]), loss=tukey(0.6), max_iterations=300).estimate, without)
