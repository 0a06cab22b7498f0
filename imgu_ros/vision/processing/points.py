# SPDX-License-Identifier: Apache-2.0
"""Operations on single pixels (IU 2.1.1, 2.1.2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_number, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, as_image, as_matrix, require_unit_range

#: Weights of red, green and blue in brightness (ITU-R BT.601; IU 2.1.2).
REC601 = (0.299, 0.587, 0.114)

_LARGEST_GAIN = 1e6


def adjust(image: Image, contrast: float = 1.0, brightness: float = 0.0) -> Image:
    """Change contrast and brightness: clamp(contrast * I + brightness), clamped before it is cast.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    contrast : factor, -1e6 to 1e6
    brightness : added, in the image's values; the clamp is 0 to 255, 65535 or 1 by data type

    Returns
    -------
    Same shape and data type; integers are rounded to nearest, ties to even.

    Raises
    ------
    ShapeError
        If `image` is not such an image, or a number is not finite or out of range.

    Notes
    -----
    Source: IU 2.1.1. 255 + 1 stays 255: arithmetic modulo 256 would make it 0.

    Examples
    --------
    >>> adjust(np.array([[0, 100, 255]], np.uint8), contrast=1.5, brightness=1).tolist()
    [[1, 151, 255]]
    """
    contrast = as_number(contrast, "contrast")
    brightness = as_number(brightness, "brightness")
    image = as_image(image, channels=(1, 3))
    require_unit_range(image)
    if not abs(contrast) <= _LARGEST_GAIN:
        raise ShapeError(f"contrast: {contrast!r}; need -1e6 to 1e6")
    if not abs(brightness) <= full_scale(image.dtype) * _LARGEST_GAIN:
        raise ShapeError(f"brightness: {brightness!r}; need a number up to 1e6 times the image's range")
    return _mapped(image, lambda values: contrast * values + brightness)


def gamma_corrected(image: Image, exponent: float) -> Image:
    """Raise an image to a power: full (I / full)^exponent; below 1 it gets brighter, above 1 darker.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32; floats are clamped to [0, 1] first
    exponent : 0.01 to 100

    Raises
    ------
    ShapeError
        If `image` is not such an image, or the exponent lies outside its range.

    Examples
    --------
    >>> gamma_corrected(np.array([[0, 64, 255]], np.uint8), 0.5).tolist()
    [[0, 128, 255]]
    """
    exponent = as_number(exponent, "exponent")
    image = as_image(image, channels=(1, 3))
    require_unit_range(image)
    if not 0.01 <= exponent <= 100:
        raise ShapeError(f"exponent: {exponent!r}; need 0.01 to 100")
    full = full_scale(image.dtype)
    return _mapped(image, lambda values: full * (np.clip(values, 0, full) / full) ** exponent)


def grey_from_rgb(image: Image, weights: ArrayLike = REC601) -> Image:
    """Return the weighted sum of the channels.

    Parameters
    ----------
    image : (H, W, 3) RGB, uint8, uint16 or float32
    weights : (3,) of red, green and blue, each -1e6 to 1e6; those of ITU-R BT.601 unless told

    Returns
    -------
    (H, W), same data type; integers rounded and clamped.

    Raises
    ------
    ShapeError
        If `image` is not such an image, or the weights are not three numbers in range.

    Notes
    -----
    Source: IU 2.1.2.

    Examples
    --------
    >>> grey_from_rgb(np.array([[[255, 0, 0], [10, 20, 30]]], np.uint8)).tolist()
    [[76, 18]]
    """
    image = as_image(image, channels=(3,))
    weights = as_matrix(weights, (3,), "weights")
    if np.abs(weights).max() > _LARGEST_GAIN:
        raise ShapeError(f"weights: up to {np.abs(weights).max():g}; need -1e6 to 1e6")
    require_range(image, float(np.abs(weights).sum()))
    return cv2.transform(image, weights[None])


def full_scale(dtype: np.dtype[Any]) -> float:
    """Return the value of white in pictures of type `dtype`: 255, 65535, or 1 for floats."""
    require_type(dtype, np.dtype, "dtype")
    return float(np.iinfo(dtype).max) if dtype.kind == "u" else 1.0


def require_range(image: Image, gain: float) -> None:
    """Refuse a float image whose values times `gain` would leave float32.

    Raises
    ------
    ShapeError
        If they would, or it is no image.
    """
    gain = as_number(gain, "gain")
    if not isinstance(image, np.ndarray) or image.size == 0:
        raise ShapeError(f"image: {getattr(image, 'shape', type(image).__name__)}; need at least one pixel")
    if image.dtype.kind != "f":
        return
    largest = max(abs(float(image.max())), abs(float(image.min())))
    limit = float(np.finfo(np.float32).max) / 16
    if largest > limit or (gain > 0 and largest > limit / gain):
        raise ShapeError(f"image: values up to {largest:.3g}; need at most {limit / max(gain, 1.0):.3g} here")


def _mapped(image: Image, function: Callable[[Floats], Floats]) -> Image:
    """Apply a function of float64 values, clamp, and cast back."""
    full = full_scale(image.dtype)
    if image.dtype.kind == "f":
        return np.clip(function(image.astype(np.float64)), 0, 1).astype(np.float32)
    table = np.rint(np.clip(function(np.arange(full + 1)), 0, full)).astype(image.dtype)
    return cv2.LUT(image, table) if image.dtype == np.uint8 else table[image]
