# SPDX-License-Identifier: Apache-2.0
"""Edges: strength, threshold, Canny (IU 2.2.6; Canny 1986)."""

from __future__ import annotations

import math

import cv2
import numpy as np

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Mask, as_image, require_unit_range
from imgu_ros.vision.processing.borders import Border
from imgu_ros.vision.processing.derivatives import Derivative, gradient
from imgu_ros.vision.processing.points import full_scale, require_range
from imgu_ros.vision.scale_space.gaussian import smooth

#: Values of a float image may be this much smaller than float32's largest: squares are to stay within.
_ROOM_FOR_SQUARES = 1e20
#: Steps of a slope across the whole range: its length then fits 16 signed bits, which `cv2.Canny` asks for.
_STEPS = 46340.0


def edge_strength(
    image: Image,
    operator: Derivative | str = Derivative.SOBEL,
    sigma: float = 1.0,
    border: Border | str = Border.REFLECTED,
) -> Image:
    """Return the squared length of the gradient, I_x^2 + I_y^2.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32
    operator, sigma, border : as in `gradient`

    Returns
    -------
    (H, W) float32, squared values per squared px.

    Raises
    ------
    ShapeError
        As `gradient`.

    Notes
    -----
    Source: IU 2.2.6.

    Examples
    --------
    >>> step = np.repeat(np.array([[0, 0, 8, 8]], np.uint8), 3, axis=0)
    >>> edge_strength(step)[1].tolist()
    [0.0, 16.0, 16.0, 0.0]
    """
    image = as_image(image)
    require_range(image, _ROOM_FOR_SQUARES)
    slope = gradient(image, operator, sigma, border)
    return np.asarray(slope.dx**2 + slope.dy**2)


def edge_map(image: Image, threshold: float, operator: Derivative | str = Derivative.SOBEL) -> Mask:
    """Return where the gradient is at least `threshold` long: edges as wide as the operator makes them.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32
    threshold : values per px, >= 0
    operator : sobel, scharr or gaussian (of sigma 1 px)

    Returns
    -------
    (H, W) bool

    Raises
    ------
    ShapeError
        As `gradient`; or if the threshold is negative or not finite.

    Notes
    -----
    Source: IU 2.2.6.

    Examples
    --------
    >>> step = np.repeat(np.array([[0, 0, 8, 8]], np.uint8), 3, axis=0)
    >>> edge_map(step, 4)[1].tolist()
    [False, True, True, False]
    """
    threshold = as_number(threshold, "threshold")
    if not 0 <= threshold < math.inf:
        raise ShapeError(f"threshold: {threshold!r}; need a finite number >= 0")
    # No strength is larger than this; a larger square would leave float32.
    return edge_strength(image, operator) >= np.float32(min(threshold, 1e18) ** 2)


def canny(image: Image, low: float, high: float, sigma: float = 1.0) -> Mask:
    """Find edges one pixel wide: ridges of the gradient's length, linked by two thresholds.

    A ridge pixel is an edge when its gradient is longer than `high`, or longer than `low` and linked to such a one
    through others.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32 in [0, 1] (values outside are clamped)
    low, high : lengths of the gradient, the image's values per px, 0 <= low <= high
    sigma : Gaussian that smooths first, 0 to 100 px

    Returns
    -------
    (H, W) bool

    Raises
    ------
    ShapeError
        If `image` is not such an image or a number lies outside its range.

    Notes
    -----
    Source: Canny 1986; IU 2.2.6. Smoothed in floats, so that weak slopes are not lost in rounding; slopes by Sobel,
    rounded to 1/46340 of the range.

    Examples
    --------
    >>> step = np.repeat(np.array([[10] * 8 + [90] * 8], np.uint8), 9, axis=0)
    >>> [int(i) for i in np.flatnonzero(canny(step, 5, 10)[4])] in ([7], [8])
    True
    """
    low = as_number(low, "low")
    high = as_number(high, "high")
    sigma = as_number(sigma, "sigma")
    image = as_image(image)
    if not 0 <= low <= high < math.inf:
        raise ShapeError(f"low, high: {low!r}, {high!r}; need 0 <= low <= high")
    if not 0 <= sigma <= 100:
        raise ShapeError(f"sigma: {sigma!r}; need 0 to 100 px")
    require_unit_range(image)
    picture = np.clip(image, 0, 1) if image.dtype.kind == "f" else image.astype(np.float32)
    # A slope is at most half the range for each px, along x and along y.
    steps = _STEPS / full_scale(image.dtype)
    slope = gradient(smooth(picture, sigma))
    dx, dy = (np.rint(steps * d).astype(np.int16) for d in (slope.dx, slope.dy))
    thresholds = [min(steps * t, 32767.0) for t in (low, high)]
    return np.asarray(cv2.Canny(dx, dy, thresholds[0], thresholds[1], L2gradient=True) > 0)
