# SPDX-License-Identifier: Apache-2.0
"""Squares of an image one above the other: where only they matter, only they are developed and sampled.

Apart from `patch_bank` because images are cut without alignment, too (`image/`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import IMAGE_DTYPES, Image, Indices, as_image, as_points

#: Longest side of an image: `cv2.remap` takes 16-bit coordinates.
LONGEST_PX = 32000
#: Larger numbers are no coordinates in an image.
_LARGEST_ORIGIN = 1e6


class PatchAtlas:
    """Layout of squares of an image one above the other: where only they matter, only they are developed.

    Parameters
    ----------
    origins : (N, 2) px of the image, whole: the squares' top-left pixels
    side : px of a square, at least 4

    Attributes
    ----------
    origins, side : as given
    shift : (N, 2) px, float32: to be added to coordinates in the image near a square, for those in the atlas;
        coordinates outside their square are those of another square, or outside the atlas

    Raises
    ------
    ShapeError
        If there is no square, an origin is negative or no whole number, the side is smaller than 4, or the atlas would
        be taller than OpenCV's maps allow.

    Examples
    --------
    >>> atlas = PatchAtlas([[2, 0], [6, 2]], 4)
    >>> atlas.cut(np.arange(80, dtype=np.uint8).reshape(8, 10))[4].tolist()
    [26, 27, 28, 29]
    >>> ([7, 3] + atlas.shift[1]).tolist()
    [1.0, 5.0]
    """

    def __init__(self, origins: ArrayLike, side: int) -> None:
        side = as_integer(side, "side")
        corners = as_points(origins, "origins", 1)
        lowest, highest = float(corners.min()), float(corners.max())
        if side < 4 or lowest < 0 or highest > _LARGEST_ORIGIN or (corners != np.rint(corners)).any():
            raise ShapeError(f"origins, side: {lowest:g} to {highest:g}, {side}; need whole px >= 0, at least 4")
        if len(corners) * side > LONGEST_PX:
            raise ShapeError(f"origins, side: {len(corners)} squares of {side} px; need at most {LONGEST_PX} px in all")
        self._set(corners.astype(np.intp), side)

    @classmethod
    def unchecked(cls, origins: Indices, side: int) -> PatchAtlas:
        """Return the same for integer origins and a side that need no checks."""
        atlas = cls.__new__(cls)
        atlas._set(origins, side)
        return atlas

    def _set(self, origins: Indices, side: int) -> None:
        self.origins = origins
        self.side = side
        self._right, self._bottom = (origins.max(axis=0) + side).tolist()
        self.shift: NDArray[np.float32] = -origins.astype(np.float32)
        self.shift[:, 1] += np.arange(0, len(origins) * side, side, dtype=np.float32)

    def cut(self, image: Image) -> Image:
        """Return the squares of an image (H, W) as one image, (N * side, side).

        Raises
        ------
        ShapeError
            If it is no image, a square reaches beyond it, or values in a square are not finite.
        """
        if type(image) is not np.ndarray or image.dtype.type not in IMAGE_DTYPES:
            image = as_image(image, "image")
        if image.ndim != 2 or image.shape[0] < self._bottom or image.shape[1] < self._right:
            raise ShapeError(f"image: shape {image.shape}; need (H, W) that holds every square")
        height, width = image.shape
        # A view of the square at every pixel; sliding_window_view takes longer than the copy.
        image = np.ascontiguousarray(image)
        squares: Image = np.ndarray(
            (height - self.side + 1, width - self.side + 1, self.side, self.side),
            image.dtype,
            image,
            strides=image.strides * 2,
        )
        cut: Image = squares[self.origins[:, 1], self.origins[:, 0]]
        if cut.dtype.kind == "f" and not np.isfinite(cut).all():
            raise ShapeError("image: values that are not finite; need finite ones")
        return cut.reshape(-1, self.side)
