# SPDX-License-Identifier: Apache-2.0
"""The dots of a calibration board in a picture, by OpenCV's `findCirclesGrid`."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from imgu_ros.arguments import as_flag, as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Points, as_image

#: Fewest and most points along a side.
_FEWEST, _MOST = 3, 100
#: Smallest and largest area of a dot, px; edges that are nearer than this are those of one dot.
_SMALLEST_PX2, _LARGEST_PX2, _APART_PX = 12.0, 20_000.0, 3.0
#: Thresholds at which dots are sought, and how convex they are at least.
_THRESHOLDS, _CONVEX = (10.0, 240.0, 10.0), 0.8


def find_dots(grey: Image, columns: int, rows: int, is_shifted: bool = False) -> Points | None:
    """Return the centres of dark dots on a grid that is wholly in view, row by row; None: there is none.

    Which dot is the first one, and whether rows run to the right, is not told.

    Parameters
    ----------
    grey : (H, W) uint8
    columns, rows : number of dots in a row, and of rows, 3 to 100
    is_shifted : every other row is shifted by half the distance of dots in a row

    Returns
    -------
    (rows * columns, 2) px

    Raises
    ------
    ShapeError
        If the image is no such array, or the numbers are none of these.
    """
    grey, size = as_image(grey, "grey", dtypes=(np.uint8,)), _size(columns, rows)
    is_shifted = as_flag(is_shifted, "is_shifted")
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if is_shifted else cv2.CALIB_CB_SYMMETRIC_GRID
    # A grid that is seen obliquely is found by its clusters, one among other dark spots without.
    for flags in (kind | cv2.CALIB_CB_CLUSTERING, kind):
        try:
            found, centres = cv2.findCirclesGrid(grey, size, flags=flags, blobDetector=_blob_detector())
        except cv2.error:
            continue  # some pictures trip its own assertions
        points = np.asarray(centres if found and centres is not None else (), np.float64)
        if points.size == 2 * size[0] * size[1] and np.isfinite(points).all():
            return points.reshape(-1, 2)
    return None


def _size(columns: int, rows: int) -> tuple[int, int]:
    size = as_integer(columns, "columns"), as_integer(rows, "rows")
    if not all(_FEWEST <= side <= _MOST for side in size):
        raise ShapeError(f"columns, rows: {size[0]}, {size[1]}; need {_FEWEST} to {_MOST}")
    return size


def _blob_detector() -> Any:
    opencv: Any = cv2
    p = opencv.SimpleBlobDetector_Params()
    p.minThreshold, p.maxThreshold, p.thresholdStep = _THRESHOLDS
    p.minArea, p.maxArea, p.minDistBetweenBlobs = _SMALLEST_PX2, _LARGEST_PX2, _APART_PX
    p.filterByColor, p.blobColor = True, 0
    p.filterByConvexity, p.minConvexity = True, _CONVEX
    # Dots that are seen obliquely are ellipses.
    p.filterByInertia = p.filterByCircularity = False
    return opencv.SimpleBlobDetector_create(p)
