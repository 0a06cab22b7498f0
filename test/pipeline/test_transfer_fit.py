# SPDX-License-Identifier: Apache-2.0
"""The transfer curve of a camera, recovered from samples whose curve is known exactly."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from imgu_ros.image.transfer_fit import SRGB_CURVE, CurveSamples, TransferFit, TransferKind

Curve = Callable[[NDArray[np.float64]], NDArray[np.float64]]
NOISE = 0.004


def srgb(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """IEC 61966-2-1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055)


def film(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Toe, straight part and shoulder."""
    p = light**1.2
    return 1.2 * p / (p + 0.2)


def gamma(light: NDArray[np.float64]) -> NDArray[np.float64]:
    return light**0.7


CURVES: dict[str, Curve] = {"linear": lambda light: light, "srgb": srgb, "film": film, "gamma": gamma}


def samples_of(curve: Curve, seed: int, count: int = 3000, noise: float = NOISE) -> CurveSamples:
    """Return samples of a picture, 40 % of green, with gains, offsets and a shading that differ from image to image."""
    rng = np.random.default_rng(seed)
    ends = [0, 3 * count // 10, 7 * count // 10, count]
    channels = [slice(a, b) for a, b in itertools.pairwise(ends)]
    f = rng.uniform(0.02, 1, count)
    places = rng.uniform(-1, 1, (count, 2))
    light, exposure = np.empty(count), rng.uniform(0.8, 0.93)
    for part, gain in zip(channels, (0.7, 1.0, 0.8), strict=True):
        shading = 1 + places[part] @ rng.uniform(-0.05, 0.05, 2)
        light[part] = exposure * gain * shading * f[part] + 0.003
    values = np.clip(curve(light) + rng.normal(0, noise, count), 0, 1)
    singles = (each.astype(np.float32) for each in (values, f, places))
    return CurveSamples(*singles, channels, np.ones(count, np.float32))


def fitted(curve: Curve, images: int = 8) -> TransferFit:
    fit = TransferFit()
    for seed in range(images):
        fit.add(samples_of(curve, seed))
    return fit


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("linear", TransferKind.LINEAR),
        ("srgb", TransferKind.SRGB),
        ("film", TransferKind.FITTED),
        ("gamma", TransferKind.FITTED),
    ],
)
def test_curves_are_told_apart_and_recovered(name: str, kind: TransferKind) -> None:
    fit = fitted(CURVES[name])
    assert fit.curve is not None and fit.curve.kind is kind
    # Up to a factor, which is a gain, the curve undoes the one that made the values.
    light = np.linspace(0.05, 0.85, 50)
    found = fit.curve.light(CURVES[name](light))
    factor = float(found @ light) / float(light @ light)
    assert_allclose(found / factor, light, atol=0.012)


@pytest.mark.parametrize("name", CURVES)
def test_one_image_tells_the_kind(name: str) -> None:
    curve = fitted(CURVES[name], 1).curve
    assert curve is not None and curve.kind is fitted(CURVES[name]).curve.kind  # type: ignore[union-attr]


@given(gain=st.floats(0.2, 3.0), seed=st.integers(0, 99))
def test_any_monotone_curve_gives_a_monotone_curve(gain: float, seed: int) -> None:
    fit = TransferFit()
    fit.add(samples_of(lambda light: light**gain, seed, 600, 0.02))
    assert fit.curve is not None
    increments = fit.curve.increments
    assert (increments >= 0).all() and increments.sum() == pytest.approx(1)
    light = fit.curve.light(np.linspace(-0.2, 1.2, 300))
    assert (np.diff(light) >= 0).all() and light[0] == 0 and light[-1] == pytest.approx(1)


def test_gross_errors_count_little() -> None:
    fit, rng = TransferFit(), np.random.default_rng(3)
    for seed in range(8):
        samples = samples_of(srgb, seed)
        wrong = rng.random(len(samples.values)) < 0.1
        values = np.where(wrong, rng.random(len(wrong)), samples.values).astype(np.float32)
        fit.add(replace(samples, values=values))
    assert fit.curve is not None and fit.curve.kind is TransferKind.SRGB


def test_samples_of_no_weight_do_not_count() -> None:
    samples = samples_of(film, 1)
    wrong = np.arange(len(samples.values)) % 3 == 0
    one, other = TransferFit(), TransferFit()
    weights = np.where(wrong, 0, 1).astype(np.float32)
    one.add(replace(samples, weights=weights))
    other.add(replace(samples, weights=weights, values=np.where(wrong, 0.5, samples.values).astype(np.float32)))
    assert one.curve is not None and other.curve is not None
    assert_allclose(one.curve.increments, other.curve.increments, atol=1e-9)


def test_it_settles() -> None:
    fit = TransferFit()
    assert fit.curve is None and not fit.is_settled and fit.images == 0
    for seed in range(8):
        assert not fit.is_settled
        fit.add(samples_of(film, seed))
        assert fit.images == seed + 1
    assert fit.is_settled
    before = fit.curve
    fit.add(samples_of(srgb, 9))
    assert fit.curve is before and fit.images == 8


def test_mono_samples_have_one_channel() -> None:
    fit = TransferFit()
    for seed in range(8):
        samples = samples_of(film, seed)
        part = samples.channels[1]
        values, light, places, weights = (
            each[part] for each in (samples.values, samples.light, samples.places, samples.weights)
        )
        fit.add(CurveSamples(values, light, places, [slice(0, len(values))], weights))
    assert fit.curve is not None and fit.curve.kind is TransferKind.FITTED


SAMPLES = samples_of(srgb, 1, 300)
NOTHING = np.zeros(300, np.float32)


@pytest.mark.parametrize(
    "samples",
    [
        replace(SAMPLES, values=np.full(300, 0.5, np.float32)),
        replace(SAMPLES, values=NOTHING),
        replace(SAMPLES, values=np.ones(300, np.float32)),
        replace(SAMPLES, values=np.where(NOTHING == 0, 1.5, 0).astype(np.float32)),
        replace(SAMPLES, light=np.full(300, 0.5, np.float32)),
        replace(SAMPLES, light=NOTHING),
        replace(SAMPLES, light=1 - SAMPLES.light),
        replace(SAMPLES, places=np.zeros((300, 2), np.float32)),
        replace(SAMPLES, weights=NOTHING),
        replace(SAMPLES, weights=(np.arange(300) == 7).astype(np.float32)),
        CurveSamples(NOTHING[:0], NOTHING[:0], np.zeros((0, 2), np.float32), [slice(0, 0)] * 3, NOTHING[:0]),
        CurveSamples(NOTHING[:1], NOTHING[:1], np.zeros((1, 2), np.float32), [slice(0, 1)], NOTHING[:1] + 1),
    ],
    ids=[
        "one value", "black", "white", "beyond white", "one light", "no light", "a negative", "one place",
        "no weights", "one sample of weight", "none", "one",
    ],
)  # fmt: skip
def test_degenerate_samples_give_no_nonsense(samples: CurveSamples) -> None:
    """Warnings are errors; and what comes after them is fitted as ever."""
    fit = TransferFit()
    fit.add(samples)
    if fit.curve is not None:
        assert np.isfinite(fit.curve.increments).all() and (fit.curve.increments >= 0).all()
        assert fit.curve.increments.sum() == pytest.approx(1)
    for seed in range(7):
        fit.add(samples_of(srgb, seed))
    assert fit.curve is not None and np.isfinite(fit.curve.increments).all()


def test_an_image_without_samples_of_weight_is_not_counted() -> None:
    fit = TransferFit()
    fit.add(replace(SAMPLES, weights=NOTHING))
    assert fit.images == 0 and fit.curve is None


def test_srgb_is_that_of_the_standard() -> None:
    """The curve of 16 straight pieces is on the standard's at every knot, to a step of 8 bits."""
    light = np.linspace(0, 1, 200)
    assert_allclose(SRGB_CURVE.light(srgb(light)), light, atol=6e-3)
    assert SRGB_CURVE.increments.sum() == pytest.approx(1) and (SRGB_CURVE.increments > 0).all()


def test_a_table_is_of_every_raw_value() -> None:
    table = SRGB_CURVE.table(64.0, 1023.0, 1024)
    assert table.shape == (1024,) and table.dtype == np.float32
    assert_array_equal(table[:65], 0.0)
    assert table[1023] == 1.0 and (np.diff(table) >= 0).all()
    assert table[600] == pytest.approx(float(SRGB_CURVE.light(np.array([(600 - 64) / (1023 - 64)]))[0]), abs=1e-6)
    # The second call is what was made by the first.
    assert SRGB_CURVE.table(64.0, 1023.0, 1024) is table
