# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.scale_space.kernels import discrete_gaussian, discrete_reach, sampled_gaussian


def variance(weights):
    n = np.arange(len(weights)) - len(weights) // 2
    return float((weights * n**2).sum() / weights.sum())


@given(st.floats(0.05, 8), st.floats(0.05, 8))
def test_discrete_kernels_form_a_semigroup(first, second):
    """T(., s) * T(., t) = T(., s + t) to rounding (Lindeberg 1990)."""
    once = discrete_gaussian(math.hypot(first, second), 300)
    twice = np.convolve(discrete_gaussian(first, 150), discrete_gaussian(second, 150))
    assert np.abs(once - twice).max() < 1e-12


@pytest.mark.parametrize("sigma", [0.01, 0.3, 1, 5, 50, 1000])
def test_discrete_kernel_has_sum_1_and_variance_sigma_squared(sigma):
    weights = discrete_gaussian(sigma)
    assert weights.sum() == pytest.approx(1, abs=1e-12)
    assert variance(weights) == pytest.approx(sigma**2, rel=1e-9)


@pytest.mark.parametrize("t", [0.2, 1.0, 6.25])
def test_discrete_kernel_by_its_series_and_as_limit_of_binomials(t):
    # I_n(t) = sum over k of (t/2)^(2k+n) / (k! (k+n)!)
    series = [
        math.exp(-t) * sum((t / 2) ** (2 * k + n) / (math.factorial(k) * math.factorial(k + n)) for k in range(40))
        for n in range(8)
    ]
    np.testing.assert_allclose(discrete_gaussian(math.sqrt(t), 7)[7:], series, rtol=1e-12)
    # Many small steps of (p, 1 - 2p, p), each of variance 2p
    steps = 400
    p = t / (2 * steps)
    kernel = np.array([1.0])
    for _ in range(steps):
        kernel = np.convolve(kernel, [p, 1 - 2 * p, p])
    np.testing.assert_allclose(kernel[steps - 7 : steps + 8], discrete_gaussian(math.sqrt(t), 7), atol=2e-3)


def test_discrete_smoothing_makes_no_new_extrema():
    rng = np.random.default_rng(0)
    signal = rng.normal(size=400)
    before = 1000
    for sigma in (0.3, 0.6, 1.0, 2.0, 4.0):
        smoothed = np.convolve(signal, discrete_gaussian(sigma), mode="valid")
        extrema = int(np.count_nonzero(np.diff(np.sign(np.diff(smoothed)))))
        assert extrema <= before
        before = extrema


def test_sampled_kernel_by_definition_and_where_it_fails():
    expected = np.exp(-(np.arange(-8, 9) ** 2) / 8.0)
    np.testing.assert_allclose(sampled_gaussian(2.0), expected / expected.sum(), rtol=1e-14)
    assert variance(sampled_gaussian(0.8, 40)) == pytest.approx(0.64, rel=1e-3)
    assert variance(sampled_gaussian(0.3, 40)) < 0.1 * 0.09
    assert sampled_gaussian(0).tolist() == [1.0] == discrete_gaussian(0, 0).tolist()


@given(st.floats(0.1, 30), st.sampled_from([1e-1, 1e-3, 1e-6, 1e-10]))
def test_reach_is_the_least(sigma, missing):
    reach = discrete_reach(sigma, missing)
    assert 1 - discrete_gaussian(sigma, reach).sum() <= missing + 1e-14
    assert reach == 0 or 1 - discrete_gaussian(sigma, reach - 1).sum() > missing - 1e-14


@pytest.mark.parametrize(
    "call",
    [
        lambda: sampled_gaussian(-1),
        lambda: sampled_gaussian(math.nan),
        lambda: discrete_gaussian(1e6),
        lambda: discrete_gaussian(1, -1),
        lambda: discrete_gaussian(1, 1.5),
        lambda: discrete_reach(1, 0),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        call()
