# SPDX-License-Identifier: Apache-2.0
"""The sensor's pixels: size, aspect ratio, pitch, and the focal length in pixels (IU 1.1.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError

_FULL_FRAME_DIAGONAL_M = math.hypot(0.036, 0.024)


@dataclass(frozen=True, slots=True)
class PixelArray:
    """A rectangle of square pixels.

    Attributes
    ----------
    width, height : pixels; >= 1
    pitch_m : from one pixel's centre to the next's; > 0

    Examples
    --------
    A 1/2.3-inch sensor of 4000 x 3000 pixels behind a lens of 4.5 mm:

    >>> array = PixelArray(4000, 3000, 1.55e-6)
    >>> array.aspect, round(array.width_m * 1e3, 2), round(array.crop_factor, 2), round(array.focal_px(4.5e-3))
    ((4, 3), 6.2, 5.58, 2903)
    """

    width: int
    height: int
    pitch_m: float

    def __post_init__(self) -> None:
        """Raise ShapeError when a value is out of range."""
        if not all(1 <= as_integer(getattr(self, side), side) <= 1 << 31 for side in ("width", "height")):
            raise ShapeError(f"size: {self.width} x {self.height} px; need at least 1 x 1")
        if not 1e-12 <= as_number(self.pitch_m, "pitch_m") <= 1:
            raise ShapeError(f"pitch_m: {self.pitch_m:g}; need more than 0 m (1e-12 to 1)")

    @property
    def width_m(self) -> float:
        """Width from outer edge to outer edge."""
        return self.width * self.pitch_m

    @property
    def height_m(self) -> float:
        """Height from outer edge to outer edge."""
        return self.height * self.pitch_m

    @property
    def diagonal_m(self) -> float:
        """Distance of opposite corners."""
        return math.hypot(self.width_m, self.height_m)

    @property
    def aspect(self) -> tuple[int, int]:
        """Width to height in lowest terms: (16, 9), (4, 3)."""
        common = math.gcd(self.width, self.height)
        return self.width // common, self.height // common

    @property
    def crop_factor(self) -> float:
        """Diagonal of 35 mm film (36 x 24 mm) over this one's."""
        return _FULL_FRAME_DIAGONAL_M / self.diagonal_m

    def focal_px(self, image_distance_m: float) -> float:
        """Return the focal length in pixels, as in K: the image distance over the pitch.

        Raises
        ------
        ShapeError
            If the distance is not positive.
        """
        image_distance_m = as_number(image_distance_m, "image_distance_m")
        if not 0 < image_distance_m < math.inf:
            raise ShapeError(f"image_distance_m: {image_distance_m:g}; need more than 0 m")
        return image_distance_m / self.pitch_m
