# SPDX-License-Identifier: Apache-2.0
"""Squares of a picture one above the other on one sheet: where only they matter, only they are worked on."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import IMAGE_DTYPES, Image, as_image, as_points

#: OpenCV's maps hold 16-bit places.
TALLEST_PX = 32000
#: Larger numbers are no coordinates in a picture.
_FARTHEST = 1e6


class PatchAtlas:
    """How squares of a picture lie on a sheet.

    Parameters
    ----------
    origins : (N, 2) px of the picture, whole: the squares' top-left pixels
    side : px of a square, at least 4

    Attributes
    ----------
    origins, side : as given
    shift : (N, 2) px, float32: what to add to coordinates on the picture, near a square, to have those on the sheet;
        what lies outside its square comes to lie in another one, or outside

    Raises
    ------
    ShapeError
        If there is no square, an origin is negative or no whole number, the side is smaller than 4, or the sheet would
        be taller than OpenCV's maps allow.

    Examples
    --------
    >>> sheet = PatchAtlas([[2, 0], [6, 2]], 4)
    >>> sheet.cut(np.arange(80, dtype=np.uint8).reshape(8, 10))[4].tolist()
    [26, 27, 28, 29]
    >>> ([7, 3] + sheet.shift[1]).tolist()
    [1.0, 5.0]
    """

    def __init__(self, origins: ArrayLike, side: int) -> None:
        side = as_integer(side, "side")
        corners = as_points(origins, "origins", 1)
        lowest, highest = float(corners.min()), float(corners.max())
        if side < 4 or lowest < 0 or highest > _FARTHEST or (corners != np.rint(corners)).any():
            raise ShapeError(f"origins, side: {lowest:g} to {highest:g}, {side}; need whole px >= 0, at least 4")
        if len(corners) * side > TALLEST_PX:
            raise ShapeError(f"origins, side: {len(corners)} squares of {side} px; need at most {TALLEST_PX} px in all")
        self.origins = corners.astype(np.intp)
        self.side = side
        self._right, self._bottom = (self.origins.max(axis=0) + side).tolist()
        self.shift: NDArray[np.float32] = -corners.astype(np.float32)
        self.shift[:, 1] += np.arange(0, len(corners) * side, side, dtype=np.float32)

    def cut(self, picture: Image) -> Image:
        """Return the sheet of a picture (H, W), (N * side, side).

        Raises
        ------
        ShapeError
            If it is no picture, a square reaches beyond it, or what a square holds is not finite.
        """
        if type(picture) is not np.ndarray or picture.dtype.type not in IMAGE_DTYPES:
            picture = as_image(picture, "picture")
        if picture.ndim != 2 or picture.shape[0] < self._bottom or picture.shape[1] < self._right:
            raise ShapeError(f"picture: shape {picture.shape}; need (H, W) that holds every square")
        height, width = picture.shape
        # A view of the square at every pixel; numpy's own functions for it take longer than the cutting.
        picture = np.ascontiguousarray(picture)
        squares: Image = np.ndarray(
            (height - self.side + 1, width - self.side + 1, self.side, self.side),
            picture.dtype,
            picture,
            strides=picture.strides * 2,
        )
        cut: Image = squares[self.origins[:, 1], self.origins[:, 0]]
        if cut.dtype.kind == "f" and not np.isfinite(cut).all():
            raise ShapeError("picture: values that are not finite; need finite ones")
        return cut.reshape(-1, self.side)
