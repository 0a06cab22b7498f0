# SPDX-License-Identifier: Apache-2.0
"""A template at one scale in cells of a few samples: their moments, with which a frame is compared."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.types import Image, Mask

#: Samples along each side of a cell: large enough for a correlation, small enough for the border of an occluder.
CELL = 4
#: Standard deviation of a cell, grey values, below which it is flat: it cannot support a pose, only contradict it.
#: Measured: benchmarks/thresholds.py, study confirmation.
_FLAT = 6.0
#: Of a template that has little contrast everywhere it is this share of that of all cells, and at least the noise of a
#: frame. Measured: benchmarks/printed_targets.py.
_FLAT_SHARE, _LEAST_FLAT = 0.7, 3.0


@dataclass(frozen=True, slots=True, eq=False)
class CellMoments:
    """Moments of the cells of a blurred template.

    Attributes
    ----------
    image : (CELL * rows, CELL * columns) float32, the samples
    mean, variance : (rows, columns) of each cell
    gradient : (rows, columns) mean square of the gradient, grey values squared per sample squared
    is_textured : (rows, columns) has enough contrast to tell
    """

    image: Image
    mean: Image
    variance: Image
    gradient: Image
    is_textured: Mask


class TemplateCells:
    """The cells of a template's level.

    The outermost samples belong to none: in a frame they mix with what lies beside the target.

    Parameters
    ----------
    image : (H, W) uint8

    Attributes
    ----------
    rows, columns : number of cells; 0 when the image is too small
    x, y : first sample of the first cell, px of the level
    """

    def __init__(self, image: Image) -> None:
        height, width = image.shape
        self.rows, self.columns = max(height - 2, 0) // CELL, max(width - 2, 0) // CELL
        self.x, self.y = (width - CELL * self.columns) // 2, (height - CELL * self.rows) // 2
        self._image = image
        self._moments: dict[float, CellMoments] = {}

    def blurred(self, sigma: float) -> CellMoments:
        """Return the moments of the template blurred by a Gaussian of `sigma` samples; computed on the first call."""
        if sigma not in self._moments:
            self._moments[sigma] = self._of(sigma)
        return self._moments[sigma]

    def _of(self, sigma: float) -> CellMoments:
        image: Image = self._image.astype(np.float32)
        if sigma:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma))
        by_x, by_y = (cv2.Sobel(image, -1, along, 1 - along, ksize=3, scale=0.125) for along in (1, 0))
        gradient = np.asarray(by_x * by_x + by_y * by_y)
        rows = slice(self.y, self.y + CELL * self.rows)
        columns = slice(self.x, self.x + CELL * self.columns)
        image = np.ascontiguousarray(image[rows, columns])
        mean = cell_means(image)
        variance = np.maximum(cell_means(image * image) - mean * mean, 0)
        squared = cell_means(np.ascontiguousarray(gradient[rows, columns]))
        usual = _FLAT_SHARE * math.sqrt(float(variance.mean())) if variance.size else _FLAT
        flat = min(_FLAT, max(usual, _LEAST_FLAT))
        return CellMoments(image, mean, variance, squared, variance >= flat**2)


def cell_means(samples: Image) -> Image:
    """Return the mean of each cell of an image whose sides are multiples of `CELL`, float32."""
    height, width = samples.shape
    return cv2.resize(samples, (width // CELL, height // CELL), interpolation=cv2.INTER_AREA)
