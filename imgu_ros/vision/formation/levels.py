# SPDX-License-Identifier: Apache-2.0
"""Black level, white level and gains of raw data; the step to 8 bits (IU 1.1.6, 1.2.4)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from imgu_ros.arguments import as_number, as_sequence
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_image
from imgu_ros.vision.formation.cfa import BayerPattern

#: Share of pixels that may be darker than black, and brighter than white, when the data set the range.
_TAIL = 0.002
_SAMPLES = 1 << 16


def with_levels(
    raw: Image, pattern: BayerPattern, black: float, white: float, gains: Sequence[float] = (1.0, 1.0, 1.0)
) -> Image:
    """Subtract the black level of a mosaic, scale white to full scale, and apply white-balance gains.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16
    pattern : colours of the top-left quad
    black : raw value of no light
    white : raw value of full scale, > black; 0: the data type's largest value
    gains : of red, green and blue, >= 0

    Returns
    -------
    (H, W) of the same data type, rounded and clamped; the input itself when there is nothing to do.

    Raises
    ------
    ShapeError
        If `raw` is not such an image, the pattern is unknown, white is not above black, or a gain is missing or
        negative.

    Examples
    --------
    A 10-bit quad with black at 64, its blue site (bottom right) doubled:

    >>> raw = np.array([[64, 1023], [544, 304]], np.uint16)
    >>> with_levels(raw, BayerPattern.RGGB, 64, 1023, (1.0, 1.0, 2.0)).tolist()
    [[0, 65535], [32802, 32802]]
    """
    black = as_number(black, "black")
    white = as_number(white, "white")
    raw = as_image(raw, "raw", dtypes=(np.uint8, np.uint16), rescaled=False)
    top = float(np.iinfo(raw.dtype).max)
    _require_range(black, white or top)
    factors = [as_number(gain, "gains") for gain in as_sequence(gains, "gains")]
    if len(factors) != 3 or not all(math.isfinite(g) and g >= 0 for g in factors):
        raise ShapeError(f"gains: {factors}; need 3 finite numbers >= 0 (red, green, blue)")
    factors = [g * top / ((white or top) - black) for g in factors]
    if black == 0 and all(f == 1.0 for f in factors):
        return raw
    out = np.empty_like(raw)
    for index, color in enumerate(BayerPattern(pattern).value):
        row, column = divmod(index, 2)
        site = np.ascontiguousarray(raw[row::2, column::2])
        if site.size:
            factor = factors["rgb".index(color)]
            out[row::2, column::2] = _scaled(site, factor, -black * factor, raw.dtype)
    return out


def stretched_to_8_bit(grey: Image, black: float, white: float | None) -> Image:
    """Bring a grey image to uint8.

    With percentiles it is the automatic gain of infrared cameras (IU 1.2.4): a linear stretch between the 0.2 % and
    99.8 % quantiles of the picture, so that a few hot or dead pixels do not set the range (histogram clipping;
    Gonzalez & Woods 2018, 3.2). Large pictures are sampled on a grid of some 65 000 pixels.

    Parameters
    ----------
    grey : (H, W) uint8, uint16 or float32
    black, white : values that become 0 and 255; white None: both ends from the image's own percentiles

    Returns
    -------
    (H, W) uint8; an image without contrast becomes 0.

    Raises
    ------
    ShapeError
        If `grey` is not such an image or white is not above black.

    Examples
    --------
    A 12-bit converter's range, and a thermal picture's own:

    >>> stretched_to_8_bit(np.array([[0, 2048, 4095]], np.uint16), 0, 4095).tolist()
    [[0, 128, 255]]
    >>> stretched_to_8_bit(np.array([[29_500, 29_600, 29_700]], np.uint16), 0, None).tolist()
    [[0, 128, 255]]
    """
    black = as_number(black, "black")
    white = None if white is None else as_number(white, "white")
    grey = as_image(grey, "grey")
    if white is None:
        step = max(1, int(np.sqrt(grey.size / _SAMPLES)))
        low, high = np.quantile(grey[::step, ::step].astype(np.float64), (_TAIL, 1 - _TAIL))
        black, white = float(low), float(high)
        if white <= black:
            return np.zeros(grey.shape, np.uint8)
    _require_range(black, white)
    if grey.dtype == np.uint8 and black == 0 and white == 255:
        return grey
    if grey.dtype == np.float32:
        # Black may be large beside the range (kelvin): their difference is taken in double precision.
        grey = grey.astype(np.float64)
    factor = 255 / (white - black)
    if grey.dtype.kind == "u" and black.is_integer() and 0 <= black <= np.iinfo(grey.dtype).max:
        # Two passes that are fast: clamped at black, nothing is negative.
        clamped = np.maximum(grey, grey.dtype.type(black))
        return np.asarray(cv2.convertScaleAbs(clamped, alpha=factor, beta=-black * factor), np.uint8)
    return _scaled(grey, factor, -black * factor, np.dtype(np.uint8))


def _require_range(black: float, white: float) -> None:
    if not (math.isfinite(black) and math.isfinite(white) and white > black):
        raise ShapeError(f"black, white: {black:g}, {white:g}; need finite numbers, white above black")


def _scaled(image: Image, factor: float, offset: float, dtype: np.dtype[np.generic]) -> Image:
    depth = cv2.CV_8U if dtype == np.uint8 else cv2.CV_16U
    # Adds, rounds and saturates in one pass (convertScaleAbs would fold negative values back).
    return cv2.addWeighted(image, factor, image, 0.0, offset, dtype=depth)
