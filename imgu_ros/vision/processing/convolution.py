# SPDX-License-Identifier: Apache-2.0
"""Convolution with any kernel and any border (IU 2.2.1 to 2.2.4)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, as_image
from imgu_ros.vision.processing.borders import CV_BORDERS, Border, border_values, padded
from imgu_ros.vision.processing.points import require_range
from imgu_ros.vision.processing.separability import as_kernel, split

#: Beyond so many weights OpenCV goes through the frequency domain, at a time that no longer grows.
_FREQUENCY_DOMAIN = 150
_MOST_PX = 1023


def convolve(image: Image, kernel: ArrayLike, border: Border | str = Border.REFLECTED, value: float = 0.0) -> Image:
    """Convolve an image with a kernel: out(x, y) = sum over i, j of kernel(j, i) image(x - i, y - j).

    The kernel is flipped, as convolution is defined; its centre is the origin. A kernel of low rank is split into rows
    and columns wherever that takes clearly fewer multiplications.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    kernel : (h, w), both odd, up to 1023
    border : what stands outside the image
    value : for a constant border, in the image's values

    Returns
    -------
    Same shape, float32, in the image's values.

    Raises
    ------
    ShapeError
        If `image` is not such an image or so large in value that the result leaves float32, the kernel has an even
        side, or the border is unknown.

    Notes
    -----
    Source: IU 2.2.1 to 2.2.3. Time is O(H W h w), or O(H W rank (h + w)) where the kernel is split.

    Examples
    --------
    >>> image = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 0]], np.float32)
    >>> convolve(image, [[1, 2, 3], [4, 5, 6], [7, 8, 9]], "constant").tolist()
    [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]
    """
    image = as_image(image, channels=(1, 3))
    weights = _odd(as_kernel(kernel))
    border = Border(border)
    require_range(image, float(np.abs(weights).sum()))
    height, width = weights.shape
    parts = split(weights)
    if 2 * parts.multiplications < min(height * width, _FREQUENCY_DOMAIN):
        out = np.zeros(image.shape, np.float32)
        for column, row in zip(parts.columns, parts.rows, strict=True):
            out += _separable(image, column, row, border, value)
        return out
    x, y = width // 2, height // 2
    # filter2D knows no periodic border and no constant but 0.
    wide = padded(image, x, y, border, value)
    source = wide if wide.dtype != np.uint16 else wide.astype(np.float32)
    filtered = cv2.filter2D(source, cv2.CV_32F, np.ascontiguousarray(weights[::-1, ::-1]))
    return np.ascontiguousarray(filtered[y : y + image.shape[0], x : x + image.shape[1]])


def convolve_separable(
    image: Image, column: ArrayLike, row: ArrayLike, border: Border | str = Border.REFLECTED, value: float = 0.0
) -> Image:
    """Convolve an image with a column and then with a row.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    column, row : (h,), (w,), both of odd length up to 1023; flipped, as convolution is defined
    border, value : as in `convolve`

    Returns
    -------
    Same shape, float32.

    Raises
    ------
    ShapeError
        As `convolve`.

    Notes
    -----
    Source: IU 2.2.3.

    Examples
    --------
    >>> image = np.array([[0, 0, 4, 0, 0]], np.uint8)
    >>> convolve_separable(image, [1.0], [0.25, 0.5, 0.25]).tolist()
    [[0.0, 1.0, 2.0, 1.0, 0.0]]
    """
    value = as_number(value, "value")
    image = as_image(image, channels=(1, 3))
    vertical, horizontal = (
        _odd(as_kernel(np.atleast_2d(_vector(k, name)))) for k, name in ((column, "column"), (row, "row"))
    )
    require_range(image, max(1.0, float(np.abs(vertical).sum())) * max(1.0, float(np.abs(horizontal).sum())))
    return _separable(image, vertical[0], horizontal[0], Border(border), value)


def mean_filtered(image: Image, size: int, border: Border | str = Border.REFLECTED, value: float = 0.0) -> Image:
    """Return the mean of the size x size pixels about each one.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    size : odd, 1 to 1023 px
    border, value : as in `convolve`

    Returns
    -------
    Same shape and data type; integers are rounded.

    Raises
    ------
    ShapeError
        If `image` is not such an image, the size is even or out of range, or the border is unknown.

    Notes
    -----
    Source: IU 2.2.1. By running sums: the time does not depend on `size`.

    Examples
    --------
    >>> mean_filtered(np.array([[0, 9, 0, 0]], np.uint8), 3, "replicated").tolist()
    [[3, 3, 3, 0]]
    """
    size = as_integer(size, "size")
    image = as_image(image, channels=(1, 3))
    if isinstance(size, bool) or not isinstance(size, int | np.integer) or not 1 <= size <= _MOST_PX or size % 2 == 0:
        raise ShapeError(f"size: {size!r}; need an odd integer, 1 to {_MOST_PX} px")
    require_range(image, float(size) ** 2)
    reach = int(size) // 2
    wide = padded(image, reach, reach, border, value)
    filtered = cv2.blur(wide, (int(size), int(size)))
    return np.ascontiguousarray(filtered[reach : reach + image.shape[0], reach : reach + image.shape[1]])


def _separable(image: Image, column: Floats, row: Floats, border: Border, value: float) -> Image:
    source = image if image.dtype != np.uint16 else image.astype(np.float32)
    flipped = np.ascontiguousarray(row[::-1]), np.ascontiguousarray(column[::-1])
    x, y = len(row) // 2, len(column) // 2
    constant = border_values(image.dtype, border, value)[0]
    if border is Border.PERIODIC or (border is Border.CONSTANT and constant != 0):
        wide = padded(source, x, y, border, value)
        filtered = cv2.sepFilter2D(wide, cv2.CV_32F, *flipped)
        return np.ascontiguousarray(filtered[y : y + image.shape[0], x : x + image.shape[1]])
    return cv2.sepFilter2D(source, cv2.CV_32F, *flipped, borderType=CV_BORDERS[border])


def _odd(weights: Floats) -> Floats:
    if weights.shape[0] % 2 == 0 or weights.shape[1] % 2 == 0:
        raise ShapeError(f"kernel: shape {weights.shape}; need odd sides: its centre is the origin")
    return weights


def _vector(values: ArrayLike, name: str) -> ArrayLike:
    try:
        array = np.asarray(values)
    except ValueError:
        raise ShapeError(f"{name}: ragged; need (n,) numbers") from None
    if array.ndim != 1:
        raise ShapeError(f"{name}: shape {array.shape}; need (n,)")
    return array
