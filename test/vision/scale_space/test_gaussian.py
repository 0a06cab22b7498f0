# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.scale_space.gaussian import smooth


def kernel(sigma: float, reach: int):
    weights = [math.exp(-(n**2) / (2 * sigma**2)) for n in range(-reach, reach + 1)]
    return np.array(weights) / sum(weights)


def convolved(image, sigma, reach):
    """The definition: a product with the kernel along each axis, borders mirrored about the outermost pixel."""
    k = kernel(sigma, reach)
    padded = np.pad(image.astype(float), reach, mode="reflect")
    rows = np.apply_along_axis(np.convolve, 1, padded, k, mode="valid")
    return np.apply_along_axis(np.convolve, 0, rows, k, mode="valid")


@given(st.floats(0.3, 4.0), st.integers(0, 2**32))
def test_float_pictures_by_definition(sigma, seed):
    image = np.random.default_rng(seed).random((21, 26), np.float32)
    np.testing.assert_allclose(smooth(image, sigma), convolved(image, sigma, math.ceil(4 * sigma)), atol=2e-6)


@pytest.mark.parametrize("sigma", [0.5, 0.8, 1.6, 3.0])
@pytest.mark.parametrize(("dtype", "reach", "atol"), [(np.uint8, 3, 2.0), (np.uint16, 4, 2.0)])
def test_integer_pictures_by_definition(sigma, dtype, reach, atol):
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (40, 33)).astype(dtype)
    got = smooth(image, sigma)
    assert got.dtype == dtype
    np.testing.assert_allclose(got, convolved(image, sigma, math.ceil(reach * sigma)), atol=atol)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (2, 2), (20, 30), (20, 30, 3)])
def test_constant_pictures_stay(dtype, shape):
    image = np.full(shape, 200, dtype)
    for sigma in (0.4, 2.0, 9.0):
        got = smooth(image, sigma)
        assert got.shape == shape and got.dtype == dtype
        np.testing.assert_allclose(got, image, rtol=1e-6)


@given(st.floats(1, 3), st.floats(1, 3))
def test_variances_add(first, second):
    image = np.zeros((81, 81), np.float32)
    image[40, 40] = 1
    once = smooth(image, math.hypot(first, second))
    twice = smooth(smooth(image, first), second)
    assert np.abs(once - twice).max() < 0.01 * once.max()


@pytest.mark.parametrize("kernel_name", ["sampled", "discrete", "recursive"])
@pytest.mark.parametrize(
    ("dtype", "full", "atol"), [(np.uint8, 255, 1.5), (np.uint16, 65535, 80.0), (np.float32, 1, 2e-3)]
)
@pytest.mark.parametrize("sigma", [1.0, 2.3, 6.0])
def test_every_kernel_is_a_gaussian_for_every_data_type(kernel_name, dtype, full, atol, sigma):
    y, x = np.mgrid[-45:46, -52:53]
    blob = 0.9 * np.exp(-(x**2 + y**2) / (2 * 5.0**2))
    # A Gaussian of sigma 5 smoothed by another: variances add, the height falls as they rise.
    wide = 25 + sigma**2
    expected = 0.9 * 25 / wide * np.exp(-(x**2 + y**2) / (2 * wide))
    got = smooth((full * blob).astype(dtype), sigma, kernel_name)
    assert got.dtype == dtype
    np.testing.assert_allclose(got, full * expected, atol=atol)


@pytest.mark.parametrize("kernel_name", ["sampled", "discrete", "recursive"])
@pytest.mark.parametrize("border", ["constant", "periodic", "reflected", "mirrored", "replicated"])
def test_every_kernel_with_every_border(kernel_name, border):
    rng = np.random.default_rng(5)
    image = rng.random((22, 31), np.float32)
    modes = {"constant": "constant", "periodic": "wrap", "reflected": "reflect", "mirrored": "symmetric"}
    extra = {"constant_values": 0.25} if border == "constant" else {}
    wide = np.pad(image, 40, mode=modes.get(border, "edge"), **extra)
    expected = smooth(wide, 3.0, kernel_name)[40:-40, 40:-40]
    np.testing.assert_allclose(smooth(image, 3.0, kernel_name, border, 0.25), expected, atol=5e-6)


@given(st.floats(0.1, 0.8), st.floats(0.1, 0.8))
def test_small_steps_of_the_discrete_kernel_add_up(first, second):
    """Where the sampled kernel's variances fall short."""
    image = np.zeros((31, 31), np.float32)
    image[15, 15] = 1
    once = smooth(image, math.hypot(first, second), "discrete")
    twice = smooth(smooth(image, first, "discrete"), second, "discrete")
    assert np.abs(once - twice).max() < 1e-4


def test_channels_are_smoothed_alone():
    image = np.random.default_rng(2).random((15, 17, 3), np.float32)
    for channel in range(3):
        plane = np.ascontiguousarray(image[..., channel])
        np.testing.assert_allclose(smooth(image, 1.3)[..., channel], smooth(plane, 1.3), atol=1e-6)


def test_sigma_zero_and_the_input_is_left_alone():
    image = np.random.default_rng(3).integers(0, 256, (9, 9), np.uint8)
    kept = image.copy()
    image.flags.writeable = False
    np.testing.assert_array_equal(smooth(image, 0), kept)
    smooth(image, 2)
    np.testing.assert_array_equal(image, kept)


def test_byte_order_and_strides_do_not_matter():
    image = np.random.default_rng(4).integers(0, 65536, (12, 10), np.uint16)
    expected = smooth(image, 1.5)
    np.testing.assert_array_equal(smooth(image.astype(">u2"), 1.5), expected)
    np.testing.assert_array_equal(smooth(np.asfortranarray(image), 1.5), expected)


@pytest.mark.parametrize("sigma", [-1, math.nan, math.inf, 1e6])
def test_bad_sigma_is_refused(sigma):
    with pytest.raises(ShapeError, match="sigma"):
        smooth(np.zeros((4, 4), np.uint8), sigma)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((0, 0), np.uint8),
        np.zeros((4, 4, 2), np.uint8),
        np.zeros((4, 4), complex),
        np.full((4, 4), -1, np.int16),
        np.full((4, 4), np.nan, np.float32),
        np.zeros(4, np.uint8),
        "picture",
    ],
)
def test_bad_pictures_are_refused(image):
    with pytest.raises(ShapeError):
        smooth(image, 1)
