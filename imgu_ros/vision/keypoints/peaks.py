# SPDX-License-Identifier: Apache-2.0
"""Local maxima of a response map, to sub-pixel accuracy."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Points, as_image

_SQUARE = np.ones((3, 3), np.uint8)
#: Of the eight neighbours, those that come first in reading order: (dy, dx).
_BEFORE = ((-1, -1), (-1, 0), (-1, 1), (0, -1))
#: A peak half-way between pixels, and a little further when rounding or an oblique shape adds to it, is believed.
_MAX_OFFSET_PX = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """N local maxima of a map.

    Attributes
    ----------
    xy : (N, 2) px
    height : (N,) the map's value at the pixel of each
    """

    xy: Points
    height: Floats


def find_peaks(response: Image, quality: float, border: int) -> Peaks:
    """Find the positive maxima over 3x3 neighbourhoods, each at the vertex of the paraboloid through its nine values.

    Of equal neighbours, which symmetric corners have, the first in reading order is the peak.

    Parameters
    ----------
    response : (H, W) float32
    quality : share of the highest value that a peak must exceed, 0 to 1: what is lower is noise
    border : rows and columns at the edges that hold no peaks, >= 1

    Returns
    -------
    Peaks in reading order; none when the map is not larger than its borders.

    Raises
    ------
    ShapeError
        If `response` is not such a map, or `quality` or `border` lies outside its range.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[:9, :9]
    >>> peaks = find_peaks((50 - (x - 4.25) ** 2 - (y - 3.5) ** 2).astype(np.float32), 0.1, 1)
    >>> peaks.xy.round(3).tolist()
    [[4.25, 3.5]]
    """
    quality = as_number(quality, "quality")
    border = as_integer(border, "border")
    response = as_image(response, "response", dtypes=(np.float32,))
    if not 0 <= quality <= 1 or border < 1:
        raise ShapeError(f"quality, border: {quality}, {border}; need 0 to 1, and at least 1")
    if min(response.shape) <= 2 * border:
        return Peaks(np.zeros((0, 2)), np.zeros(0))
    peak = (response >= cv2.dilate(response, _SQUARE)) & (response > max(quality * float(response.max()), 0.0))
    peak[:border] = peak[-border:] = peak[:, :border] = peak[:, -border:] = False
    rows, columns = np.nonzero(peak)
    first = np.ones(len(rows), bool)
    for dy, dx in _BEFORE:
        first &= response[rows, columns] > response[rows + dy, columns + dx]
    rows, columns = rows[first], columns[first]
    xy = np.column_stack((columns, rows)).astype(np.float64)
    return Peaks(xy + _parabola_offset(response, rows, columns), response[rows, columns].astype(np.float64))


def _parabola_offset(response: Image, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Points:
    """Return the maximum of the paraboloid through each 3x3 neighbourhood, (N, 2) x y; 0 where it has none nearby."""
    highest = float(response.max())
    unit = highest if highest > 0 else 1.0

    def at(dy: int, dx: int) -> Floats:
        # In units of the highest value, products of differences neither overflow nor vanish.
        return np.asarray(response[rows + dy, columns + dx] / np.float64(unit), np.float64)

    gx, gy = (at(0, 1) - at(0, -1)) / 2, (at(1, 0) - at(-1, 0)) / 2
    xx, yy = at(0, 1) - 2 * at(0, 0) + at(0, -1), at(1, 0) - 2 * at(0, 0) + at(-1, 0)
    xy = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4
    determinant = xx * yy - xy * xy
    regular = determinant > 1e-12 * (xx * xx + yy * yy)
    safe = np.where(regular, determinant, 1.0)
    offset = np.column_stack(((xy * gy - yy * gx) / safe, (xy * gx - xx * gy) / safe))
    inside = regular & (np.abs(offset) <= _MAX_OFFSET_PX).all(axis=1)
    return np.where(inside[:, None], offset, 0.0)
