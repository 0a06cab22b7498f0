"""Squares of a picture side by side on one sheet: where only they matter, only they are worked on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_points

#: The outermost ring of a square is not sampled: what interpolates a mosaic there looks at the next square.
_RING_PX = 1


class Sheet:
    """How squares of a picture lie on a sheet.

    Parameters
    ----------
    origins : (N, 2) px of the picture, whole: the squares' top-left pixels
    side : px of a square, at least 4

    Attributes
    ----------
    origins, side : as given

    Raises
    ------
    ShapeError
        If there is no square, an origin is negative or no whole number, or the side is smaller than 4.
    """

    def __init__(self, origins: ArrayLike, side: int) -> None:
        corners = as_points(origins, "origins", 1)
        if side < 4 or corners.min() < 0 or not np.array_equal(corners, np.rint(corners)) or corners.max() > 1e6:
            raise ShapeError(
                f"origins, side: {corners.min():g} to {corners.max():g}, {side}; need whole px >= 0, at least 4"
            )
        self.origins = corners.astype(np.intp)
        self.side = side
        self._columns = math.ceil(math.sqrt(len(corners)))
        self._rows = math.ceil(len(corners) / self._columns)
        row, column = np.divmod(np.arange(len(corners)), self._columns)
        shift = np.stack((column, row), axis=1) * side - self.origins
        self._shift = shift.astype(np.float32)
        # Coordinates on the picture between which a square is sampled.
        self._least = (self.origins + _RING_PX).astype(np.float32)
        self._most = (self.origins + (side - 1 - _RING_PX)).astype(np.float32)

    def cut(self, picture: Image) -> Image:
        """Return the sheet of a picture (H, W), which holds all squares; places that are left over repeat the last.

        Raises
        ------
        ShapeError
            If a square reaches beyond the picture.
        """
        if picture.ndim != 2 or (self.origins.max(axis=0) + self.side > picture.shape[::-1]).any():
            raise ShapeError(f"picture: shape {picture.shape}; need (H, W) that holds every square")
        taken = np.minimum(np.arange(self._rows * self._columns), len(self.origins) - 1)
        x, y = self.origins[taken].reshape(self._rows, 1, self._columns, 2).transpose(3, 0, 1, 2)
        lines = np.lib.stride_tricks.sliding_window_view(picture, self.side, axis=1)
        cut: Image = lines[y + np.arange(self.side)[None, :, None], x]
        return cut.reshape(self._rows * self.side, self._columns * self.side)

    def move(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> None:
        """Turn coordinates on the picture, (N, M) each, a row for each of the first squares, into those on the sheet.

        It is done in place. What lies outside its square is moved to its rim.
        """
        first = len(x)
        for axis, places in enumerate((x, y)):
            np.clip(places, self._least[:first, axis, None], self._most[:first, axis, None], out=places)
            places += self._shift[:first, axis, None]
