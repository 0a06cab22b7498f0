# SPDX-License-Identifier: Apache-2.0
"""What stands outside a picture (IU 2.2.2)."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Image, Indices, as_image

_MOST_PX = 16384


class Border(Choice):
    """How a picture `abcd` goes on beyond its borders."""

    CONSTANT = "constant"  #: vv|abcd|vv
    PERIODIC = "periodic"  #: cd|abcd|ab
    REFLECTED = "reflected"  #: cb|abcd|cb, about the centre of the outermost pixel
    MIRRORED = "mirrored"  #: ba|abcd|dc, about the picture's edge
    REPLICATED = "replicated"  #: aa|abcd|dd


#: The same borders in OpenCV's words.
CV_BORDERS: dict[Border, int] = {
    Border.CONSTANT: cv2.BORDER_CONSTANT,
    Border.PERIODIC: cv2.BORDER_WRAP,
    Border.REFLECTED: cv2.BORDER_REFLECT_101,
    Border.MIRRORED: cv2.BORDER_REFLECT,
    Border.REPLICATED: cv2.BORDER_REPLICATE,
}


def padded(
    image: Image,
    margin_x: int,
    margin_y: int,
    border: Border | str = Border.REFLECTED,
    value: float = 0.0,
) -> Image:
    """Return the picture with a margin around it.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    margin_x, margin_y : px on each side, 0 to 16384; may be larger than the picture
    border : what fills the margin
    value : for `constant`, in the image's values

    Returns
    -------
    (H + 2 margin_y, W + 2 margin_x), same data type.

    Raises
    ------
    ShapeError
        If `image` is not such an image, a margin or the value lies outside its range, or the border is unknown.

    Examples
    --------
    >>> row = np.array([[1, 2, 3]], np.uint8)
    >>> [padded(row, 2, 0, border).tolist()[0] for border in ("periodic", "reflected", "mirrored", "replicated")]
    [[2, 3, 1, 2, 3, 1, 2], [3, 2, 1, 2, 3, 2, 1], [2, 1, 1, 2, 3, 3, 2], [1, 1, 1, 2, 3, 3, 3]]
    """
    margin_x = as_integer(margin_x, "margin_x")
    margin_y = as_integer(margin_y, "margin_y")
    value = as_number(value, "value")
    image = as_image(image, channels=(1, 3))
    for name, margin in (("margin_x", margin_x), ("margin_y", margin_y)):
        if not 0 <= margin <= _MOST_PX:
            raise ShapeError(f"{name}: {margin!r}; need 0 to {_MOST_PX} px")
    border = Border(border)
    values = border_values(image.dtype, border, value)
    x, y = int(margin_x), int(margin_y)
    return cv2.copyMakeBorder(image, y, y, x, x, CV_BORDERS[border], value=values)


def border_values(dtype: np.dtype[Any], border: Border, value: float) -> tuple[float, ...]:
    """Return the value outside a picture of type `dtype` for each of four channels, as OpenCV takes it.

    Raises
    ------
    ShapeError
        If the border is constant and its value is not one that a pixel of this data type can have.
    """
    require_type(dtype, np.dtype, "dtype")
    value = as_number(value, "value")
    if border is not Border.CONSTANT:
        return (0.0, 0.0, 0.0, 0.0)
    top = float(np.iinfo(dtype).max) if dtype.kind == "u" else float(np.finfo(np.float32).max)
    low = 0.0 if dtype.kind == "u" else -top
    if not low <= value <= top:
        raise ShapeError(f"value: {value!r}; need {low:g} to {top:g} in {dtype}")
    return (float(value),) * 4


def source_index(index: ArrayLike, size: int, border: Border | str) -> Indices:
    """Return which pixel of a row stands at each position, on the row or beyond its ends.

    Parameters
    ----------
    index : integers, any shape: positions, 0 the first pixel; negative ones lie before it
    size : pixels in the row, >= 1
    border : what stands outside

    Returns
    -------
    Same shape, 0 to size - 1; -1 where the constant stands.

    Raises
    ------
    ShapeError
        If the positions are not integers, size is not positive or the border is unknown.

    Examples
    --------
    >>> source_index([-2, -1, 0, 3, 4], 4, "mirrored").tolist()
    [1, 0, 0, 3, 3]
    """
    size = as_integer(size, "size")
    try:
        positions = np.asarray(index)
    except ValueError:
        raise ShapeError("index: ragged; need an array of integers") from None
    if positions.dtype.kind not in "iu":
        raise ShapeError(f"index: data type {positions.dtype}; need integers")
    if not (isinstance(size, int | np.integer) and size >= 1) or math.isnan(size):
        raise ShapeError(f"size: {size!r}; need a positive integer")
    border = Border(border)
    if positions.size and (int(positions.max()) > 2**62 or int(positions.min()) < -(2**62)):
        raise ShapeError("index: beyond 2^62; need positions near the row")
    at = positions.astype(np.int64)
    if border is Border.PERIODIC:
        at = at % size
    elif border is Border.REPLICATED:
        at = np.clip(at, 0, size - 1)
    elif border is Border.MIRRORED:
        at = at % (2 * size)
        at = np.minimum(at, 2 * size - 1 - at)
    elif border is Border.REFLECTED:
        period = max(2 * size - 2, 1)
        at = at % period
        at = np.minimum(at, period - at) if size > 1 else np.zeros_like(at)
    else:
        at = np.where((at >= 0) & (at < size), at, -1)
    return at.astype(np.intp)
