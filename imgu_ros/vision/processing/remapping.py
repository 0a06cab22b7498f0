# SPDX-License-Identifier: Apache-2.0
"""Warps by any map: where each pixel of the result comes from, point by point (IU 2.3.5)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_floats, as_image
from imgu_ros.vision.processing.borders import CV_BORDERS, Border, border_values
from imgu_ros.vision.processing.interpolation import CV_SAMPLING, MOST_SIDE_PX, Interpolation
from imgu_ros.vision.processing.points import require_range


def remapped(
    image: Image,
    xy: ArrayLike,
    interpolation: Interpolation | str = Interpolation.LINEAR,
    border: Border | str = Border.CONSTANT,
    value: float = 0.0,
) -> Image:
    """Draw an image through any map, such as a lens: out(i, j) = image(xy[i, j]).

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    xy : (h, w, 2) px, -32766 to 32766: where each pixel of the result is looked up
    interpolation : nearest, linear or cubic; smooth the image first when the map reduces it
    border, value : what stands outside the image

    Returns
    -------
    (h, w) or (h, w, 3), same data type.

    Raises
    ------
    ShapeError
        If an argument is not as said.

    Notes
    -----
    Source: IU 2.3.5. OpenCV before version 5 rounds the place to 1/32 px. `warping.warped` needs no map when it is a
    homography; `interpolation.sampled` is exact at single points.

    Examples
    --------
    >>> image = np.array([[1, 2, 3]], np.uint8)
    >>> remapped(image, [[[2, 0], [1, 0]], [[0, 0], [5, 0]]], value=9).tolist()
    [[3, 2], [1, 9]]
    """
    value = as_number(value, "value")
    image = as_image(image, channels=(1, 3))
    require_range(image, 4.0)
    # Large maps: no copy of what is fit for OpenCV.
    places = xy if isinstance(xy, np.ndarray) and xy.dtype == np.float32 else as_floats(xy, "xy")
    if places.ndim != 3 or places.shape[2] != 2 or not places.size:
        raise ShapeError(f"xy: shape {places.shape}; need (h, w, 2) of at least one pixel")
    if max(*image.shape[:2], *places.shape[:2]) > MOST_SIDE_PX:
        raise ShapeError(f"image: shape {image.shape}, xy: shape {places.shape}; need sides up to {MOST_SIDE_PX} px")
    if not (places.min() >= -MOST_SIDE_PX and places.max() <= MOST_SIDE_PX):
        raise ShapeError(f"xy: not finite, or beyond {MOST_SIDE_PX} px; need places nearer to the image")
    interpolation, border = Interpolation(interpolation), Border(border)
    if interpolation is Interpolation.AREA:
        raise ShapeError("interpolation: 'area'; need nearest, linear or cubic: `resized` knows areas")
    x, y = (np.ascontiguousarray(places[..., axis], np.float32) for axis in (0, 1))
    return cv2.remap(
        image,
        x,
        y,
        CV_SAMPLING[interpolation],
        borderMode=CV_BORDERS[border],
        borderValue=border_values(image.dtype, border, value),
    )
