# SPDX-License-Identifier: Apache-2.0
"""Moravec corners: patches unlike each of their eight neighbours (IU 4.2.2; Moravec 1980)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_image
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.orientation import centroid_orientation
from imgu_ros.vision.keypoints.peaks import find_peaks
from imgu_ros.vision.keypoints.spreading import spread

WINDOW_PX = 5

#: The other four shifts are these reversed: V of -(u, v) at (x, y) is V of (u, v) at (x - u, y - v).
_SHIFTS = ((1, 0), (0, 1), (1, 1), (1, -1))
_QUALITY = 1e-3  # share of the strongest response below which a maximum is noise
_BORDER_PX = 4
#: Standard deviation of a box of WINDOW_PX: the scale of what the window sees.
_SIGMA_PX = float(np.sqrt((WINDOW_PX**2 - 1) / 12))
_LARGEST_INTENSITY = 1e6
_LARGEST_WINDOW_PX = 99


def detect_moravec(image: Image, max_count: int) -> Corners:
    """Detect Moravec corners in one image, to sub-pixel accuracy, oriented by the intensity centroid.

    The maxima of `moravec_response` over 3x3 neighbourhoods, each at the vertex of the paraboloid through its nine
    values, spread over the image. The ancestor of the others, for comparison: it answers to slanted edges too, as
    it looks in eight directions only.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : maximum number of corners, >= 1

    Returns
    -------
    Corners, strongest first; scale is the window's standard deviation.

    Raises
    ------
    ShapeError
        If `image` is not such an image or `max_count` is not positive.

    Notes
    -----
    Peak memory on 1920x1080: 50 MB.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.zeros((60, 60), np.uint8)
    >>> image[30:, 20:] = 200
    >>> corners = detect_moravec(image, 10)
    >>> len(corners.xy), bool((abs(corners.xy - [20, 30]) < 2).all())
    (1, True)
    """
    max_count = as_integer(max_count, "max_count")
    image = as_image(image, dtypes=(np.uint8,))
    peaks = find_peaks(moravec_response(image), _QUALITY, _BORDER_PX)
    kept = spread(peaks.xy, peaks.height, (image.shape[1], image.shape[0]), max_count)
    xy = peaks.xy[kept]
    return Corners(xy, np.full(len(xy), _SIGMA_PX), centroid_orientation(image, xy), peaks.height[kept])


def moravec_response(image: Image, window: int = WINDOW_PX) -> Image:
    """Return the least mean squared difference between a pixel's window and the eight shifted by one pixel.

    min over (u, v) of the window's mean of (I(x, y) - I(x + u, y + v))^2, (u, v) in {-1, 0, 1}^2 without (0, 0).

    Parameters
    ----------
    image : (H, W) uint8, or float32 of magnitude up to 1e6; mirrored about its outermost pixels
    window : side of the square window, px, odd, 1 to 99

    Returns
    -------
    (H, W) float32, >= 0, for intensities in [0, 1].

    Raises
    ------
    ShapeError
        If `image` is not such an image or `window` no such side.

    Notes
    -----
    IU 4.2.2 sums over the window; the mean makes windows comparable. Moravec, "Obstacle avoidance and navigation in
    the real world by a seeing robot rover", 1980, chapter 5. Four squared differences and four box filters serve the
    eight shifts; the cost does not depend on the window.
    """
    window = as_integer(window, "window")
    image = as_image(image, dtypes=(np.uint8, np.float32))
    if not 1 <= window <= _LARGEST_WINDOW_PX or window % 2 != 1:
        raise ShapeError(f"window: {window}; need an odd number, 1 to {_LARGEST_WINDOW_PX}")
    if image.dtype == np.float32 and float(np.abs(image).max()) > _LARGEST_INTENSITY:
        raise ShapeError(f"image: up to {np.abs(image).max():g}; need at most {_LARGEST_INTENSITY:g}")
    height, width = image.shape
    reach = window // 2 + 2
    padded = cv2.copyMakeBorder(image, reach, reach, reach, reach, cv2.BORDER_REFLECT_101).astype(np.float32)
    if image.dtype == np.uint8:
        padded *= np.float32(1 / 255)
    least = np.full((height, width), np.inf, np.float32)
    for u, v in _SHIFTS:
        # At (x, y) of `variation`: V of (u, v) at (x + 1 - reach, y + 1 - reach) of the image.
        difference = padded[1:-1, 1:-1] - padded[1 + v : padded.shape[0] - 1 + v, 1 + u : padded.shape[1] - 1 + u]
        variation = cv2.boxFilter(difference * difference, -1, (window, window))
        for du, dv in ((0, 0), (u, v)):
            top, left = reach - 1 - dv, reach - 1 - du
            np.minimum(least, variation[top : top + height, left : left + width], out=least)
    return np.maximum(least, 0)
