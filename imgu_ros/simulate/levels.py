# SPDX-License-Identifier: Apache-2.0
"""A printed image at several resolutions in linear light, so that no sampling rate aliases it or shows its pixels."""

from __future__ import annotations

import math

import cv2
import numpy as np

from imgu_ros.types import Image, Matrix3, as_image
from imgu_ros.vision.formation.transfer import light_of_srgb
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: Level planes: red, green, blue, and their luminance.
PLANES = ("r", "g", "b", "y")

_LUMINANCE = (0.2126, 0.7152, 0.0722)  # Rec. 709
#: Largest distance of neighbouring samples, in level pixels: at sqrt(2) the triangle of linear interpolation still
#: covers the plane without holes, and level spacing sqrt(2) keeps it above 1.
_LARGEST_STEP = math.sqrt(2.0)
_MOST_PIXELS = 16_000_000
_MOST_MAGNIFIED = 8.0


class Levels:
    """Resampled copies of a printed image, made when first asked for.

    Reduced ones are exact area averages; magnified ones are cubic, so that a large texel looks smooth, and so that
    OpenCV's interpolation weights, rounded to 1/32 pixel, are rounded in small pixels.
    """

    def __init__(self, pixels: Image) -> None:
        """Take (H, W) or (H, W, 3) RGB uint8 (sRGB); raises ShapeError for anything else."""
        self._pixels = as_image(pixels, "template", channels=(1, 3), dtypes=(np.uint8,))
        self._height, self._width = self._pixels.shape[:2]
        self._cache: dict[tuple[int, str], Image] = {}
        largest = min(_MOST_MAGNIFIED, math.sqrt(_MOST_PIXELS / (self._width * self._height)))
        self._first = min(0, -math.floor(2 * math.log2(largest)))
        self._last = max(0, math.floor(2 * math.log2(min(self._width, self._height) / 2)))

    @property
    def size(self) -> tuple[int, int]:
        """Width, height of the template, px."""
        return self._width, self._height

    def level_for(self, step_px: float) -> int:
        """Return the finest level k, 2^(-k/2) the size, that samples `step_px` template pixels apart do not alias."""
        if not math.isfinite(step_px):
            return self._last
        wanted = math.ceil(2 * math.log2(max(step_px, 1e-9) / _LARGEST_STEP))
        return min(max(wanted, self._first), self._last)

    def level_from_template(self, level: int) -> Matrix3:
        """Return the (3, 3) map from template pixels to the level's pixels; outer edges map to outer edges."""
        width, height = self._level_size(level)
        sx, sy = width / self._width, height / self._height
        # Of the two images, the template is the reduced one in the sense of the class: sx level px in one of its px.
        return PixelScaling((sx, sy)).full_from_reduced

    def plane(self, level: int, name: str) -> Image:
        """Return one plane ("r", "g", "b" or "y") of a level: (h, w) float32 reflectance in [0, 1]."""
        key = level, name
        if key not in self._cache:
            plane = self._linear(name)
            if level > 0:
                plane = cv2.resize(plane, self._level_size(level), interpolation=cv2.INTER_AREA)
            elif level < 0:
                plane = np.clip(cv2.resize(plane, self._level_size(level), interpolation=cv2.INTER_CUBIC), 0, 1)
            self._cache[key] = plane
        return self._cache[key]

    def _level_size(self, level: int) -> tuple[int, int]:
        scale = 2.0 ** (-level / 2)
        return max(1, round(self._width * scale)), max(1, round(self._height * scale))

    def _linear(self, name: str) -> Image:
        if self._pixels.ndim == 2:
            return _linear_from_srgb()[self._pixels]
        if name == "y":
            parts = [w * _linear_from_srgb()[self._pixels[:, :, i]] for i, w in enumerate(_LUMINANCE)]
            return np.asarray(parts[0] + parts[1] + parts[2], np.float32)
        return _linear_from_srgb()[self._pixels[:, :, PLANES.index(name)]]


def _linear_from_srgb() -> Image:
    return light_of_srgb().astype(np.float32)
