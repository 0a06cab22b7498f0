# SPDX-License-Identifier: Apache-2.0
"""Values between pixels, and resizing (IU 2.3.1, 2.3.2; Keys 1981)."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import shown_value
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Floats, Image, as_image, as_points
from imgu_ros.vision.processing.borders import Border, border_values, source_index
from imgu_ros.vision.processing.points import require_range

#: OpenCV's limit for one side of a remapped picture.
MOST_SIDE_PX = 32766
_MOST_PIXELS = 2**28
#: Slope of Keys' kernel at distance 1 that keeps polynomials of degree 2; OpenCV's -0.75 keeps not even a ramp.
_KEYS = -0.5


class Interpolation(Choice):
    """How a value between pixels is made."""

    NEAREST = "nearest"  #: the nearest pixel's: keeps the values, for labels and masks
    LINEAR = "linear"  #: from 2 x 2 pixels
    CUBIC = "cubic"  #: from 4 x 4 pixels, sharper; overshoots at edges
    AREA = "area"  #: the mean over the area of the new pixel, for reducing; `resized` only


#: The same, where a picture is looked up at points, in OpenCV's words.
CV_SAMPLING: dict[Interpolation, int] = {
    Interpolation.NEAREST: cv2.INTER_NEAREST,
    Interpolation.LINEAR: cv2.INTER_LINEAR,
    Interpolation.CUBIC: cv2.INTER_CUBIC,
}


def resized(image: Image, size: Sequence[int], interpolation: Interpolation | str = Interpolation.LINEAR) -> Image:
    """Scale an image to a size.

    Pixel areas are aligned: the pixel x of the result lies at (x + 0.5) W / size_x - 0.5 of the image. To reduce,
    take `area`, or smooth first: the others look at the nearest few pixels only, and alias.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    size : (width, height), px, 1 to 32766
    interpolation : nearest, linear, cubic or area (which enlarges like linear)

    Raises
    ------
    ShapeError
        If `image` is not such an image or its values leave float32, the size is not two integers in range, or the
        interpolation is unknown.

    Notes
    -----
    Source: IU 2.3.1, 2.3.2. Nearest takes the pixel that holds the new pixel's centre.

    Examples
    --------
    >>> image = np.array([[10, 4], [2, 8]], np.uint8)
    >>> resized(image, (4, 4), "nearest").tolist()
    [[10, 10, 4, 4], [10, 10, 4, 4], [2, 2, 8, 8], [2, 2, 8, 8]]
    >>> resized(image, (1, 1), "area").tolist()
    [[6]]
    """
    image = as_image(image, channels=(1, 3))
    require_range(image, 4.0)
    return cv2.resize(image, checked_size(size), interpolation=_CV_RESIZE[Interpolation(interpolation)])


def sampled(
    image: Image,
    xy: ArrayLike,
    interpolation: Interpolation | str = Interpolation.LINEAR,
    border: Border | str = Border.REPLICATED,
    value: float = 0.0,
) -> Floats:
    """Return an image's values at points, exactly.

    In float64 and without the 1/32 px steps of OpenCV's remapping before version 5.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32
    xy : (N, 2) px, up to 1e9
    interpolation : nearest (halves go right and down), linear or cubic
    border, value : what stands outside the image

    Returns
    -------
    (N,) in the image's values; cubic ones may overshoot.

    Raises
    ------
    ShapeError
        If an argument is not as said.

    Notes
    -----
    Source: IU 2.3.2; Keys 1981 with a = -0.5: exact on polynomials of degree 2 (OpenCV's warps have a = -0.75).

    Examples
    --------
    >>> image = np.array([[0, 10], [20, 30]], np.uint8)
    >>> sampled(image, [[0.5, 0.5], [0.1, 0], [1, 1]]).round(9).tolist()
    [15.0, 1.0, 30.0]
    """
    image = as_image(image)
    require_range(image, 4.0)
    points = as_points(xy, "xy")
    if len(points) and np.abs(points).max() > 1e9:
        raise ShapeError(f"xy: up to {np.abs(points).max():.3g}; need at most 1e9 px")
    interpolation, border = Interpolation(interpolation), Border(border)
    if interpolation is Interpolation.AREA:
        raise ShapeError("interpolation: 'area'; need nearest, linear or cubic: a point has no area")
    constant = border_values(image.dtype, border, value)[0]
    before = np.floor(points + 0.5 if interpolation is Interpolation.NEAREST else points)
    weights_x, weights_y = (_weights(axis, interpolation) for axis in (points - before).T)
    first = before.astype(np.int64) + _FIRST[interpolation]
    total = np.zeros(len(points))
    for j in range(weights_y.shape[1]):
        row = source_index(first[:, 1] + j, image.shape[0], border)
        for i in range(weights_x.shape[1]):
            column = source_index(first[:, 0] + i, image.shape[1], border)
            values = image[row, column].astype(np.float64)
            if border is Border.CONSTANT:
                values = np.where((row < 0) | (column < 0), constant, values)
            total += weights_y[:, j] * weights_x[:, i] * values
    return total


def checked_size(size: Sequence[int]) -> tuple[int, int]:
    """Return a size (width, height) of whole px.

    Raises
    ------
    ShapeError
        If it is not two integers from 1 to 32766, or more than 2^28 pixels in all.
    """
    try:
        width, height = size
    except (TypeError, ValueError):
        raise ShapeError(f"size: {shown_value(size)}; need (width, height)") from None
    for side in (width, height):
        if isinstance(side, bool) or not isinstance(side, int | np.integer) or not 1 <= side <= MOST_SIDE_PX:
            raise ShapeError(f"size: {(width, height)!r}; need two integers, 1 to {MOST_SIDE_PX} px")
    if int(width) * int(height) > _MOST_PIXELS:
        raise ShapeError(f"size: {(int(width), int(height))!r}; need at most {_MOST_PIXELS} pixels")
    return int(width), int(height)


def _weights(fraction: Floats, interpolation: Interpolation) -> Floats:
    """Return the weights of the neighbours, (N, 1, 2 or 4), at fractions 0 to 1 behind a pixel."""
    f = fraction[:, None]
    if interpolation is Interpolation.NEAREST:
        return np.ones_like(f)
    if interpolation is Interpolation.LINEAR:
        return np.hstack([1 - f, f])
    d = np.abs(f - np.arange(-1, 3))
    near = ((_KEYS + 2) * d - (_KEYS + 3)) * d**2 + 1
    far = _KEYS * (((d - 5) * d + 8) * d - 4)
    return np.where(d <= 1, near, far)


#: Where the first neighbour lies, from the pixel at or before the point.
_FIRST = {Interpolation.NEAREST: 0, Interpolation.LINEAR: 0, Interpolation.CUBIC: -1}
_CV_RESIZE: dict[Interpolation, int] = {
    # The plain INTER_NEAREST takes the pixel left of the centre when it reduces.
    Interpolation.NEAREST: cv2.INTER_NEAREST_EXACT,
    Interpolation.LINEAR: cv2.INTER_LINEAR,
    Interpolation.CUBIC: cv2.INTER_CUBIC,
    Interpolation.AREA: cv2.INTER_AREA,
}
