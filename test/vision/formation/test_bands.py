# SPDX-License-Identifier: Apache-2.0
"""Grey images of N-band cubes against hand-computed spectra and their invariances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.bands import (
    BandMode,
    grey_from_bands,
    mean_of_bands,
    principal_component,
    spectral_angle,
)

seeds = st.integers(0, 2**32 - 1)


def test_angle_map_by_hand():
    # Against (1, 1, 1): itself at any brightness 0; (1, 0, 0): cos = 1/sqrt 3; (1, 1, 0): sqrt(2/3); (1, -1, 0): 0.
    spectra = [(5, 5, 5), (0.01, 0.01, 0.01), (1, 0, 0), (2, 2, 0), (1, -1, 0), (-3, -3, -3), (0, 0, 0), (1, np.nan, 1)]
    expected = [0, 0, math.acos(3**-0.5), math.acos((2 / 3) ** 0.5), math.pi / 2, math.pi, math.pi, math.pi]
    cube = np.array([spectra])
    got = spectral_angle(cube, [1, 1, 1])
    assert got.dtype == np.float32
    assert_allclose(got, [expected], atol=1e-6)
    # 3-4-5: (3, 4) against the axes.
    assert_allclose(
        spectral_angle(np.array([[[3, 4], [4, 3]]], np.uint16), [0.5, 0]), np.arctan([[4 / 3, 3 / 4]]), atol=1e-6
    )


def test_small_angles_keep_their_digits():
    # arccos of the normalised product would give 0 or 5e-4 here.
    angles = np.array([[1e-6, 3e-5, 1e-3]])
    cube = np.stack((np.cos(angles), np.sin(angles)), axis=2)
    assert_allclose(spectral_angle(cube, [2.0, 0.0]), angles, rtol=1e-6)


@given(seeds, st.floats(1e-3, 1e3), st.sampled_from(["f4", "f8", "u2"]))
@settings(max_examples=30)
def test_angle_ignores_brightness_and_order(seed, factor, dtype):
    rng = np.random.default_rng(seed)
    cube = rng.uniform(10, 1000, (3, 4, 6)).astype(dtype)
    reference = rng.uniform(0.1, 1, 6)
    got = spectral_angle(cube, reference)
    spectra = cube.astype(float)
    cosine = spectra @ reference / np.linalg.norm(spectra, axis=2) / np.linalg.norm(reference)
    naive = np.arccos(np.clip(cosine, -1, 1))
    assert_allclose(got, naive, atol=1e-6)
    assert_allclose(spectral_angle(cube * np.float64(factor), reference * factor), got, atol=1e-6)
    order = rng.permutation(6)
    assert_allclose(spectral_angle(cube[:, :, order], reference[order]), got, atol=1e-6)


def test_means_by_hand():
    cube = np.array([[[1, 2, 6], [0, 10, 20]]], np.uint8)
    assert_array_equal(mean_of_bands(cube), [[3, 10]])
    assert_allclose(mean_of_bands(cube, [3, 0, 1]), [[9 / 4, 20 / 4]])
    assert_allclose(mean_of_bands(cube, [0, 1e-9, 0]), [[2, 10]])
    assert_allclose(mean_of_bands(cube, [1e300, 1e300, 1e300]), [[3, 10]])
    assert mean_of_bands(cube).dtype == np.float32


def test_band_of_weight_zero_may_lack_values():
    cube = np.array([[[1.0, np.nan], [4.0, 2.0]]])
    assert_array_equal(mean_of_bands(cube, [1, 0]), [[1, 4]])
    assert_array_equal(mean_of_bands(cube, [1, 1]), [[3, 3]])  # the gap is as dark as the darkest


def test_principal_component_is_the_direction_of_most_variance():
    # A known direction, other variance at right angles to it.
    rng = np.random.default_rng(0)
    direction = np.array([2.0, 3.0, 6.0]) / 7
    aside = np.linalg.svd(direction[None])[2][1:]
    t, noise = rng.normal(size=(60, 70)) * 50, rng.normal(size=(60, 70, 2))
    t -= t.mean()
    cube = 300 + t[:, :, None] * direction + noise @ aside
    got = principal_component(cube)
    assert np.corrcoef(got.ravel(), t.ravel())[0, 1] > 0.999
    assert got.std() == pytest.approx(t.std(), rel=1e-3)
    # No other sum of bands with weights of unit length varies more.
    weights = rng.normal(size=(200, 3))
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    assert (cube.reshape(-1, 3) @ weights.T).var(axis=0).max() <= got.astype(float).var() * (1 + 1e-5)


def test_principal_component_beats_every_band_and_the_mean():
    # Half of the bands show the scene inverted, as vegetation's red edge does: the mean cancels, the component adds.
    rng = np.random.default_rng(1)
    scene = rng.normal(size=(50, 60))
    signs = np.array([1, 1, 1, -1, -1, 0.5])
    cube = 100 + 10 * scene[:, :, None] * signs + rng.normal(size=(50, 60, 6)) * 4

    def likeness(grey):
        return np.corrcoef(grey.ravel(), scene.ravel())[0, 1]

    best = likeness(principal_component(cube))
    assert best > 0.97  # positive: the bright bands outweigh
    assert best > likeness(mean_of_bands(cube)) + 0.05
    assert best > max(abs(likeness(cube[:, :, i])) for i in range(6)) + 0.02


@given(seeds)
@settings(max_examples=20)
def test_sign_of_the_principal_component_is_fixed(seed):
    rng = np.random.default_rng(seed)
    cube = rng.normal(size=(9, 8, 4)) * [1, 2, 5, 3] + 10
    got = principal_component(cube)
    assert_array_equal(principal_component(cube.copy()), got)
    weights = np.linalg.lstsq((cube - cube.mean(axis=(0, 1))).reshape(-1, 4), got.ravel().astype(float), rcond=None)[0]
    assert np.linalg.norm(weights) == pytest.approx(1, abs=1e-4)
    assert weights.sum() > -1e-4
    # An offset and the order of bands change nothing.
    assert_allclose(principal_component(cube + rng.normal(size=4)), got, atol=1e-4)
    assert_allclose(np.abs(principal_component(cube[:, :, ::-1])), np.abs(got), atol=1e-4)


def test_sign_where_the_weights_cancel():
    t = np.linspace(-1, 1, 20).reshape(4, 5)
    assert_allclose(principal_component(np.stack((t, -t), axis=2)), math.sqrt(2) * t, atol=1e-6)
    assert_allclose(principal_component(np.stack((-t, t), axis=2)), -math.sqrt(2) * t, atol=1e-6)


def test_large_cubes_are_sampled():
    rng = np.random.default_rng(2)
    scene = rng.normal(size=(700, 600)).astype(np.float32)
    cube = np.stack((scene, 2 * scene), axis=2) + rng.normal(size=(700, 600, 2)).astype(np.float32) * 0.1
    got = principal_component(cube)
    exact = np.linalg.eigh(np.cov(cube.reshape(-1, 2).T))[1][:, 1]
    exact *= np.sign(exact.sum())
    assert_allclose(got - got.mean(), (cube @ exact) - (cube @ exact).mean(), atol=0.02)


def test_a_few_pixels_with_a_value_are_found() -> None:
    # So large that a grid samples it, and nearly all of it a gap between the grid's points.
    cube = np.full((600, 600, 2), np.nan, np.float32)
    cube[301, 301], cube[303, 303] = (1.0, 2.0), (4.0, 6.0)
    got = principal_component(cube)
    assert got[303, 303] - got[301, 301] == pytest.approx(5)
    assert got.min() == got[301, 301] == got[0, 0]


@pytest.mark.parametrize("mode", BandMode)
def test_pixels_without_a_value_are_dark_and_do_not_matter(mode):
    rng = np.random.default_rng(3)
    cube = rng.uniform(1, 9, (30, 40, 3)) * [1, 2, 3]
    extra = {"weights": [1, 2, 3], "reference": [1, 1, 1]}
    whole = grey_from_bands(cube, mode, **extra)
    holes = cube.copy()
    holes[3, 4, 1], holes[5, 6, 0], holes[7, 8, :] = np.nan, np.inf, -np.inf
    got = grey_from_bands(holes, mode, **extra)
    rest = np.ones(got.shape, bool)
    rest[[3, 5, 7], [4, 6, 8]] = False
    assert (got[~rest] == got[rest].min()).all()
    assert np.isfinite(got).all()
    assert_allclose(got[rest], whole[rest], atol=0.05)  # of the component, the mean is that of fewer pixels
    nothing = grey_from_bands(np.full((4, 5, 3), np.nan), mode, **extra)
    assert not nothing.any()


@pytest.mark.parametrize("mode", BandMode)
@pytest.mark.parametrize("dtype", ["u1", "i1", "u2", "i2", "i4", "f4", "f8", ">u2", ">f4", ">f8", "f2"])
def test_every_data_type_gives_the_same_picture(mode, dtype):
    values = np.random.default_rng(4).integers(1, 120, (12, 9, 5))
    extra = {"bands": (4, 0, 2), "weights": [1, 0.5, 2], "reference": [3, 2, 1]}
    exact = grey_from_bands(values.astype(float), mode, **extra)
    got = grey_from_bands(values.astype(dtype), mode, **extra)
    assert_allclose(got, exact, rtol=1e-6, atol=1e-5)
    # The chosen bands are taken in the order in which they are named.
    again = grey_from_bands(values[:, :, [4, 0, 2]].astype(dtype), mode, weights=[1, 0.5, 2], reference=[3, 2, 1])
    assert_array_equal(got, again)


def test_one_band_is_itself():
    band = np.arange(12, dtype=np.uint16).reshape(3, 4)
    assert_array_equal(grey_from_bands(band), band)
    assert grey_from_bands(band).dtype == np.uint16
    assert_allclose(principal_component(band), band - band.mean())
    with pytest.raises(ShapeError, match="cube: 1 band; need 2 or more"):
        spectral_angle(band, [1.0])


def test_no_contrast_is_flat():
    assert not principal_component(np.full((4, 5, 3), 7, np.uint8)).any()


def test_huge_values_are_clamped():
    cube = np.array([[[1e300, 1.0], [-1e300, 2.0], [1.0, 3.0]]])
    for mode in (BandMode.MEAN, BandMode.PRINCIPAL_COMPONENT):
        got = grey_from_bands(cube, mode)
        assert np.isfinite(got).all()
        assert got[0, 1] < got[0, 2] < got[0, 0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: grey_from_bands(c, "median"), "BandMode: 'median'; need one of mean, weighted"),
        (lambda c: grey_from_bands(c, bands=[3]), "bands: 3; need 0 to 2"),
        (lambda c: grey_from_bands(c, bands=[-1]), "bands: -1; need 0 to 2"),
        (lambda c: grey_from_bands(c, "weighted"), "weights: shape (0,); need (3,)"),
        (lambda c: grey_from_bands(c, "weighted", weights=[0, 0, 0]), "weights: [0.0, 0.0, 0.0]; need"),
        (lambda c: grey_from_bands(c, "weighted", weights=[1, -1, 1]), "weights: [1.0, -1.0, 1.0]; need"),
        (lambda c: grey_from_bands(c, "spectral_angle", reference=[1, 2]), "reference: shape (2,); need (3,)"),
        (lambda c: spectral_angle(c, [0, 0, 0]), "reference: all 0"),
        (lambda c: spectral_angle(c, [0, np.nan, 0]), "reference: 1 values are not finite"),
        (lambda c: mean_of_bands(c.astype(complex)), "cube: data type complex128"),
        (lambda c: mean_of_bands(c[:0]), "cube: shape (0, 5, 3); need"),
        (lambda c: principal_component(c[0, 0]), "cube: shape (3,); need"),
    ],
)
def test_impossible_calls_are_refused(call, message):
    with pytest.raises(ShapeError) as caught:
        call(np.ones((4, 5, 3)))
    assert str(caught.value).startswith(message)
