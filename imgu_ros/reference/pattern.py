# SPDX-License-Identifier: Apache-2.0
"""Chessboards and grids of dots: references whose picture is known exactly, and which look like themselves, turned."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ReferenceParameters
from imgu_ros.reference.dot_layout import DotLayout
from imgu_ros.reference.marker import BoardImage, MarkerReference, drawn_image, made_reference
from imgu_ros.reference.marker_layout import MarkerLayout
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.self_similarity import Copy
from imgu_ros.types import Image, Points
from imgu_ros.vision.camera.chessboard import Chessboard, find_chessboard
from imgu_ros.vision.camera.dot_grid import find_dots


class PatternImage(BoardImage):
    """The picture of a chessboard or a grid of dots."""

    __slots__ = ()
    kind: ClassVar[str] = "pattern"


def pattern_image(name: str, layout: MarkerLayout | DotLayout, width_m: float = 0.0) -> PatternImage:
    """Return the picture of a chessboard, a layout without markers, or of a grid of dots.

    Parameters
    ----------
    name : in topics, files and frames
    layout : of it, m
    width_m : outer edge to outer edge of what is black, to which it is scaled; 0: as the layout has it
    """
    return drawn_image(PatternImage, name, layout, width_m or layout.width)


class PatternReference(MarkerReference):
    """A chessboard or a grid of dots; see `MarkerReference`."""

    kind = "pattern"

    def prepare(self, linear: bool) -> None:
        """See `Reference.prepare`."""
        self.copies(linear)

    def copies(self, linear: bool) -> tuple[Copy, ...]:
        """See `Reference.copies`."""
        return Reference.copies(self, linear)

    def has_template_of(self, other: Reference) -> bool:
        """See `Reference.has_template_of`: the width does not matter."""
        return isinstance(other, PatternReference) and self.image.layout == other.image.layout

    @property
    def has_dots(self) -> bool:
        """Whether it is a grid of dots."""
        return isinstance(self.image.layout, DotLayout)

    @property
    def _is_shifted(self) -> bool:
        return isinstance(self.image.layout, DotLayout) and self.image.layout.is_shifted

    @cached_property
    def grid(self) -> tuple[Points, int]:
        """Points that OpenCV's detectors find, (N, 2) template px, row by row, and how many there are in a row."""
        layout = self.image.layout
        if isinstance(layout, DotLayout):
            return self.image.template.px(*layout.grid.T), layout.columns
        squares = layout.squares
        assert squares is not None
        columns, rows = squares.columns - 1, squares.rows - 1
        row, column = np.divmod(np.arange(rows * columns), columns)
        x = squares.x + squares.side * (column - (columns - 1) / 2)
        y = squares.y + squares.side * ((rows - 1) / 2 - row)
        return self.image.template.px(x, y), columns

    def found_in(self, grey: Image) -> Points | None:
        """Return where the points of `grid` are in an image, as of a turned grid, (N, 2) px; None: nowhere."""
        layout, (points, columns) = self.image.layout, self.grid
        rows = len(points) // columns
        if isinstance(layout, DotLayout):
            return find_dots(grey, columns, rows, layout.is_shifted)
        # In OpenCV 4 the quick detector takes seconds where there is none.
        return find_chessboard(grey, Chessboard(columns, rows, 1.0), quick=False)

    def turned(self, seen: Points) -> Sequence[Points]:
        """Return the orders in which points of `grid` may have been seen, (N, 2), of a grid seen from its front."""
        points, columns = self.grid
        grid = seen.reshape(-1, columns, 2)
        orders = [grid, grid[::-1, ::-1], grid[::-1], grid[:, ::-1]]
        if len(grid) == columns and not self._is_shifted:
            orders += [np.swapaxes(each, 0, 1) for each in orders]
        known = points.reshape(grid.shape)
        return [np.ascontiguousarray(each.reshape(-1, 2)) for each in orders if _turn(each) * _turn(known) > 0]


def _turn(grid: Points) -> float:
    """Return twice the area of a grid's outline (R, C, 2), signed."""
    a, b = grid[-1, -1] - grid[0, 0], grid[-1, 0] - grid[0, -1]
    return float(a[0] * b[1] - a[1] * b[0])


def pattern_reference(
    image: PatternImage, number: int, parameters: ReferenceParameters, cache: BuildCache
) -> PatternReference:
    """Return the reference of a chessboard or a grid of dots; see `marker_reference`."""
    return made_reference(PatternReference, image, number, parameters, cache)
