# SPDX-License-Identifier: Apache-2.0
"""Black and white by a threshold (IU 2.1.3; Otsu 1979)."""

from __future__ import annotations

import math

import cv2
import numpy as np

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Image, as_image
from imgu_ros.vision.processing.histograms import histogram
from imgu_ros.vision.processing.points import full_scale

#: Floats are sorted into this many bins.
_FLOAT_BINS = 65536


def thresholded(image: Image, value: float) -> Image:
    """Return white where the image is at least `value`, black elsewhere.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32
    value : threshold, in the image's values, finite

    Returns
    -------
    Same shape and data type: 0, or 255, 65535 or 1 by data type.

    Raises
    ------
    ShapeError
        If `image` is not such an image or the value is not finite.

    Notes
    -----
    Source: IU 2.1.3.

    Examples
    --------
    >>> thresholded(np.array([[99, 100, 101]], np.uint8), 100).tolist()
    [[0, 255, 255]]
    """
    value = as_number(value, "value")
    image = as_image(image)
    if not math.isfinite(value):
        raise ShapeError(f"value: {value!r}; need a finite number")
    full = full_scale(image.dtype)
    if image.dtype.kind == "f":
        largest = float(np.finfo(np.float32).max)
        return (image >= min(max(value, -largest), largest)).astype(np.float32)
    # OpenCV compares by >, and refuses numbers far outside.
    above = min(max(math.ceil(value) - 1, -1), int(full))
    return cv2.threshold(image, above, full, cv2.THRESH_BINARY)[1]


def otsu_threshold(image: Image, bins: int | None = None) -> float:
    """Return the threshold that separates two classes best: it maximises the variance between them.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32 in [0, 1]
    bins : of the histogram, 2 to 65536: only limits between them are tried; None: one for each value of an integer,
        65536 for floats

    Returns
    -------
    The value from which on a pixel is of the upper class, for `thresholded`. Where several are equally good (no
    pixel lies between the classes) their mean.

    Raises
    ------
    ShapeError
        If `image` is not such an image or `bins` lies outside its range.
    DegenerateConfiguration
        If all pixels lie in the same bin.

    Notes
    -----
    Source: Otsu 1979, equation 18.

    Examples
    --------
    >>> otsu_threshold(np.array([[10, 12, 12, 200, 202]], np.uint8))
    106.5
    >>> otsu_threshold(np.array([[10, 12, 12, 200, 202]], np.uint8), bins=4)
    128.0
    """
    bins = None if bins is None else as_integer(bins, "bins")
    image = as_image(image)
    values = _FLOAT_BINS if image.dtype.kind == "f" else int(full_scale(image.dtype)) + 1
    bins = values if bins is None else bins
    if isinstance(bins, bool) or not isinstance(bins, int | np.integer) or not 2 <= bins <= _FLOAT_BINS:
        raise ShapeError(f"bins: {bins!r}; need an integer, 2 to {_FLOAT_BINS}")
    counts = histogram(image, bins).astype(np.float64)
    below = np.cumsum(counts)[:-1]
    above = image.size - below
    moment = np.cumsum(counts * np.arange(bins))
    divided = (below > 0) & (above > 0)
    if not divided.any():
        raise DegenerateConfiguration("image: all pixels have one value, or lie in one bin; need two")
    first, last = moment[:-1][divided], moment[-1] - moment[:-1][divided]
    below, above = below[divided], above[divided]
    between = below * above * (last / above - first / below) ** 2
    best = np.flatnonzero(divided)[between >= between.max() * (1 - 1e-12)]
    threshold = 1 + float(best.mean())
    return threshold / bins if image.dtype.kind == "f" else threshold * values / bins
