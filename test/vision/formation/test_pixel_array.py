# SPDX-License-Identifier: Apache-2.0
"""Sizes of known sensors, from their data sheets."""

from __future__ import annotations

import math

import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.pixel_array import PixelArray


@pytest.mark.parametrize(
    ("array", "width_mm", "height_mm", "aspect", "crop"),
    [
        (PixelArray(6000, 4000, 6e-6), 36.0, 24.0, (3, 2), 1.0),  # 35 mm film
        (PixelArray(2448, 2048, 3.45e-6), 8.4456, 7.0656, (153, 128), 3.929),  # 2/3 inch, diagonal 11 mm
        (PixelArray(1920, 1080, 3e-6), 5.76, 3.24, (16, 9), 6.547),
        (PixelArray(640, 480, 12e-6), 7.68, 5.76, (4, 3), 4.507),
    ],
    ids=str,
)
def test_size_and_aspect(array, width_mm, height_mm, aspect, crop):
    assert array.width_m == pytest.approx(width_mm * 1e-3)
    assert array.height_m == pytest.approx(height_mm * 1e-3)
    assert array.diagonal_m == pytest.approx(math.hypot(width_mm, height_mm) * 1e-3)
    assert array.aspect == aspect
    assert array.crop_factor == pytest.approx(crop, abs=1e-3)


def test_focal_length_in_pixels():
    # 8 mm behind pixels of 3.45 um.
    assert PixelArray(2448, 2048, 3.45e-6).focal_px(0.008) == pytest.approx(2318.84, abs=0.01)


@pytest.mark.parametrize("values", [(0, 480, 1e-6), (640, -1, 1e-6), (640, 480, 0.0), (640, 480, math.nan)])
def test_impossible_arrays_are_refused(values):
    with pytest.raises(ShapeError, match="need"):
        PixelArray(*values)


@pytest.mark.parametrize("distance", [0.0, -1.0, math.nan, math.inf])
def test_impossible_image_distances_are_refused(distance):
    with pytest.raises(ShapeError, match="image_distance_m"):
        PixelArray(640, 480, 1e-6).focal_px(distance)
