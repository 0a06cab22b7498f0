# SPDX-License-Identifier: Apache-2.0
"""A grid of dots on a plane: where each lies, and the exact picture of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imgu_ros.image.raw_samples import Singles
from imgu_ros.reference.marker_layout import PlacedMarker, PlaneTemplate
from imgu_ros.types import Points

#: A dot is drawn by so many samples of a pixel, along each side.
_SAMPLES = 4
#: Patches at the edge of a dot.
_AROUND = 4


@dataclass(frozen=True, slots=True)
class DotLayout:
    """Black dots on a grid on white, about the origin; lengths in m.

    Attributes
    ----------
    columns, rows : number of dots in a row, and of rows
    spacing : of rows, and of dots in a row; twice as much of these in a shifted grid
    diameter : of a dot
    is_shifted : every other row is shifted to the right by `spacing`, as in OpenCV's asymmetric grid
    """

    columns: int
    rows: int
    spacing: float
    diameter: float
    is_shifted: bool = False

    @property
    def markers(self) -> tuple[PlacedMarker, ...]:
        """None: see `MarkerLayout.markers`."""
        return ()

    @property
    def grid(self) -> Points:
        """Centres of the dots, row by row from the top left, (N, 2), y up."""
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        x = column * (2.0 if self.is_shifted else 1.0) + self.is_shifted * (row % 2)
        return self.spacing * np.column_stack((x - x.max() / 2, (self.rows - 1) / 2 - row))

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of what is black, y up."""
        (left, bottom), (right, top) = self.grid.min(axis=0), self.grid.max(axis=0)
        r = self.diameter / 2
        return float(left - r), float(top + r), float(right + r), float(bottom - r)

    @property
    def width(self) -> float:
        """Outer edge to outer edge of what is black."""
        left, _, right, _ = self.box
        return right - left

    @property
    def margin(self) -> float:
        """Width of the white that must be about it."""
        return self.spacing / 2


class DotTemplate(PlaneTemplate):
    """The template of a grid of dots.

    Parameters
    ----------
    layout : of the dots
    """

    def __init__(self, layout: DotLayout) -> None:
        super().__init__(layout.box, layout.margin, layout.diameter)
        self._centres = self.px(*layout.grid.T)
        self._radius = self.cell_px / 2

    def drawn(self, scale: float) -> Singles:
        """See `PlaneTemplate.drawn`."""
        width, height = (math.ceil(side * scale) for side in self.size)
        picture = np.ones((height, width), np.float32)
        offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        for x, y in (self._centres + 0.5) * scale:
            reach = self._radius * scale + 1
            left, top = max(math.floor(x - reach), 0), max(math.floor(y - reach), 0)
            right, bottom = min(math.ceil(x + reach), width), min(math.ceil(y + reach), height)
            across = (np.arange(left, right)[:, None] + offsets).ravel() - x
            down = (np.arange(top, bottom)[:, None] + offsets).ravel() - y
            # Of a sample the share that is inside, by the distance of its middle from the edge.
            away = np.hypot(across, down[:, None]) - self._radius * scale
            inside = np.clip(0.5 - away * _SAMPLES, 0, 1)
            shape = bottom - top, _SAMPLES, right - left, _SAMPLES
            picture[top:bottom, left:right] -= inside.reshape(shape).mean(axis=(1, 3)).astype(np.float32)
        return np.clip(picture, 0, 1, out=picture)

    @cached_property
    def corners(self) -> Points:
        """See `PlaneTemplate.corners`: at the edge of each dot."""
        return self._around(0.0)

    @cached_property
    def middles(self) -> Points:
        """See `PlaneTemplate.middles`: between these."""
        return self._around(math.pi / _AROUND)

    def _around(self, first: float) -> Points:
        angle = first + 2 * math.pi * np.arange(_AROUND) / _AROUND
        ring = self._radius * np.column_stack((np.cos(angle), np.sin(angle)))
        return np.asarray((self._centres[:, None] + ring).reshape(-1, 2), np.float64)
