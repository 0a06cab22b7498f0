# SPDX-License-Identifier: Apache-2.0
"""Transfer functions: by their definitions, there and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.transfer import (
    TransferFunction,
    decode_light,
    encode_light,
    light_of_srgb,
    linear_from_srgb,
    srgb_from_linear,
)


def test_published_values() -> None:
    """Middle grey of the standard, and the end of its straight part."""
    light = light_of_srgb()
    assert light.shape == (256,) and light[0] == 0 and light[255] == 1
    assert light[188] == pytest.approx(0.5029, abs=1e-4)
    assert light[10] == pytest.approx(10 / 255 / 12.92)
    assert light[11] == pytest.approx(((11 / 255 + 0.055) / 1.055) ** 2.4)
    assert (np.diff(light) > 0).all()


def test_there_and_back() -> None:
    """In the lights light has the finer steps, in the shadows sRGB: there and back the coarser ones remain."""
    values = np.arange(256, dtype=np.uint8)[None]
    back = srgb_from_linear(linear_from_srgb(values)).astype(int) - values
    assert not back[0, 128:].any() and np.abs(back).max() <= 7
    again = linear_from_srgb(srgb_from_linear(values)).astype(int) - values
    assert not again[0, :70].any() and np.abs(again).max() <= 1


def test_colours_are_treated_one_by_one_and_the_input_stays() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    before = picture.copy()
    made = linear_from_srgb(picture)
    assert all(np.array_equal(made[..., i], linear_from_srgb(np.ascontiguousarray(picture[..., i]))) for i in range(3))
    assert np.array_equal(picture, before)
    for function in (linear_from_srgb, srgb_from_linear):
        with pytest.raises(ShapeError, match="image"):
            function(np.zeros((3, 3), np.uint16))


LIGHT = st.floats(-1.0, 1.0)
FUNCTIONS = pytest.mark.parametrize("transfer", list(TransferFunction))


@FUNCTIONS
@given(light=st.lists(LIGHT, min_size=1, max_size=20))
def test_decoding_undoes_encoding(transfer: TransferFunction, light: list[float]) -> None:
    # The two parts of sRGB meet to 3e-8 of a value.
    tolerance = {"rtol": 0.0, "atol": 1e-7 if transfer is TransferFunction.SRGB else 1e-12}
    np.testing.assert_allclose(decode_light(encode_light(light, transfer), transfer), light, **tolerance)
    np.testing.assert_allclose(encode_light(decode_light(light, transfer), transfer), light, **tolerance)


@FUNCTIONS
@given(one=LIGHT, other=LIGHT)
def test_more_light_never_gives_less(transfer: TransferFunction, one: float, other: float) -> None:
    dark, bright = encode_light(sorted((one, other)), transfer)
    assert dark <= bright + 3e-8  # the constants of sRGB are rounded
    assert encode_light(-one, transfer) == -encode_light(one, transfer)


@FUNCTIONS
def test_black_and_full_scale_stay_and_nothing_lies_beyond(transfer: TransferFunction) -> None:
    for convert in (encode_light, decode_light):
        np.testing.assert_allclose(convert([-9.0, -1.0, 0.0, 1.0, 1e30], transfer), [-1, -1, 0, 1, 1], atol=1e-15)


@FUNCTIONS
def test_every_step_of_light_is_a_step_of_values(transfer: TransferFunction) -> None:
    assert (np.diff(encode_light(np.linspace(0, 1, 4096), transfer)) > 0).all()


def test_srgb_is_that_of_the_table() -> None:
    np.testing.assert_array_equal(decode_light(np.arange(256) / 255, "srgb"), light_of_srgb())


def test_film_is_a_logistic_function_of_the_logarithm_of_light() -> None:
    """Toe, straight part and shoulder: over the logarithm its slope rises, then falls; its log odds are a line."""
    log_light = np.linspace(-9, 0, 400)
    values = encode_light(np.exp(log_light), "film")
    slope, offset = np.polyfit(log_light, np.log(values / (1.2 - values)), 1)
    assert slope == pytest.approx(1.2) and offset == pytest.approx(-np.log(0.2))
    bends = np.diff(values, 2)
    assert (np.diff(np.sign(bends)) != 0).sum() == 1 and bends[0] > 0 > bends[-1]
    assert values[0] < float(encode_light(np.exp(-9), "srgb")) / 10  # the toe


@FUNCTIONS
def test_single_precision_stays_and_the_input_too(transfer: TransferFunction) -> None:
    light = np.random.default_rng(2).random((5, 7, 3), dtype=np.float32)
    before = light.copy()
    encoded = encode_light(light, transfer)
    assert encoded.dtype == np.float32 and encoded.shape == light.shape
    np.testing.assert_allclose(encoded, encode_light(light.astype(np.float64), transfer), atol=1e-6)
    np.testing.assert_array_equal(light, before)


def test_only_finite_numbers_and_known_functions() -> None:
    for convert in (encode_light, decode_light):
        with pytest.raises(ShapeError, match="finite"):
            convert([0.5, np.nan], "film")
        with pytest.raises(ShapeError, match="need one of linear, srgb, film"):
            convert([0.5], "log")
