# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.levels import stretched_to_8_bit, with_levels


def test_levels_and_gains_by_hand():
    raw = np.array([[100, 300], [300, 500], [50, 1000]], np.uint16)
    # rggb: (raw - 100) / 800 * 65535 * gain, clamped; gains 2, 1, 0.5
    expected = [[0, 200 / 800 * 65535], [200 / 800 * 65535, 400 / 800 * 65535 * 0.5], [0, 65535]]
    got = with_levels(raw, BayerPattern.RGGB, 100, 900, (2.0, 1.0, 0.5))
    assert got.dtype == np.uint16
    np.testing.assert_allclose(got, expected, atol=0.51)


@given(
    st.sampled_from(list(BayerPattern)),
    st.sampled_from([np.uint8, np.uint16]),
    st.floats(0, 100),
    st.floats(101, 255),
    st.tuples(*[st.floats(0.01, 100)] * 3),
    st.integers(0, 2**32),
)
def test_levels_by_definition(pattern, dtype, black, white, gains, seed):
    top = np.iinfo(dtype).max
    raw = np.random.default_rng(seed).integers(0, 256, (5, 6)).astype(dtype)
    got = with_levels(raw, pattern, black, white, gains)
    assert got.dtype == dtype
    for (row, column), value in np.ndenumerate(raw):
        gain = gains["rgb".index(pattern.value[2 * (row % 2) + column % 2])]
        exact = (int(value) - black) / (white - black) * top * gain
        # single precision inside: a few parts in 10^7 of the terms that are added
        slack = 1e-6 * top * gain * (255 + black) / (white - black)
        assert abs(int(got[row, column]) - min(max(exact, 0), top)) <= 0.5 + slack


def test_nothing_to_do_returns_the_input():
    raw = np.arange(16, dtype=np.uint8).reshape(4, 4)
    for same in (
        with_levels(raw, BayerPattern.RGGB, 0, 0),
        with_levels(raw, BayerPattern.RGGB, 0, 255),
        stretched_to_8_bit(raw, 0, 255),
    ):
        assert np.shares_memory(same, raw)
        np.testing.assert_array_equal(same, raw)


def test_white_zero_is_full_scale():
    raw = np.array([[55, 255], [155, 105]], np.uint8)
    np.testing.assert_allclose(with_levels(raw, "rggb", 55, 0), (raw - 55.0) * 255 / 200, atol=0.51)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1)])
def test_single_rows_and_columns(shape):
    raw = np.full(shape, 60, np.uint8)
    np.testing.assert_array_equal(with_levels(raw, "rggb", 10, 60), np.full(shape, 255))


@pytest.mark.parametrize(
    ("black", "white", "gains"),
    [
        (255, 0, (1, 1, 1)),
        (300, 0, (1, 1, 1)),
        (10, 10, (1, 1, 1)),
        (20, 10, (1, 1, 1)),
        (math.nan, 0, (1, 1, 1)),
        (0, math.inf, (1, 1, 1)),
        (0, 0, (1, 1)),
        (0, 0, (1, 1, 1, 1)),
        (0, 0, (1, math.nan, 1)),
        (0, 0, (1, -1, 1)),
    ],
)
def test_impossible_levels_are_refused(black, white, gains):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        with_levels(np.zeros((4, 4), np.uint8), "rggb", black, white, gains)


def test_bad_images_are_refused():
    for raw in (np.zeros((0, 2), np.uint8), np.zeros((2, 2), np.float32), np.zeros((2, 2, 3), np.uint8), [[1]]):
        with pytest.raises(ShapeError):
            with_levels(raw, "rggb", 0, 100)
    with pytest.raises(ShapeError):
        with_levels(np.zeros((4, 4), np.uint8), "bayer", 1, 100)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, ">u2", ">f4"])
def test_known_range_by_definition(dtype):
    grey = np.arange(0, 250, 7).reshape(6, 6).astype(dtype)
    exact = np.clip((grey.astype(float) - 20) / 150 * 255, 0, 255)
    got = stretched_to_8_bit(grey, 20, 170)
    assert got.dtype == np.uint8
    np.testing.assert_allclose(got, exact, atol=0.501)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_percentiles_set_the_range(dtype):
    # 1000 values 0 ... 999 (or 0 ... 249): quantile q of evenly spread values is q times the largest.
    largest = 249 if dtype == np.uint8 else 999
    grey = np.linspace(0, largest, 1000).round().astype(dtype)
    grey = np.random.default_rng(0).permutation(grey).reshape(25, 40)
    low, high = 0.002 * largest, 0.998 * largest
    exact = np.clip((grey.astype(float) - low) / (high - low) * 255, 0, 255)
    np.testing.assert_allclose(stretched_to_8_bit(grey, 0, None), exact, atol=1.6)


def test_hot_pixels_do_not_set_the_range():
    grey = np.random.default_rng(1).integers(1000, 2000, (400, 600)).astype(np.uint16)
    clean = stretched_to_8_bit(grey, 0, None)
    grey[::100, ::100] = 65535
    assert np.abs(stretched_to_8_bit(grey, 0, None).astype(int) - clean)[1:, 1:].mean() < 1


def test_large_pictures_are_sampled_for_their_range():
    y, x = np.mgrid[:1200, :1600]
    grey = (1000 + x + y).astype(np.uint16)
    exact = np.clip((grey - 1000.0) / (1199 + 1599) * 255, 0, 255)
    assert np.abs(stretched_to_8_bit(grey, 0, None) - exact).max() < 12
    assert stretched_to_8_bit(grey, 0, None).min() == 0 and stretched_to_8_bit(grey, 0, None).max() == 255


@pytest.mark.parametrize("value", [0, 7, 255])
def test_no_contrast_is_black(value):
    for dtype in (np.uint8, np.uint16, np.float32):
        assert not stretched_to_8_bit(np.full((5, 4), value, dtype), 0, None).any()


def test_small_range_on_a_large_offset():
    kelvin = np.linspace(300.0, 300.01, 256, dtype=np.float32).reshape(16, 16)
    low, high = float(kelvin.min()), float(kelvin.max())
    exact = (kelvin.astype(float) - low) / (high - low) * 255
    np.testing.assert_allclose(stretched_to_8_bit(kelvin, low, high), exact, atol=0.51)


@pytest.mark.parametrize(
    ("grey", "black", "white"),
    [
        (np.full((4, 4), np.nan, np.float32), 0, None),
        (np.array([[0, np.inf]], np.float32), 0, 1),
        (np.zeros((4, 4), complex), 0, 1),
        (np.zeros((0, 4), np.uint8), 0, None),
        (np.zeros((4, 4, 3), np.uint8), 0, None),
        (np.zeros((4, 4), np.uint8), 10, 10),
        (np.zeros((4, 4), np.uint8), 10, 5),
        (np.zeros((4, 4), np.uint8), math.nan, 5),
    ],
)
def test_bad_grey_is_refused(grey, black, white):
    with pytest.raises(ShapeError):
        stretched_to_8_bit(grey, black, white)
