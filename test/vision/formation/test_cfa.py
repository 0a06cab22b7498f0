# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic, site_mask

PATTERNS = list(BayerPattern)


def test_mosaic_of_a_hand_made_picture():
    rgb = np.arange(36, dtype=np.uint8).reshape(3, 4, 3)  # pixel n holds 3n, 3n + 1, 3n + 2
    assert mosaic(rgb, BayerPattern.RGGB).tolist() == [[0, 4, 6, 10], [13, 17, 19, 23], [24, 28, 30, 34]]
    assert mosaic(rgb, BayerPattern.GBRG).tolist() == [[1, 5, 7, 11], [12, 16, 18, 22], [25, 29, 31, 35]]


@pytest.mark.parametrize(
    ("pattern", "below", "right", "diagonal"),
    [("rggb", "gbrg", "grbg", "bggr"), ("bggr", "grbg", "gbrg", "rggb"), ("grbg", "bggr", "rggb", "gbrg")],
)
def test_shifted_pattern_by_hand(pattern, below, right, diagonal):
    known = BayerPattern(pattern)
    assert (known.shifted(1, 0), known.shifted(0, 1), known.shifted(1, 1)) == (below, right, diagonal)
    assert known.shifted(4, -2) is known
    assert known.shifted(-1, 3) is known.shifted(1, 1)


@given(st.sampled_from(PATTERNS), st.integers(0, 5), st.integers(0, 5), st.integers(0, 2**32))
def test_cropping_commutes_with_the_mosaic(pattern, rows, columns, seed):
    rgb = np.random.default_rng(seed).integers(0, 65536, (7, 9, 3), np.uint16)
    cropped = mosaic(np.ascontiguousarray(rgb[rows:, columns:]), pattern.shifted(rows, columns))
    np.testing.assert_array_equal(cropped, mosaic(rgb, pattern)[rows:, columns:])


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (5, 4), (0, 3)])
def test_masks_are_where_the_mosaic_takes_the_color(pattern, shape):
    masks = [site_mask(shape, pattern, color) for color in "rgb"]
    assert all(mask.dtype == bool and mask.shape == shape for mask in masks)
    np.testing.assert_array_equal(np.sum(masks, axis=0), np.ones(shape, int))
    for row in range(shape[0]):
        for column in range(shape[1]):
            assert masks["rgb".index(pattern[2 * (row % 2) + column % 2])][row, column]


@pytest.mark.parametrize("dtype", [">u2", ">f4"])
def test_big_endian_pictures_come_out_native(dtype):
    rgb = np.arange(48).reshape(4, 4, 3)
    got = mosaic(rgb.astype(dtype), BayerPattern.RGGB)
    assert got.dtype.isnative
    np.testing.assert_array_equal(got, mosaic(rgb.astype(np.uint16), BayerPattern.RGGB))


@pytest.mark.parametrize(
    ("rgb", "pattern"),
    [
        (np.zeros((4, 4), np.uint8), "rggb"),
        (np.zeros((0, 4, 3), np.uint8), "rggb"),
        (np.full((4, 4, 3), -1), "rggb"),
        ([[[1, 2, 3]]], "rggb"),
        (np.full((2, 2, 3), np.nan, np.float32), "rggb"),
        (np.zeros((4, 4, 3), np.uint8), "rgbg"),
        (np.zeros((4, 4, 3), np.uint8), None),
    ],
)
def test_bad_pictures_and_patterns_are_refused(rgb, pattern):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        mosaic(rgb, pattern)


@pytest.mark.parametrize(
    ("shape", "pattern", "color"), [((2, 2), "rggb", "x"), ((2, 2), "q", "r"), ((-1, 2), "rggb", "r")]
)
def test_bad_masks_are_refused(shape, pattern, color):
    with pytest.raises(ShapeError):
        site_mask(shape, pattern, color)
