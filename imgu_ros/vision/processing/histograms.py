# SPDX-License-Identifier: Apache-2.0
"""Histograms, and what equalises them (IU 2.1.4; Zuiderveld 1994)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_image, require_unit_range
from imgu_ros.vision.processing.points import full_scale

_MOST_BINS = 65536
#: OpenCV counts in float32, which counts to 2^24.
_LARGEST_COUNT = 2**24


def histogram(image: Image, bins: int = 256) -> NDArray[np.int64]:
    """Count the pixels of each range of values.

    Bin i counts the values from i l up to, not including, (i + 1) l, where l = (values of the type) / bins:
    256 / bins for uint8, 65536 / bins for uint16. Floats are counted in [0, 1]: an overshoot, -1 to 2, counts in the
    first or last bin, and 1 in the last.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32
    bins : 1 to 65536; need not divide 256

    Returns
    -------
    (bins,) int64; the sum is the number of pixels.

    Raises
    ------
    ShapeError
        If `image` is not such an image or `bins` lies outside its range.

    Notes
    -----
    Source: IU 2.1.4.

    Examples
    --------
    >>> histogram(np.array([[0, 63, 64, 255]], np.uint8), bins=4).tolist()
    [2, 1, 0, 1]
    """
    bins = as_integer(bins, "bins")
    image = as_image(image)
    if isinstance(bins, bool) or not isinstance(bins, int | np.integer) or not 1 <= bins <= _MOST_BINS:
        raise ShapeError(f"bins: {bins!r}; need an integer, 1 to {_MOST_BINS}")
    if image.dtype.kind == "f":
        require_unit_range(image)
        position = np.clip(image.astype(np.float64), 0, 1) * bins
        return np.bincount(np.minimum(position.astype(np.intp), bins - 1).ravel(), minlength=bins).astype(np.int64)
    counts = _counts(image)
    # Exact in integers: value v belongs to bin v * bins // values.
    which = np.arange(len(counts)) * int(bins) // len(counts)
    out = np.zeros(bins, np.int64)
    np.add.at(out, which, counts)
    return out


def equalised(image: Image) -> Image:
    """Spread the values so that their cumulative histogram is as straight as it can be.

    A value v becomes round(full (C(v) - C0) / (N - C0)), where C(v) counts the pixels up to v, C0 those of the
    lowest value that occurs, N all. A picture of one value stays as it is.

    Parameters
    ----------
    image : (H, W), uint8 or uint16

    Raises
    ------
    ShapeError
        If `image` is not such an image.

    Notes
    -----
    Source: Szeliski 2022, section 3.1.4.

    Examples
    --------
    >>> equalised(np.array([[50, 50, 51, 52]], np.uint8)).tolist()
    [[0, 0, 128, 255]]
    """
    image = as_image(image, dtypes=(np.uint8, np.uint16))
    counts = _counts(image)
    lowest = counts[int(np.flatnonzero(counts)[0])]
    if lowest == image.size:
        return image.copy()
    cumulative = np.maximum(np.cumsum(counts) - lowest, 0)
    table = np.rint(full_scale(image.dtype) * cumulative / (image.size - lowest)).astype(image.dtype)
    return cv2.LUT(image, table) if image.dtype == np.uint8 else table[image]


def equalised_locally(image: Image, clip: float = 2.0, tiles: int = 8) -> Image:
    """Equalise with contrast limits, tile by tile, and blend between tiles (CLAHE).

    Parameters
    ----------
    image : (H, W), uint8 or uint16
    clip : most that a histogram bin may hold, as a multiple of the mean, 1 to 1000: limits how much noise grows
    tiles : in each direction, 1 to 64

    Raises
    ------
    ShapeError
        If `image` is not such an image or a number lies outside its range.

    Notes
    -----
    Source: Zuiderveld 1994, Graphics Gems IV.

    Examples
    --------
    >>> image = np.repeat(np.arange(100, 120, dtype=np.uint8)[None], 20, axis=0)
    >>> bool(np.ptp(equalised_locally(image, clip=4, tiles=2)) > np.ptp(image))
    True
    """
    clip = as_number(clip, "clip")
    tiles = as_integer(tiles, "tiles")
    image = as_image(image, dtypes=(np.uint8, np.uint16))
    if not 1 <= clip <= 1000:
        raise ShapeError(f"clip: {clip!r}; need 1 to 1000")
    if isinstance(tiles, bool) or not isinstance(tiles, int | np.integer) or not 1 <= tiles <= 64:
        raise ShapeError(f"tiles: {tiles!r}; need an integer, 1 to 64")
    # A tile has at least one pixel.
    grid = (min(int(tiles), image.shape[1]), min(int(tiles), image.shape[0]))
    return cv2.createCLAHE(float(clip), grid).apply(image)


def _counts(image: Image) -> NDArray[np.int64]:
    """Return how often each value of an integer image occurs."""
    values = np.iinfo(image.dtype).max + 1
    counts = np.zeros(values, np.int64)
    flat = image.reshape(-1, 1)
    for start in range(0, len(flat), _LARGEST_COUNT):
        part = flat[start : start + _LARGEST_COUNT]
        counts += cv2.calcHist([part], [0], None, [values], [0, values]).ravel().astype(np.int64)
    return counts
