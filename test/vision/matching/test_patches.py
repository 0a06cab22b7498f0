# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.matching.patches import ncc, ssd, zmssd

seeds = st.integers(0, 2**32).map(np.random.default_rng)
sizes = st.tuples(st.integers(1, 6), st.integers(2, 6))


@given(seeds, sizes)
def test_by_the_sums_of_the_notes(rng, size):
    a, b = rng.uniform(-50, 50, size), rng.uniform(-50, 50, size)
    pixels = list(zip(a.ravel().tolist(), b.ravel().tolist(), strict=True))
    n = len(pixels)
    mean_a, mean_b = math.fsum(p for p, _ in pixels) / n, math.fsum(q for _, q in pixels) / n
    assert ssd(a, b) == pytest.approx(math.fsum((p - q) ** 2 for p, q in pixels))
    assert zmssd(a, b) == pytest.approx(math.fsum(((p - mean_a) - (q - mean_b)) ** 2 for p, q in pixels), abs=1e-9)
    sigma_a = math.sqrt(math.fsum((p - mean_a) ** 2 for p, _ in pixels) / (n - 1))
    sigma_b = math.sqrt(math.fsum((q - mean_b) ** 2 for _, q in pixels) / (n - 1))
    total = math.fsum((p - mean_a) * (q - mean_b) / (sigma_a * sigma_b) for p, q in pixels)
    assert ncc(a, b) == pytest.approx(total / (n - 1), abs=1e-9)


@given(seeds, sizes, st.integers(-1000, 1000), st.integers(1, 50))
def test_invariances(rng, size, offset, gain):
    a, b = rng.integers(0, 256, size), rng.integers(0, 256, size)
    a.flat[0], b.flat[0] = 256, 300  # never constant
    a.flat[1], b.flat[1] = 0, 10
    assert ssd(a + offset, b + offset) == ssd(a, b) == ssd(b, a)  # whole numbers: exact
    assert zmssd(a + offset, b) == pytest.approx(zmssd(a, b), rel=1e-12, abs=1e-9)
    assert zmssd(a + offset, a) == 0
    assert ncc(gain * a + offset, b) == pytest.approx(ncc(a, b), abs=1e-12)
    assert ncc(-gain * a + offset, b) == pytest.approx(-ncc(a, b), abs=1e-12)
    assert ncc(a, gain * a + offset) == pytest.approx(1, abs=1e-12)
    assert -1 <= ncc(a, b) <= 1
    # For patches of unit variance the three say the same: zmssd = 2 (N - 1) (1 - ncc).
    p, q = ((x - x.mean()) / x.std(ddof=1) for x in (a, b))
    assert zmssd(p, q) == pytest.approx(2 * (a.size - 1) * (1 - ncc(a, b)), abs=1e-9)


def test_by_hand():
    a, b = np.array([[0, 2], [4, 6]]), np.array([[1, 1], [5, 9]])
    assert ssd(a, b) == 1 + 1 + 1 + 9
    assert zmssd(a, b) == 0 + 4 + 0 + 4
    assert ncc(a, b) == pytest.approx((9 + 3 + 1 + 15) / math.sqrt(20 * 44))


def test_unsigned_pixels_do_not_wrap():
    dark, bright = np.zeros((2, 2), np.uint8), np.full((2, 2), 255, np.uint8)
    assert ssd(dark, bright) == 4 * 255**2
    assert zmssd(dark, bright) == 0


def test_sizes_of_numbers():
    a = np.array([1.0, 2, 4])
    assert ncc(a * 1e140, a * 1e-140) == pytest.approx(1)
    assert math.isfinite(ssd(a * 1e149, -a * 1e149))


@pytest.mark.parametrize("function", [ssd, zmssd, ncc])
@pytest.mark.parametrize(
    ("a", "b"),
    [
        (np.zeros((2, 2)), np.zeros((2, 3))),
        (np.zeros((0, 2)), np.zeros((0, 2))),
        (np.array([1.0, math.nan]), np.ones(2)),
        (np.ones(2), np.array([1.0, math.inf])),
        (np.array([1e160, 0]), np.ones(2)),
        (np.array([1j, 0]), np.ones(2)),
        ("ab", "cd"),
        (None, np.ones(2)),
    ],
)
def test_bad_patches_are_refused(function, a, b):
    with pytest.raises(ShapeError, match="need"):
        function(a, b)


@pytest.mark.parametrize("constant", [np.full((3, 3), 0.1), np.zeros(4), [7]])
def test_a_constant_patch_has_no_correlation(constant):
    other = np.arange(np.size(constant)).reshape(np.shape(constant))
    with pytest.raises(ShapeError, match=r"^a: constant; need contrast$"):
        ncc(constant, other)
