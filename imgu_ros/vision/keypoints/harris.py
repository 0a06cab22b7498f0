# SPDX-License-Identifier: Apache-2.0
"""Harris corners (IU 4.2.1; Harris & Stephens 1988)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_image
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.orientation import centroid_orientation
from imgu_ros.vision.keypoints.peaks import find_peaks
from imgu_ros.vision.keypoints.spreading import spread

K = 0.04
WINDOW_SIGMA_PX = 1.5

_QUALITY = 1e-4  # share of the strongest response below which a maximum is noise
_BORDER_PX = 4
#: The response is of the fourth order in the intensities, and has to stay in float32's range.
_LARGEST_INTENSITY = 1e6
_LARGEST_SIGMA_PX = 100.0


def detect_harris(image: Image, max_count: int) -> Corners:
    """Detect Harris corners in one image, to sub-pixel accuracy, oriented by the intensity centroid.

    The maxima of `harris_response` over 3x3 neighbourhoods, each at the vertex of the paraboloid through its nine
    values, spread over the image.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : maximum number of corners, >= 1

    Returns
    -------
    Corners, strongest first; scale is the window's sigma.

    Raises
    ------
    ShapeError
        If `image` is not such an image or `max_count` is not positive.

    Notes
    -----
    Peak memory on 1920x1080: 65 MB.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.zeros((60, 60), np.uint8)
    >>> image[30:, 30:] = image[:30, :30] = 200
    >>> detect_harris(image, 10).xy.round(1).tolist()
    [[29.5, 29.5]]
    """
    max_count = as_integer(max_count, "max_count")
    image = as_image(image, dtypes=(np.uint8,))
    peaks = find_peaks(harris_response(image), _QUALITY, _BORDER_PX)
    kept = spread(peaks.xy, peaks.height, (image.shape[1], image.shape[0]), max_count)
    xy = peaks.xy[kept]
    return Corners(xy, np.full(len(xy), WINDOW_SIGMA_PX), centroid_orientation(image, xy), peaks.height[kept])


def harris_response(image: Image, window_sigma: float = WINDOW_SIGMA_PX, k: float = K) -> Image:
    """Return det(M) - k tr(M)^2 at every pixel, M the gradient's second moments under a Gaussian window.

    Positive at corners, negative at edges, about zero where nothing is.

    Parameters
    ----------
    image : (H, W) uint8, or float32 of magnitude up to 1e6
    window_sigma : px, above 0, up to 100
    k : Harris' constant, 0.04 to 0.06 as a rule; 0 up to 0.25, from where on no corner is left

    Returns
    -------
    (H, W) float32, for intensities in [0, 1] and gradients by Sobel's 3x3 operator divided by 8.

    Raises
    ------
    ShapeError
        If `image` is not such an image, or `window_sigma` or `k` lies outside its range.

    Notes
    -----
    IU 4.2.1; Harris & Stephens, "A combined corner and edge detector", 1988, equation 8 ff.
    """
    window_sigma = as_number(window_sigma, "window_sigma")
    k = as_number(k, "k")
    image = as_image(image, dtypes=(np.uint8, np.float32))
    if not 0 < window_sigma <= _LARGEST_SIGMA_PX or not 0 <= k < 0.25:
        raise ShapeError(
            f"window_sigma, k: {window_sigma}, {k}; need above 0, up to {_LARGEST_SIGMA_PX:g}, and 0 to below 0.25"
        )
    if image.dtype == np.float32 and float(np.abs(image).max()) > _LARGEST_INTENSITY:
        raise ShapeError(f"image: up to {np.abs(image).max():g}; need at most {_LARGEST_INTENSITY:g}")
    scale = 1 / (8 * 255) if image.dtype == np.uint8 else 1 / 8
    gx = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=scale)
    gy = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=3, scale=scale)
    xx, yy, xy = (cv2.GaussianBlur(g, (0, 0), window_sigma) for g in (gx * gx, gy * gy, gx * gy))
    return np.asarray(xx * yy - xy * xy - np.float32(k) * (xx + yy) ** 2, np.float32)
