# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from imgu_ros.errors import ShapeError
from imgu_ros.vision.processing.borders import Border
from imgu_ros.vision.scale_space import recursive
from imgu_ros.vision.scale_space.recursive import smooth_recursively

MODES = {"constant": "constant", "periodic": "wrap", "reflected": "reflect", "mirrored": "symmetric"}
MODES["replicated"] = "edge"


def response(sigma):
    reach = math.ceil(12 * sigma) + 20
    image = np.zeros((1, 2 * reach + 1), np.float32)
    image[0, reach] = 1
    return smooth_recursively(image, sigma)[0].astype(float), np.arange(-reach, reach + 1)


@pytest.mark.parametrize("sigma", [1.0, 1.3, 2.0, 5.0, 10.0, 50.0, 200.0])
def test_impulse_response_is_the_gaussian(sigma):
    got, n = response(sigma)
    gaussian = np.exp(-(n**2) / (2 * sigma**2)) / (sigma * math.sqrt(2 * math.pi))
    assert np.abs(got - gaussian).max() < 0.0004 * gaussian.max()
    assert got.sum() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("sigma", [0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 3.0, 17.0, 50.0, 100.0])
def test_variance_is_sigma_squared(sigma):
    got, n = response(sigma)
    assert (got * n).sum() / got.sum() == pytest.approx(0, abs=1e-4 * sigma)
    assert (got * n**2).sum() / got.sum() == pytest.approx(sigma**2, rel=1e-4)


@pytest.mark.parametrize("sigma", [0.6, 2.5, 20.0])
def test_it_is_the_recursion_of_fourth_order(sigma):
    """The same response from a difference equation of four coefficients, pixel after pixel, in float64."""
    poles = recursive._response(sigma).poles
    got, n = response(sigma)
    denominator = np.poly(np.concatenate([poles, poles.conj()])).real
    assert len(denominator) == 5
    forward = got[n >= 0]
    # What is left when the recursion is undone: four coefficients, and nothing after them.
    rest = lfilter(denominator, [1.0], forward)
    assert np.abs(rest[4:]).max() < 1e-6 * forward[0]
    np.testing.assert_allclose(
        lfilter(rest[:4], denominator, np.eye(1, len(forward))[0]), forward, atol=1e-4 * got.max()
    )


@given(st.sampled_from(list(Border)), st.integers(1, 75), st.integers(1, 75), st.floats(0.2, 6), st.integers(0, 2**32))
def test_borders_go_on_for_ever(border, height, width, sigma, seed):
    image = np.random.default_rng(seed).random((height, width), np.float32)
    margin = math.ceil(10 * sigma) + 5
    extra = {"constant_values": 0.5} if border is Border.CONSTANT else {}
    wide = np.pad(image, margin, mode=MODES[border], **extra)
    # Far from the borders of the wide picture, which does not matter how it goes on.
    expected = smooth_recursively(wide, sigma, "replicated")[margin:-margin, margin:-margin]
    np.testing.assert_allclose(smooth_recursively(image, sigma, border, 0.5), expected, atol=5e-6)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("border", ["periodic", "reflected", "mirrored", "replicated"])
def test_constant_pictures_stay(dtype, border):
    for shape in [(1, 1), (1, 100), (33, 2), (40, 50, 3)]:
        image = np.full(shape, 200, dtype)
        for sigma in (0.3, 2.0, 300.0):
            got = smooth_recursively(image, sigma, border)
            assert got.shape == shape and got.dtype == dtype
            np.testing.assert_allclose(got, image, rtol=1e-5)


def test_axes_and_channels_are_treated_alike():
    image = np.random.default_rng(1).random((45, 70, 3), np.float32)
    got = smooth_recursively(image, 3.0)
    np.testing.assert_allclose(smooth_recursively(image.transpose(1, 0, 2), 3.0).transpose(1, 0, 2), got, atol=2e-6)
    for c in range(3):
        np.testing.assert_allclose(smooth_recursively(image[..., c].copy(), 3.0), got[..., c], atol=2e-6)


def test_large_sigma_loses_no_digits():
    """In float32, where a recursion over single pixels would lose sigma^3 units in the last place."""
    rng = np.random.default_rng(2)
    image = rng.random((1, 3000), np.float32)
    sigma = 300.0
    n = np.arange(-2999, 3000)
    weights = np.exp(-(n**2) / (2 * sigma**2))
    expected = np.convolve(np.pad(image[0].astype(float), 2999, mode="reflect"), weights / weights.sum(), mode="valid")
    assert np.abs(smooth_recursively(image, sigma)[0] - expected).max() < 2e-4


def test_the_work_does_not_depend_on_sigma(monkeypatch):
    """Counted, not timed: multiplications by all matrix products, for sigma 1 and 50."""
    counted = []
    product = recursive._product

    def counting(matrix, lines):
        counted[-1] += matrix.size * lines.size // lines.shape[-2]
        return product(matrix, lines)

    monkeypatch.setattr(recursive, "_product", counting)
    image = np.random.default_rng(3).random((640, 640), np.float32)
    for sigma in (1.0, 50.0):
        counted.append(0)
        smooth_recursively(image, sigma)
    # All that differs is how much of the picture the states at its ends are gathered from. Blocks take 40 and 8
    # multiplications for each pixel, along each axis.
    blocks = 2 * (40 + 8) * image.size
    assert counted[0] <= counted[1] < counted[0] + 0.2 * blocks
    assert counted[1] < blocks


@pytest.mark.parametrize(
    "call",
    [
        lambda: smooth_recursively(np.zeros((4, 4), np.uint8), 0.01),
        lambda: smooth_recursively(np.zeros((4, 4), np.uint8), math.nan),
        lambda: smooth_recursively(np.zeros((4, 4), np.uint8), 1001),
        lambda: smooth_recursively(np.zeros((4, 4), np.uint8), 1.0, "round"),
        lambda: smooth_recursively(np.zeros((4, 4), np.uint8), 1.0, "constant", 256),
        lambda: smooth_recursively(np.full((4, 4), 3e38, np.float32), 1.0),
        lambda: smooth_recursively(np.zeros((4, 4), complex), 1.0),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        call()
