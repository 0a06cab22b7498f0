# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.scale_space.gaussian import GaussianKernel
from imgu_ros.vision.scale_space.laplacian import LaplacianPyramid, laplacian_pyramid, reconstructed
from imgu_ros.vision.scale_space.pyramid import band_passed, build_pyramid

shapes = st.one_of(
    st.tuples(st.integers(1, 70), st.integers(1, 70)),
    st.tuples(st.integers(1, 30), st.integers(1, 30), st.just(3)),
)
kernels = st.sampled_from(list(GaussianKernel))


@given(shapes, st.integers(0, 8), kernels, st.sampled_from([np.uint8, np.uint16]), st.integers(0, 2**32))
def test_integer_pictures_come_back_bit_for_bit(shape, levels, kernel, dtype, seed):
    rng = np.random.default_rng(seed)
    image = rng.integers(0, np.iinfo(dtype).max, shape, endpoint=True).astype(dtype)
    parts = laplacian_pyramid(image, levels, kernel)
    back = reconstructed(parts)
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, image)


@given(shapes, st.integers(0, 8), kernels, st.floats(1e-3, 1e6), st.integers(0, 2**32))
def test_float_pictures_come_back_to_one_unit_in_the_last_place(shape, levels, kernel, scale, seed):
    image = (scale * np.random.default_rng(seed).random(shape)).astype(np.float32)
    back = reconstructed(laplacian_pyramid(image, levels, kernel))
    assert np.abs(back - image).max() <= np.spacing(np.float32(scale))


def test_levels_halve_and_bands_hold_what_was_lost():
    image = np.random.default_rng(0).integers(0, 256, (53, 80)).astype(np.uint8)
    parts = laplacian_pyramid(image, 3)
    assert [b.shape for b in parts.bands] == [(53, 80), (26, 40), (13, 20)] and parts.base.shape == (6, 10)
    assert all(b.dtype == np.int16 for b in parts.bands) and parts.base.dtype == np.uint8
    assert laplacian_pyramid(image, 32).base.shape == (1, 1)
    flat = laplacian_pyramid(np.full((40, 40), 99, np.uint8), 3)
    assert all(not b.any() for b in flat.bands)


def test_each_band_answers_to_its_own_wavelength():
    """The energy of a wave of 2^k x 5 px is largest in band k."""
    y, x = np.mgrid[:256, :256]
    for k in range(4):
        wave = 0.5 + 0.4 * np.sin(2 * np.pi * (0.8 * x + 0.6 * y) / (5 * 2**k))
        energies = [float(b.std()) for b in laplacian_pyramid(wave.astype(np.float32), 5).bands]
        assert int(np.argmax(energies)) in (k, k + 1)
        assert energies[max(k - 2, 0)] < 0.5 * max(energies) or k < 2


def test_edited_bands_are_clamped():
    image = np.random.default_rng(1).integers(0, 256, (30, 30)).astype(np.uint8)
    parts = laplacian_pyramid(image, 2)
    stronger = reconstructed(LaplacianPyramid(tuple((3 * b).astype(np.int16) for b in parts.bands), parts.base))
    assert stronger.dtype == np.uint8 and stronger.std() > image.std()
    assert stronger.min() == 0 and stronger.max() == 255


@pytest.mark.parametrize(
    ("dtype", "full", "middle"), [(np.uint8, 255, 128), (np.uint16, 65535, 32768), (np.float32, 1, 0.5)]
)
def test_bands_of_the_chain_are_blind_to_slow_light(dtype, full, middle):
    rng = np.random.default_rng(2)
    texture = 0.1 * rng.random((96, 128))
    light = np.linspace(0, 0.5, 128)[None]
    plain, lit = (
        band_passed(build_pyramid((full * (0.3 * dark + texture + add)).astype(dtype), "fine", 6))
        for dark, add in ((1, 0), (0, light))
    )
    for a, b in zip(plain.levels, lit.levels, strict=True):
        assert a.image.dtype == dtype
        inside = np.s_[8:-8, 8:-8]
        difference = np.abs(a.image.astype(float) - b.image)[inside]
        assert difference.max() < 0.05 * full
        assert abs(a.image.mean() - middle) < 0.02 * full
    assert plain.levels[0].image.std() > 0.02 * full


def test_kind_laplacian_is_the_octaves_in_bands():
    image = np.random.default_rng(3).integers(0, 256, (200, 240)).astype(np.uint8)
    got, octaves = build_pyramid(image, "laplacian", 3), band_passed(build_pyramid(image, "coarse", 3))
    for a, b in zip(got.levels, octaves.levels, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        np.testing.assert_array_equal(a.step, b.step)


_BASE = np.zeros((4, 5), np.uint8)


@pytest.mark.parametrize(
    "call",
    [
        lambda: laplacian_pyramid(np.zeros((4, 4), complex)),
        lambda: laplacian_pyramid(np.zeros((4, 4), np.uint8), -1),
        lambda: laplacian_pyramid(np.zeros((4, 4), np.uint8), 33),
        lambda: laplacian_pyramid(np.full((4, 4), 3e38, np.float32)),
        lambda: reconstructed(LaplacianPyramid((np.zeros((8, 10), np.uint8),), _BASE)),
        lambda: reconstructed(LaplacianPyramid((np.zeros((8, 12), np.int16),), _BASE)),
        lambda: reconstructed(LaplacianPyramid((np.zeros((8, 10, 3), np.int16),), _BASE)),
        lambda: reconstructed(LaplacianPyramid((np.zeros((8, 10), np.int16),), np.zeros((4, 5)))),
        lambda: reconstructed(LaplacianPyramid((np.full((8, 10), np.nan, np.float32),), _BASE.astype(np.float32))),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        call()
