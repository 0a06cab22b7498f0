"""Harris corners (notes 4.2.1; Harris & Stephens 1988)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.types import Floats, Image, Points, as_image
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.orientation import centroid_orientation

K = 0.04
WINDOW_SIGMA_PX = 1.5

_SURPLUS = 3
_QUALITY = 1e-4  # share of the strongest response below which a maximum is noise
_BORDER_PX = 4
_NEIGHBOURS_BEFORE = np.array([[1, 1, 1], [1, 0, 0], [0, 0, 0]], np.uint8)
#: A peak half-way between pixels, and a little further when rounding or an oblique shape adds to it, is believed.
_MAX_OFFSET_PX = 0.75


def harris_response(image: Image, window_sigma: float = WINDOW_SIGMA_PX, k: float = K) -> Image:
    """Return det(M) - k tr(M)^2 at every pixel, M the gradient's second moments under a Gaussian window.

    Parameters
    ----------
    image : (H, W) uint8 or float32
    window_sigma : px
    k : Harris' constant, 0.04 to 0.06

    Returns
    -------
    (H, W) float32, for intensities in [0, 1] and gradients by Sobel's 3x3 operator divided by 8.
    """
    image = as_image(image, dtypes=(np.uint8, np.float32))
    scale = 1 / (8 * 255) if image.dtype == np.uint8 else 1 / 8
    gx = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=scale)
    gy = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=3, scale=scale)
    xx, yy, xy = (cv2.GaussianBlur(g, (0, 0), window_sigma) for g in (gx * gx, gy * gy, gx * gy))
    return np.asarray(xx * yy - xy * xy - np.float32(k) * (xx + yy) ** 2, np.float32)


def detect_harris(image: Image, max_count: int) -> Corners:
    """Find Harris corners on one picture, to sub-pixel accuracy, oriented by the intensity centroid.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : wanted number; up to three times as many are returned, for spreading to choose from
    """
    image = as_image(image, dtypes=(np.uint8,))
    response = harris_response(image)
    b = _BORDER_PX
    if min(response.shape) <= 2 * b:
        return Corners(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0))
    # Of equal neighbours, which symmetric corners have, the first in reading order is the peak.
    peak = (response > cv2.dilate(response, _NEIGHBOURS_BEFORE)) & (
        response >= cv2.dilate(response, np.ascontiguousarray(_NEIGHBOURS_BEFORE[::-1, ::-1]))
    )
    peak &= response > max(_QUALITY * float(response.max()), 0.0)
    peak[:b] = peak[-b:] = peak[:, :b] = peak[:, -b:] = False
    rows, columns = np.nonzero(peak)
    strength = response[rows, columns]
    order = np.lexsort((columns, rows, -strength))[: _SURPLUS * max_count]
    rows, columns = rows[order], columns[order]
    xy = np.column_stack((columns, rows)).astype(np.float64)
    xy += _parabola_offset(response, rows, columns)
    return Corners(
        xy=xy,
        scale=np.full(len(xy), WINDOW_SIGMA_PX),
        angle=centroid_orientation(image, xy),
        response=strength[order].astype(np.float64),
    )


def _parabola_offset(response: Image, rows: np.typing.NDArray[np.intp], columns: np.typing.NDArray[np.intp]) -> Points:
    """Return the maximum of the paraboloid through each 3x3 neighbourhood, (N, 2) x y; 0 where it has none nearby."""
    value = response.astype(np.float64)

    def at(dy: int, dx: int) -> Floats:
        return np.asarray(value[rows + dy, columns + dx], np.float64)

    gx, gy = (at(0, 1) - at(0, -1)) / 2, (at(1, 0) - at(-1, 0)) / 2
    xx, yy = at(0, 1) - 2 * at(0, 0) + at(0, -1), at(1, 0) - 2 * at(0, 0) + at(-1, 0)
    xy = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4
    determinant = xx * yy - xy * xy
    regular = determinant > 1e-12 * (xx * xx + yy * yy)
    safe = np.where(regular, determinant, 1.0)
    offset = np.column_stack(((xy * gy - yy * gx) / safe, (xy * gx - xx * gy) / safe))
    inside = regular & (np.abs(offset) <= _MAX_OFFSET_PX).all(axis=1)
    return np.where(inside[:, None], offset, 0.0)
