# SPDX-License-Identifier: Apache-2.0
"""The quarter planes of a Bayer mosaic: one field for each site of the quad (red, green, green, blue).

Sites of one colour lie two pixels apart, so every demosaicking formula becomes sums of a few whole fields, shifted by
quads: no masks, no strides, and a quarter of the work of filtering the full picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

#: The values of a field in reading order, one for each quad.
Values = NDArray[Any]


class Field:
    """One value for each quad of a strip.

    A shifted view ignores the ends of rows: it runs on into the neighbouring row, so the outermost quads of a strip
    become meaningless as operations follow one another. Strips overlap by as many (a recipe's `reach`).
    """

    __slots__ = ("_all", "_guard", "_size", "_width")

    def __init__(self, height: int, width: int, shift: int, dtype: np.dtype[Any]) -> None:
        self._width, self._guard, self._size = width, shift * (width + 1), height * width
        self._all = np.empty(self._size + 2 * self._guard, dtype)
        # What lies beyond the first and the last row is read, though never used: it must be a number.
        self._all[: self._guard] = 0
        self._all[self._guard + self._size :] = 0

    def at(self, down: int = 0, right: int = 0) -> Values:
        """Return, for every quad, the value of the quad so many further down and to the right: a view."""
        start = self._guard + down * self._width + right
        return self._all[start : start + self._size]

    def take(self, values: Values, where: Values) -> None:
        """Overwrite by `values` where the condition, 0 or 255, holds."""
        # np.copyto(where=...) takes thirty times as long.
        cv2.copyTo(values, where, self.at())

    def inside(self, rim: int) -> Values:
        """Return the field as a picture without its `rim` outermost quads: a view."""
        return self.at().reshape(-1, self._width)[rim:-rim, rim:-rim]


@dataclass(frozen=True, slots=True, eq=False)
class Quads:
    """What a strip measured: red and green in a quad's upper row, green and blue in its lower row.

    Attributes
    ----------
    red, green_by_red, green_by_blue, blue : the mosaic's values
    height, width : of the strip, quads
    shift : largest shift of a view, quads
    dtype : of all fields
    top : largest value of the mosaic's data type
    """

    red: Field
    green_by_red: Field
    green_by_blue: Field
    blue: Field
    height: int
    width: int
    shift: int
    dtype: np.dtype[Any]
    top: float

    def new(self) -> Field:
        """Return a field of this geometry whose values are still to be written."""
        return Field(self.height, self.width, self.shift, self.dtype)

    def keep(self, values: Values) -> Field:
        """Return a field that holds these values."""
        out = self.new()
        np.copyto(out.at(), values)
        return out

    def sum(self, first: Values, second: Values) -> Field:
        """Return a field of sums."""
        out = self.new()
        np.add(first, second, out=out.at())
        return out

    def difference(self, first: Values, second: Values) -> Field:
        """Return a field of differences."""
        out = self.new()
        np.subtract(first, second, out=out.at())
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Missing:
    """What a method finds: the two colours that each site of the quad did not measure, times the recipe's `scale`."""

    green_at_red: Field
    blue_at_red: Field
    red_by_red: Field
    blue_by_red: Field
    red_by_blue: Field
    blue_by_blue: Field
    red_at_blue: Field
    green_at_blue: Field
