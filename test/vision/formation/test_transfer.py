# SPDX-License-Identifier: Apache-2.0
"""The transfer function of sRGB: by its definition, there and back."""

from __future__ import annotations

import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.transfer import light_of_srgb, linear_from_srgb, srgb_from_linear


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
