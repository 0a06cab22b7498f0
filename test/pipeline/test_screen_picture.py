# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.image.frame_image import develop
from imgu_ros.image.screen_picture import screen_picture
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

#: Of red, green and blue pixels, as sensors have them.
SENSITIVITIES = np.array([0.5, 1.0, 0.65])


def scene(seed: int = 3) -> np.ndarray:
    """Light of random patches, among them grey and white ones, (H, W, 3) in 0 to 1."""
    rng = np.random.default_rng(seed)
    patches = rng.uniform(0.02, 0.9, (8, 8, 3))
    patches[::2, ::2] = rng.uniform(0.05, 0.9, (4, 4, 1))
    patches[0, 0] = 0.95
    return np.kron(patches, np.ones((16, 16, 1)))


@pytest.mark.parametrize("bits", [8, 10, 16])
@pytest.mark.parametrize("exposure", [1.0, 0.3])
def test_grey_is_grey_and_white_is_bright(bits: int, exposure: float) -> None:
    """A dark mosaic of unequal sensitivities: grey patches become grey, with the brightness that sRGB gives them."""
    light = scene()
    top = 2**bits - 1
    dtype = np.uint8 if bits == 8 else np.uint16
    raw = mosaic(np.rint(top * exposure * light * SENSITIVITIES).astype(dtype), BayerPattern.RGGB)
    image = RawImage(raw, PixelLayout(ColorModel.BAYER, BayerPattern.RGGB))
    before = raw.copy()
    parameters = RawParameters(significant_bits=0 if bits == 8 else bits)
    picture = develop(image, parameters, DemosaicParameters()).for_screen()
    assert picture.dtype == np.uint8
    assert np.array_equal(raw, before)
    grey = picture[36:44, 36:44].reshape(-1, 3).astype(float)  # the middle of a grey patch
    assert np.ptp(grey.mean(axis=0)) < 25
    expected = 255 * (1.055 * light[40, 40, 0] ** (1 / 2.4) - 0.055)
    assert grey.mean() == pytest.approx(expected, abs=25)
    assert picture[4:12, 4:12].mean() > 225


def test_pictures_for_a_screen_stay_as_they_are() -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)
    image = RawImage(pixels, PixelLayout(ColorModel.RGB))
    picture = develop(image, RawParameters(), DemosaicParameters()).for_screen()
    assert np.array_equal(picture, pixels)
    picture[:] = 0
    assert pixels.any()


def test_gains_of_the_user_count() -> None:
    """With `raw.gains` nothing is estimated: a scene that is all red stays red."""
    light = np.zeros((64, 64, 3)) + [0.8, 0.2, 0.2]
    raw = mosaic(np.rint(255 * light * SENSITIVITIES).astype(np.uint8), BayerPattern.RGGB)
    image = RawImage(raw, PixelLayout(ColorModel.BAYER, BayerPattern.RGGB))
    gains = tuple(1 / SENSITIVITIES)
    red, green, blue = develop(image, RawParameters(gains=gains), DemosaicParameters()).for_screen()[32, 32].astype(int)
    assert red > green + 60 and abs(green - blue) < 5


@pytest.mark.parametrize("value", [0, 65535])
@pytest.mark.parametrize("white", [None, 65535.0])
def test_nothing_but_one_value(value: int, white: float | None) -> None:
    color = np.full((30, 40, 3), value, np.uint16)
    picture = screen_picture(color, white=white, is_light=True, is_balanced=False)
    assert picture.shape == color.shape
    assert white is None or (picture == (255 if value else 0)).all()
