# SPDX-License-Identifier: Apache-2.0
"""The inner corners of a chessboard in a picture (OpenCV), and where they are on the board (IU 1.1.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_flag, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Points, as_image
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: The board is looked for in a picture of at most this size: enough to tell squares apart, and quick.
_LONGEST_SIDE = 960
#: Inner corners along a side that OpenCV's detector needs.
FEWEST_CORNERS = 3
#: Boards with more corners along a side do not exist; the detector's time grows with their number.
_MOST_CORNERS = 100
#: Half a corner's window, as a share of the distance to the next corner: no other corner may be in it.
_WINDOW_SHARE = 0.35
#: Limits of that half window, px: 5 px across are the fewest for a corner's gradients; above 23, time grows.
_SMALLEST_WINDOW, _LARGEST_WINDOW = 2, 11
#: 60 iterations, or a step of 0.0001 px: far below the noise of a corner.
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)


@dataclass(frozen=True, slots=True)
class Chessboard:
    """A chessboard: number of inner corners along its rows and columns, and the side of a square in metres."""

    columns: int
    rows: int
    square_m: float

    def __post_init__(self) -> None:
        """Check the board.

        Raises
        ------
        ShapeError
            If it has fewer than 3 or more than 100 inner corners a side, or the squares have no size.
        """
        if not all(FEWEST_CORNERS <= n <= _MOST_CORNERS for n in (self.columns, self.rows)):
            raise ShapeError(
                f"board: {self.columns} x {self.rows} inner corners; need {FEWEST_CORNERS} to {_MOST_CORNERS} a side"
            )
        if not 0 < self.square_m < math.inf:
            raise ShapeError(f"square: {self.square_m} m; need a positive length")

    def corners(self) -> Points:
        """Return the inner corners on the board, (rows * columns, 2) m: row by row, the first at (0, 0)."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return np.column_stack((x.ravel(), y.ravel())).astype(np.float64) * self.square_m


def find_chessboard(grey: Image, board: Chessboard, *, quick: bool = True, thorough: bool = True) -> Points | None:
    """Find all inner corners of a board.

    OpenCV's two detectors find the board in a reduced picture; the corners are then refined in the full one by the
    gradients around them (Foerstner & Guelch 1987), in a window that holds no other corner.

    Parameters
    ----------
    grey : (H, W) uint8
    board : what to look for
    quick : try the quick detector first; in OpenCV 4 it takes seconds to say no to a board of another size
    thorough : try the slower, sector-based detector (Duda & Frese 2018) when nothing was found so far

    Returns
    -------
    (rows * columns, 2) px, in the order of `Chessboard.corners` (or turned by half a turn, which for a calibration is
    the same); None when the board is not to be seen as a whole

    Raises
    ------
    ShapeError
        If `grey` is not such an image.
    """
    quick = as_flag(quick, "quick")
    thorough = as_flag(thorough, "thorough")
    require_type(board, Chessboard, "board")
    grey = as_image(grey, "grey", dtypes=(np.uint8,))
    size = (board.columns, board.rows)
    longest = max(grey.shape)
    scale = min(1.0, _LONGEST_SIDE / longest)
    small = grey
    if scale < 1:
        shape = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
        small = cv2.resize(grey, shape, interpolation=cv2.INTER_AREA)
    if min(small.shape) < 3 * min(size):
        return None
    found = _quick(small, size) if quick else None
    if found is None and thorough:
        found = _thorough(small, size)
    if found is None:
        return None
    factor = np.array([grey.shape[1] / small.shape[1], grey.shape[0] / small.shape[0]])
    corners = _refined(grey, PixelScaling(factor).to_full_unchecked(found), board)
    inside = (corners >= 0).all() and (corners <= np.array(grey.shape[::-1]) - 1).all()
    return corners if inside else None


def _quick(grey: Image, size: tuple[int, int]) -> Points | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    try:
        done, corners = cv2.findChessboardCorners(grey, size, flags=flags)
    except cv2.error:
        return None  # some pictures trip its own assertions; the other detector may do
    return _points(done, corners, size)


def _thorough(grey: Image, size: tuple[int, int]) -> Points | None:
    try:
        done, corners = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    except cv2.error:
        return None
    return _points(done, corners, size)


def _points(done: bool, corners: ArrayLike | None, size: tuple[int, int]) -> Points | None:
    points = np.asarray(corners if done and corners is not None else (), np.float64)
    if points.size != 2 * size[0] * size[1] or not np.isfinite(points).all():
        return None
    return points.reshape(-1, 2)


def _refined(grey: Image, corners: Points, board: Chessboard) -> Points:
    grid = corners.reshape(board.rows, board.columns, 2)
    spacing = min(
        float(np.linalg.norm(np.diff(grid, axis=0), axis=2).min()),
        float(np.linalg.norm(np.diff(grid, axis=1), axis=2).min()),
    )
    half = int(np.clip(round(_WINDOW_SHARE * spacing), _SMALLEST_WINDOW, _LARGEST_WINDOW))
    start = np.ascontiguousarray(corners[:, None], np.float32)
    refined = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), _CRITERIA)
    return np.asarray(refined, np.float64).reshape(-1, 2)
