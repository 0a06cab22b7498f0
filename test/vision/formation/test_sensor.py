# SPDX-License-Identifier: Apache-2.0
"""Photon transfer, quantisation and saturation of the sensor model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.sensor import BIT_DEPTHS, Sensor, expose, quantise
from imgu_ros.vision.formation.transfer import TransferFunction, decode_light, encode_light


def flat(level: float, side: int = 400) -> np.ndarray:
    return np.full((side, side), level, np.float32)


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor(8, full_well_e=10_000, read_noise_e=4, black_level_dn=16),
        Sensor(12, full_well_e=10_000, read_noise_e=4, black_level_dn=64),
        Sensor(16, full_well_e=50_000, read_noise_e=12, black_level_dn=1000),
        Sensor(10, full_well_e=500, read_noise_e=2, black_level_dn=32),
    ],
    ids=str,
)
def test_photon_transfer(sensor: Sensor) -> None:
    # EMVA 1288: the variance is a straight line over the mean; slope = gain, offset = read noise and quantisation.
    rng = np.random.default_rng(3)
    gain = (2**sensor.bits - 1 - sensor.black_level_dn) / sensor.full_well_e
    for level in (0.002, 0.02, 0.05, 0.1, 0.3, 0.6, 0.9):
        pixels = expose(flat(level), sensor, rng).astype(np.float64)
        mean_e = level * sensor.full_well_e
        variance = gain**2 * (mean_e + sensor.read_noise_e**2) + 1 / 12
        # Noise below half a step does not smooth the converter's stairs: neither mean nor variance is then the line's.
        if variance > 0.3:
            expected = sensor.black_level_dn + gain * mean_e
            assert pixels.mean() == pytest.approx(expected, abs=0.01 + 5 * np.sqrt(variance / 160_000))
            assert pixels.var() == pytest.approx(variance, rel=0.02)  # the sample's own spread is 0.35 %
        assert sensor.expected_dn(np.array(mean_e)) == pytest.approx(sensor.black_level_dn + gain * mean_e)
        assert sensor.variance_dn(np.array(mean_e)) == pytest.approx(variance)


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor(10, full_well_e=4_000, read_noise_e=6, black_level_dn=40),
        Sensor(12, full_well_e=10_000, read_noise_e=8, black_level_dn=64),
        Sensor(14, full_well_e=30_000, read_noise_e=5, black_level_dn=600),
        Sensor(16, full_well_e=20_000, read_noise_e=3, black_level_dn=1000),
    ],
    ids=str,
)
def test_photon_transfer_curve_gives_the_parameters_back(sensor: Sensor) -> None:
    # As a laboratory measures it (EMVA 1288, 6.6): pairs of flat fields, whose difference has twice the variance.
    rng = np.random.default_rng(7)
    means, variances = [], []
    for level in np.linspace(0.0, 0.75, 16):
        a, b = (expose(flat(level, 300), sensor, rng).astype(np.float64) for _ in range(2))
        means.append((a.mean() + b.mean()) / 2)
        variances.append((a - b).var() / 2)
    signal = np.array(means) - means[0]
    weights = 1 / np.array(variances)  # the spread of a variance is proportional to it
    slope, offset = np.polyfit(signal, variances, 1, w=weights)
    assert slope == pytest.approx(sensor.gain_dn_per_e, rel=0.02)
    assert means[0] == pytest.approx(sensor.black_level_dn, abs=0.05)
    assert np.sqrt(offset - 1 / 12) / slope == pytest.approx(sensor.read_noise_e, rel=0.02)
    saturated = expose(flat(2.0), sensor, rng)
    assert (saturated == sensor.white_level_dn).all()
    full_well = (sensor.white_level_dn - means[0]) / slope
    assert full_well == pytest.approx(sensor.full_well_e, rel=0.02)


def test_amplification_is_iso() -> None:
    # Two stops: four times the numbers for the same light, the same noise in electrons.
    sensor, rng = Sensor(14, full_well_e=20_000, read_noise_e=5), np.random.default_rng(8)
    fast = sensor.amplified(4.0)
    assert fast.gain_dn_per_e == pytest.approx(4 * sensor.gain_dn_per_e)
    # 2000 electrons are 0.1 of the full well, 0.4 of what then saturates.
    slow_pixels, fast_pixels = (expose(flat(x), s, rng).astype(float) for x, s in ((0.1, sensor), (0.4, fast)))
    assert fast_pixels.mean() / slow_pixels.mean() == pytest.approx(4, rel=1e-3)
    assert fast_pixels.std() / slow_pixels.std() == pytest.approx(4, rel=0.02)
    with pytest.raises(ShapeError, match="gain: 0; need more than 0"):
        sensor.amplified(0.0)


@pytest.mark.parametrize("bits", BIT_DEPTHS)
def test_converter_rounds_to_the_nearest_step(bits: int) -> None:
    signal = np.random.default_rng(9).uniform(-0.2, 1.2, (200, 300)).astype(np.float32)
    got = quantise(signal, bits)
    top = 2**bits - 1
    assert got.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert got.shape == signal.shape
    error = got - np.clip(signal.astype(np.float64), 0, 1) * top
    assert np.abs(error).max() <= 0.5 + 1e-7 * top
    inside = (signal > 0) & (signal < 1)
    assert error[inside].var() == pytest.approx(1 / 12, rel=0.02)  # the quantisation noise of EMVA 1288
    # Each step is hit by its own value.
    steps = np.arange(0, top + 1, max(1, top // 1000))
    np.testing.assert_array_equal(quantise((steps / top).astype(np.float32)[None], bits)[0], steps)


def test_impossible_conversions_are_refused() -> None:
    with pytest.raises(ShapeError, match="bits: 9; need one of 8, 10, 12, 14, 16"):
        quantise(np.zeros((2, 2), np.float32), 9)
    with pytest.raises(ShapeError, match="signal: data type uint8"):
        quantise(np.zeros((2, 2), np.uint8), 8)


def test_more_light_than_numbers_hold_saturates() -> None:
    pixels = expose(np.full((4, 4), 3e38, np.float32), Sensor(12), np.random.default_rng(0))
    assert (pixels == 4095).all()


def test_few_electrons_are_poisson() -> None:
    # Without read noise and with one step an electron, the numbers are Poisson's own: skewness 1 / sqrt(mean).
    sensor = Sensor(16, full_well_e=65535, read_noise_e=0)
    pixels = expose(flat(4 / 65535), sensor, np.random.default_rng(4)).astype(np.float64)
    centred = pixels - pixels.mean()
    assert np.mean(pixels == 0) == pytest.approx(np.exp(-4), rel=0.05)
    assert np.mean(centred**3) / pixels.std() ** 3 == pytest.approx(0.5, abs=0.05)


def test_noise_is_white() -> None:
    pixels = expose(flat(0.4), Sensor(12), np.random.default_rng(5)).astype(np.float64)
    pixels -= pixels.mean()
    for shifted in (pixels[1:] * pixels[:-1], pixels[:, 1:] * pixels[:, :-1], pixels[:, 2:] * pixels[:, :-2]):
        assert abs(shifted.mean()) / pixels.var() < 0.015


@pytest.mark.parametrize("bits", BIT_DEPTHS)
def test_quantisation_and_saturation(bits: int) -> None:
    # A full well of 1e12 electrons has a relative noise of 1e-6: what remains is the converter.
    sensor = Sensor(bits, full_well_e=1e12, read_noise_e=0)
    top = 2**bits - 1
    ramp = np.linspace(-0.1, 1.2, 4001, dtype=np.float32)[None, :]
    pixels = expose(ramp, sensor, np.random.default_rng(6))
    assert pixels.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert pixels.min() == 0
    assert pixels.max() == top
    assert np.abs(pixels - np.clip(ramp.astype(np.float64), 0, 1) * top).max() < 0.5 + 1e-5 * top
    assert (np.diff(pixels.astype(int)) >= -1).all()


def test_linear_is_what_it_was_to_the_last_bit() -> None:
    # By hand, in single precision, where electrons are many: signal, one normal draw, gain, rounding half up.
    sensor = Sensor(12, full_well_e=8_000, read_noise_e=6, black_level_dn=64)
    light = np.random.default_rng(1).uniform(0.05, 1.2, (60, 80)).astype(np.float32)
    electrons = light * np.float32(8_000)
    noise = np.random.default_rng(2).standard_normal(light.shape, dtype=np.float32)
    electrons += noise * np.sqrt(electrons + np.float32(36))
    expected = np.clip(electrons * np.float32((4095 - 64) / 8_000) + np.float32(64.5), 0, 4095).astype(np.uint16)
    for transfer in ((), ("linear",), (TransferFunction.LINEAR,)):
        np.testing.assert_array_equal(expose(light, sensor, np.random.default_rng(2), *transfer), expected)


@pytest.mark.parametrize("transfer", list(TransferFunction))
@settings(max_examples=25, deadline=None)
@given(bits=st.sampled_from(BIT_DEPTHS), black=st.integers(0, 60), seed=st.integers(0, 2**32))
def test_inverse_of_the_transfer_function_recovers_the_light(
    transfer: TransferFunction, bits: int, black: int, seed: int
) -> None:
    # Without noise to speak of: numbers are within half a step of the curve, and light within what that step is there.
    sensor = Sensor(bits, full_well_e=1e14, read_noise_e=0, black_level_dn=black)
    light = np.random.default_rng(seed).uniform(0, 1.1, (20, 30)).astype(np.float32)
    pixels = expose(light, sensor, seed, transfer)
    steps = 2**bits - 1 - black
    values = (pixels.astype(np.float64) - black) / steps
    clipped = np.minimum(light, 1).astype(np.float64)
    reach = 0.5 / steps + 2e-6  # of single precision
    assert np.abs(values - encode_light(clipped, transfer)).max() <= reach
    low, high = (decode_light(values + side, transfer) for side in (-reach, reach))
    assert ((low <= clipped + 1e-9) & (clipped <= high + 1e-9)).all()


@pytest.mark.parametrize("transfer", ["srgb", "film"])
def test_noise_passes_the_transfer_function(transfer: str) -> None:
    # Before the converter: its standard deviation is multiplied by the slope of the curve.
    sensor = Sensor(16, full_well_e=20_000, read_noise_e=5, black_level_dn=1000)
    for level in (0.05, 0.3, 0.8):
        pixels = expose(flat(level), sensor, np.random.default_rng(3), transfer).astype(np.float64)
        low, high = encode_light([level - 1e-5, level + 1e-5], transfer)
        sigma = np.sqrt(level * 20_000 + 25) / 20_000 * (high - low) / 2e-5 * (65535 - 1000)
        assert pixels.std() == pytest.approx(sigma, rel=0.02)
        assert pixels.mean() == pytest.approx(1000 + 64535 * float(encode_light(level, transfer)), rel=2e-3)


def test_unknown_transfer_functions_are_refused() -> None:
    with pytest.raises(ShapeError, match="need one of linear, srgb, film"):
        expose(flat(0.5, 4), Sensor(), 0, "log")


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32), channels=st.sampled_from([1, 3]))
def test_same_seed_gives_the_same_numbers(seed: int, channels: int) -> None:
    shape = (8, 6) if channels == 1 else (8, 6, channels)
    light = np.random.default_rng(seed).random(shape, dtype=np.float32)
    before = light.copy()
    a, b = (expose(light, Sensor(), np.random.default_rng(seed)) for _ in range(2))
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(light, before)
    assert a.shape == shape


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"bits": 9}, "bits: 9; need one of 8, 10"),
        ({"full_well_e": 0.0}, "full_well_e"),
        ({"full_well_e": float("nan")}, "full_well_e"),
        ({"read_noise_e": -1.0}, "read_noise_e"),
        ({"black_level_dn": 255.0}, "black_level_dn: 255; need 0 to below 255"),
    ],
)
def test_impossible_sensors_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        Sensor(**values)  # type: ignore[arg-type]


def test_light_of_another_type_is_refused() -> None:
    with pytest.raises(ShapeError, match="light: data type uint8"):
        expose(np.zeros((4, 4), np.uint8), Sensor(), np.random.default_rng(0))
