# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import convolve2d

from imgu_ros.errors import ShapeError
from imgu_ros.vision.processing.borders import Border, padded, source_index
from imgu_ros.vision.processing.convolution import convolve, convolve_separable, mean_filtered
from imgu_ros.vision.processing.separability import is_separable, split
from imgu_ros.vision.scale_space.gaussian import smooth
from imgu_ros.vision.scale_space.kernels import sampled_gaussian

NUMPY_MODES = {
    Border.PERIODIC: "wrap",
    Border.REFLECTED: "reflect",
    Border.MIRRORED: "symmetric",
    Border.REPLICATED: "edge",
}


def continued(image, x, y, border, value=0.0):
    """The picture with a margin, by numpy."""
    margins = [(y, y), (x, x)] + [(0, 0)] * (image.ndim - 2)
    if border is Border.CONSTANT:
        return np.pad(image, margins, constant_values=value)
    return np.pad(image, margins, mode=NUMPY_MODES[border])


def direct(image, kernel, border, value=0.0):
    """The definition, in float64."""
    y, x = (n // 2 for n in kernel.shape)
    return convolve2d(continued(image.astype(float), x, y, border, value), kernel, mode="valid")


borders = st.sampled_from(list(Border))
shapes = st.tuples(st.integers(1, 14), st.integers(1, 14))
odd = st.integers(0, 7).map(lambda n: 2 * n + 1)


@given(shapes, odd, odd, borders, st.integers(0, 2**32))
def test_convolution_equals_the_definition(shape, height, width, border, seed):
    rng = np.random.default_rng(seed)
    image = rng.random(shape, np.float32)
    kernel = rng.normal(size=(height, width))
    got = convolve(image, kernel, border, 0.25)
    np.testing.assert_allclose(got, direct(image, kernel, border, 0.25), atol=1e-6 * np.abs(kernel).sum())


@pytest.mark.parametrize("border", Border)
@pytest.mark.parametrize("size", [3, 9, 15, 31, 51])
def test_separable_and_large_kernels_equal_the_definition(size, border):
    rng = np.random.default_rng(size)
    image = rng.random((40, 60), np.float32)
    for kernel in (np.outer(rng.random(size), rng.random(size)), rng.random((size, size))):
        kernel /= kernel.sum()
        np.testing.assert_allclose(convolve(image, kernel, border, 0.5), direct(image, kernel, border, 0.5), atol=1e-6)


@pytest.mark.parametrize(("dtype", "full"), [(np.uint8, 255), (np.uint16, 65535)])
@pytest.mark.parametrize("size", [3, 7, 15])
def test_integer_pictures_keep_signs_and_fractions(dtype, full, size):
    rng = np.random.default_rng(3)
    image = rng.integers(0, full, (20, 30), endpoint=True).astype(dtype)
    for kernel in (rng.normal(size=(size, size)), np.outer(rng.normal(size=size), rng.normal(size=size))):
        got = convolve(image, kernel)
        assert got.dtype == np.float32
        expected = direct(image, kernel, Border.REFLECTED)
        np.testing.assert_allclose(got, expected, atol=1e-6 * full * np.abs(kernel).sum())


def test_the_kernel_is_flipped_and_an_impulse_gives_it_back():
    image = np.zeros((7, 9), np.float32)
    image[3, 4] = 1
    kernel = np.arange(15.0).reshape(3, 5)
    np.testing.assert_array_equal(convolve(image, kernel)[2:5, 2:7], kernel)


def test_convolution_commutes_and_associates():
    rng = np.random.default_rng(5)
    image = rng.random((12, 17), np.float32)
    a, b = rng.random((3, 5)), rng.random((5, 3))
    once = convolve(image, convolve2d(a, b), "periodic")
    np.testing.assert_allclose(convolve(convolve(image, a, "periodic"), b, "periodic"), once, rtol=1e-5)
    np.testing.assert_allclose(convolve(convolve(image, b, "periodic"), a, "periodic"), once, rtol=1e-5)


def test_channels_are_filtered_alone():
    image = np.random.default_rng(6).random((9, 8, 3), np.float32)
    kernel = np.random.default_rng(7).random((3, 3))
    for c in range(3):
        np.testing.assert_allclose(convolve(image, kernel)[..., c], convolve(image[..., c].copy(), kernel), atol=1e-6)


@given(shapes, st.integers(0, 4), borders, st.sampled_from([np.uint8, np.uint16, np.float32]))
def test_mean_is_the_mean(shape, reach, border, dtype):
    rng = np.random.default_rng(reach)
    image = (rng.random(shape) * (1 if dtype == np.float32 else 200)).astype(dtype)
    size = 2 * reach + 1
    expected = direct(image, np.full((size, size), size**-2.0), border, 0.5 if dtype == np.float32 else 100)
    got = mean_filtered(image, size, border, 0.5 if dtype == np.float32 else 100)
    assert got.dtype == dtype
    np.testing.assert_allclose(got, expected, atol=1e-6 if dtype == np.float32 else 0.5001)


@pytest.mark.parametrize("border", Border)
def test_gaussian_with_every_border(border):
    image = np.random.default_rng(8).random((14, 19), np.float32)
    k = sampled_gaussian(1.5)
    np.testing.assert_allclose(
        smooth(image, 1.5, "sampled", border, 0.75), direct(image, np.outer(k, k), border, 0.75), atol=1e-6
    )


@given(shapes, st.integers(0, 40), st.integers(0, 40), borders)
def test_margins_by_numpy(shape, x, y, border):
    image = np.arange(shape[0] * shape[1], dtype=np.uint8).reshape(shape)
    np.testing.assert_array_equal(padded(image, x, y, border, 7), continued(image, x, y, border, 7))


@given(st.integers(1, 9), borders)
def test_source_index_is_what_padding_copies(size, border):
    row = np.arange(1, size + 1, dtype=np.uint8)[None]
    index = source_index(np.arange(-20, size + 20), size, border)
    np.testing.assert_array_equal(np.where(index < 0, 0, row[0, index]), padded(row, 20, 0, border)[0])


# ---------------------------------------------------------------------------------------------------------------------
# Separability


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 9), st.integers(0, 2**32))
def test_split_has_the_rank_and_adds_up(height, width, rank, seed):
    rng = np.random.default_rng(seed)
    rank = min(rank, height, width)
    kernel = rng.normal(size=(height, rank)) @ rng.normal(size=(rank, width))
    parts = split(kernel)
    assert parts.rank == np.linalg.matrix_rank(kernel, tol=1e-7 * np.linalg.norm(kernel, 2)) <= rank
    np.testing.assert_allclose(parts.columns.T @ parts.rows, kernel, atol=1e-6 * (1 + np.abs(kernel).max()))
    assert parts.multiplications == parts.rank * (height + width)


def test_known_kernels():
    assert is_separable(np.ones((3, 3)) / 9)
    assert is_separable([[1, 0, -1], [2, 0, -2], [1, 0, -1]])
    assert not is_separable([[0, 1, 0], [1, -4, 1], [0, 1, 0]])
    assert split([[0, 1, 0], [1, -4, 1], [0, 1, 0]]).rank == 2
    gaussian = np.outer(sampled_gaussian(3), sampled_gaussian(3))
    assert is_separable(gaussian) and is_separable(gaussian.astype(np.float32))
    assert split(np.zeros((3, 5))).rank == 0


def test_the_split_saves_multiplications_and_is_taken(monkeypatch):
    """25 x 25 weights take 625 multiplications for each pixel; split, 50."""
    kernel = np.outer(sampled_gaussian(3), sampled_gaussian(3))
    assert kernel.size == 625 and split(kernel).multiplications == 50
    taken = []
    from imgu_ros.vision.processing import convolution

    for name in ("filter2D", "sepFilter2D"):
        function = getattr(convolution.cv2, name)
        monkeypatch.setattr(
            convolution.cv2, name, lambda *a, _f=function, _n=name, **k: (taken.append(_n), _f(*a, **k))[1]
        )
    image = np.random.default_rng(9).random((30, 30), np.float32)
    convolve(image, kernel)
    convolve(image, np.random.default_rng(0).random((5, 5)))
    assert taken == ["sepFilter2D", "filter2D"]


@pytest.mark.parametrize(
    "call",
    [
        lambda: convolve(np.zeros((4, 4), np.uint8), np.ones((2, 3))),
        lambda: convolve(np.zeros((4, 4), np.uint8), np.ones(3)),
        lambda: convolve(np.zeros((4, 4), np.uint8), [[np.nan]]),
        lambda: convolve(np.zeros((4, 4), np.uint8), [[1e31]]),
        lambda: convolve(np.zeros((4, 4), np.uint8), [["a"]]),
        lambda: convolve(np.zeros((4, 4), np.uint8), [[1, 2], [3]]),
        lambda: convolve(np.full((4, 4), 3e38, np.float32), np.ones((3, 3))),
        lambda: convolve(np.zeros((4, 4), np.uint8), [[1]], "round"),
        lambda: convolve(np.zeros((4, 4), np.uint8), [[1]], "constant", 256),
        lambda: convolve_separable(np.zeros((4, 4), np.uint8), [1, 2], [1]),
        lambda: convolve_separable(np.zeros((4, 4), np.uint8), [[1]], [1]),
        lambda: mean_filtered(np.zeros((4, 4), np.uint8), 2),
        lambda: padded(np.zeros((4, 4), np.uint8), -1, 0),
        lambda: source_index([0.5], 3, "periodic"),
        lambda: source_index([0], 0, "periodic"),
        lambda: split(np.zeros((0, 3))),
        lambda: split([[1.0]], tolerance=2),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        call()
