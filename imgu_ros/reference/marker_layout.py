# SPDX-License-Identifier: Apache-2.0
"""What is printed on a plane with markers: where each lies, the squares between them, and the exact picture of it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imgu_ros.image.raw_samples import Singles
from imgu_ros.reference.marker_code import MARGIN, MarkerCode
from imgu_ros.types import Floats, Mask, Points
from imgu_ros.vision.markers.dictionaries import is_turned, marker_cells

#: Side of a cell in the template of a marker, px, and of the smallest cell in that of a board.
CELL_PX = 24
#: Pixels of a board's template and of a level in linear light: many small cells are drawn coarser, so that neither
#: takes more than some tens of MB.
_MOST_PX, _MOST_LIGHT_PX = 2e6, 8e6
#: Longest side of them, px: OpenCV samples images of at most 32767 px.
_LONGEST_PX, _LONGEST_LIGHT_PX = 8000, 32000
#: Px of a level in linear light in one px of the template: the finest has four px in one of a frame of which a marker
#: fills 200 px.
_LIGHT_SCALES = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)
#: Positions are rounded to this, px: edges of cells that are on those of pixels stay there.
_ROUNDED_PX = 1e-9


@dataclass(frozen=True, slots=True)
class PlacedMarker:
    """A marker on a plane.

    Attributes
    ----------
    family, number : which marker
    size : of the black square
    x, y : of its centre, x right, y up
    quarter_turns : by how many right angles it is turned, counterclockwise
    """

    family: str
    number: int
    size: float
    x: float = 0.0
    y: float = 0.0
    quarter_turns: int = 0

    @property
    def cells(self) -> Mask:
        """Which cells are white, (N, N), as it is turned."""
        return np.rot90(marker_cells(self.family, self.number), self.quarter_turns)

    def __str__(self) -> str:
        return f"{self.family}:{self.number}"


@dataclass(frozen=True, slots=True)
class PlacedSquares:
    """A chessboard on a plane.

    Attributes
    ----------
    columns, rows : number of squares
    side : of a square
    first_is_black : the square at the top left
    x, y : of the centre, x right, y up
    """

    columns: int
    rows: int
    side: float
    first_is_black: bool
    x: float = 0.0
    y: float = 0.0

    @property
    def white(self) -> Mask:
        """Which squares are white, (rows, columns)."""
        return np.asarray(np.indices((self.rows, self.columns)).sum(axis=0) % 2 == int(self.first_is_black))


@dataclass(frozen=True, slots=True, eq=False)
class CellBlock:
    """Square cells on a plane.

    Attributes
    ----------
    left, top : of the upper left corner, y up
    side : of a cell
    white : (R, C) which cells are white
    is_framed : whether what lies about them is known to be white
    """

    left: float
    top: float
    side: float
    white: Mask
    is_framed: bool

    def moved(self, left: float, top: float, scale: float) -> CellBlock:
        """Return the block with another origin, at its upper left, and in other units."""
        return replace(self, left=(self.left - left) * scale, top=(self.top - top) * scale, side=self.side * scale)

    @property
    def right(self) -> float:
        """The right edge."""
        return float(self.left + self.side * self.white.shape[1])

    @property
    def bottom(self) -> float:
        """The lower edge, y up."""
        return float(self.top - self.side * self.white.shape[0])


@dataclass(frozen=True, slots=True)
class MarkerLayout:
    """Markers on one plane, on white; lengths in m, or in the marker's size where that is not known.

    Attributes
    ----------
    markers : at least one, except on a chessboard
    squares : of a chessboard, in whose white squares they are; None: there is none
    """

    markers: tuple[PlacedMarker, ...]
    squares: PlacedSquares | None = None

    @property
    def blocks(self) -> list[CellBlock]:
        """What is drawn, in this order."""
        blocks = []
        if self.squares is not None:
            s = self.squares
            left, top = s.x - s.side * s.columns / 2, s.y + s.side * s.rows / 2
            blocks.append(CellBlock(left, top, s.side, s.white, is_framed=not self.markers))
        for marker in self.markers:
            cells, half = marker.cells, marker.size / 2
            side = marker.size / len(cells)
            blocks.append(CellBlock(marker.x - half, marker.y + half, side, cells, is_framed=True))
        return blocks

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of what is black, y up."""
        blocks = self.blocks
        return (
            min(block.left for block in blocks),
            max(block.top for block in blocks),
            max(block.right for block in blocks),
            min(block.bottom for block in blocks),
        )

    @property
    def width(self) -> float:
        """Outer edge to outer edge of what is black."""
        left, _, right, _ = self.box
        return float(right - left)

    @property
    def margin(self) -> float:
        """Width of the white that must be about it."""
        if self.squares is not None:
            return 0.0 if self.markers else self.squares.side / 2
        return float(MARGIN * min(block.side for block in self.blocks))


class PlaneTemplate(ABC):
    """The template of what lies on a plane: its exact picture at any scale, and what of it is compared with frames.

    Parameters
    ----------
    box : left, top, right and bottom of what is black, y up
    margin : width of the white that must be about it
    cell : side of its smallest detail

    Attributes
    ----------
    size : width and height, px
    outline : left, top, right and bottom of what is black, px
    origin : x and y of the plane's origin, px
    cell_px : side of the smallest detail, px
    """

    #: The codes of markers, where they are in the template.
    codes: Sequence[MarkerCode] = ()

    def __init__(self, box: tuple[float, float, float, float], margin: float, cell: float) -> None:
        left, top, right, bottom = box
        width, height = right - left + 2 * margin, top - bottom + 2 * margin
        self._scale = min(CELL_PX / cell, math.sqrt(_MOST_PX / (width * height)), _LONGEST_PX / max(width, height))
        self.cell_px = self._scale * cell
        self._margin = math.ceil(self._scale * margin - _ROUNDED_PX)
        self._left, self._top = left, top
        low = self._margin - 0.5
        x, y = self.px(np.array((right, 0.0)), np.array((bottom, 0.0))).T
        self.outline = low, low, float(x[0]), float(y[0])
        self.origin = float(x[1]), float(y[1])
        columns, rows = (math.ceil(end + 0.5 - _ROUNDED_PX) + self._margin for end in self.outline[2:])
        self.size = columns, rows

    def px(self, x: Floats, y: Floats) -> Points:
        """Return template px (N, 2) of places on the plane, y up."""
        at = np.column_stack((x - self._left, self._top - y)) * self._scale
        return np.asarray(np.round(at / _ROUNDED_PX) * _ROUNDED_PX + (self._margin - 0.5))

    @property
    def light_scales(self) -> list[float]:
        """Px of each level in linear light in one px of the template, fine to coarse."""
        width, height = self.size
        return [
            scale
            for scale in _LIGHT_SCALES
            if scale <= 1
            or (width * height * scale**2 <= _MOST_LIGHT_PX and max(width, height) * scale <= _LONGEST_LIGHT_PX)
        ]

    @abstractmethod
    def drawn(self, scale: float) -> Singles:
        """Return the picture, 0 to 1, `scale` px in one of the template: of each the share that is white, (H, W)."""

    @property
    @abstractmethod
    def corners(self) -> Points:
        """Where edges between black and white tell most, (N, 2) template px."""

    @property
    @abstractmethod
    def middles(self) -> Points:
        """Other places on edges between black and white, (N, 2) template px."""


class LayoutTemplate(PlaneTemplate):
    """The template of a layout of markers.

    Parameters
    ----------
    layout : of markers
    """

    def __init__(self, layout: MarkerLayout) -> None:
        self._layout, self._blocks = layout, layout.blocks
        super().__init__(layout.box, layout.margin, min(block.side for block in self._blocks))

    def drawn(self, scale: float) -> Singles:
        """See `PlaneTemplate.drawn`."""
        width, height = (math.ceil(side * scale) for side in self.size)
        picture = np.ones((height, width), np.float32)
        for block in self._blocks:
            rows, columns = block.white.shape
            (left, top), (right, bottom) = (
                (self.px(np.array((block.left, block.right)), np.array((block.top, block.bottom))) + 0.5) * scale
            ).tolist()
            x, across = _coverage(np.linspace(left, right, columns + 1))
            y, down = _coverage(np.linspace(top, bottom, rows + 1))
            black = (~block.white).astype(np.float32)
            # Of a marker in a white square only its black is drawn.
            picture[y : y + down.shape[1], x : x + across.shape[1]] -= down.T @ black @ across
        return np.clip(picture, 0, 1, out=picture)

    @cached_property
    def codes(self) -> tuple[MarkerCode, ...]:  # type: ignore[override]
        """The codes of the markers, where they are in the template."""
        codes = []
        for marker in self._layout.markers:
            count = len(marker.cells)
            ((x, y),) = self.px(np.array([marker.x]), np.array([marker.y]))
            side = marker.size * self._scale / count
            c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[marker.quarter_turns % 4]
            turned = side * np.array([[c, s], [-s, c]])
            place = np.eye(3)
            place[:2, :2], place[:2, 2] = turned, (x, y) - turned @ (count / 2, count / 2)
            codes.append(MarkerCode(marker.family, marker.number, place))
        return tuple(codes)

    @cached_property
    def corners(self) -> Points:
        """Where edges between black and white turn or cross, (N, 2) template px."""
        return self._places(_corners_of)

    @cached_property
    def middles(self) -> Points:
        """The middles of the edges of cells that are between black and white, (N, 2) template px."""
        return self._places(_middles_of)

    def _places(self, places_of: Callable[[Mask], Points]) -> Points:
        found = []
        for block in self._blocks:
            rim = int(block.is_framed)
            at = places_of(np.pad(block.white, rim, constant_values=True)) - rim
            found.append(self.px(block.left + block.side * at[:, 0], block.top - block.side * at[:, 1]))
        return np.vstack(found)


def _coverage(edges: Floats) -> tuple[int, Singles]:
    """Return the first pixel that cells with these edges cover, and by how much each covers each pixel, (N, P)."""
    first, last = math.floor(edges[0] + _ROUNDED_PX), math.ceil(edges[-1] - _ROUNDED_PX)
    inside = np.clip(edges[:, None], np.arange(first, last), np.arange(first + 1, last + 1))
    return first, np.diff(inside, axis=0).astype(np.float32)


def _corners_of(white: Mask) -> Points:
    """Return where edges between cells turn or cross, (N, 2) in cells, not at the border."""
    across, down = white[:, 1:] ^ white[:, :-1], white[1:] ^ white[:-1]
    # About each corner of four cells: the edges above and below it, left and right of it.
    turns = (across[:-1] | across[1:]) & (down[:, :-1] | down[:, 1:])
    row, column = np.nonzero(turns)
    return np.column_stack((column + 1.0, row + 1.0))


def _middles_of(white: Mask) -> Points:
    """Return the middles of the edges between cells, (N, 2) in cells, not at the border."""
    row, column = np.nonzero(white[:, 1:] ^ white[:, :-1])
    upright = np.column_stack((column + 1.0, row + 0.5))
    row, column = np.nonzero(white[1:] ^ white[:-1])
    return np.vstack((upright, np.column_stack((column + 0.5, row + 1.0))))


def spread_out(xy: Points, most: int) -> tuple[Points, Floats]:
    """Return up to `most` points in the order in which each is farthest from those before it, and that distance."""
    order, apart = [0], [np.inf]
    distance = np.hypot(*(xy - xy[0]).T)
    while len(order) < min(len(xy), most):
        farthest = int(np.argmax(distance))
        order.append(farthest)
        apart.append(float(distance[farthest]))
        distance = np.minimum(distance, np.hypot(*(xy - xy[farthest]).T))
    return xy[order], np.array(apart)


def grid_layout(family: str, rows: int, columns: int, size: float, gap: float, numbers: Sequence[int]) -> MarkerLayout:
    """Return markers in rows, numbered row by row from the top left, about the origin."""
    step = size + gap
    return MarkerLayout(
        tuple(
            PlacedMarker(
                family,
                number,
                size,
                step * (index % columns - (columns - 1) / 2),
                step * ((rows - 1) / 2 - index // columns),
            )
            for index, number in enumerate(numbers)
        )
    )


def charuco_layout(
    family: str, columns: int, rows: int, square: float, size: float, numbers: Sequence[int], is_legacy: bool
) -> MarkerLayout:
    """Return a chessboard with markers in its white squares, numbered row by row from the top left, about the origin.

    As OpenCV's CharucoBoard has them: the top left square is black; in its legacy pattern it is white where the number
    of rows is even. OpenCV draws AprilTag's families half a turn from upright.
    """
    turns = 2 if is_turned(family) else 0
    squares = PlacedSquares(columns, rows, square, first_is_black=not (is_legacy and rows % 2 == 0))
    row, column = np.nonzero(squares.white)
    return MarkerLayout(
        tuple(
            PlacedMarker(family, number, size, square * (x - (columns - 1) / 2), square * ((rows - 1) / 2 - y), turns)
            for number, x, y in zip(numbers, column.tolist(), row.tolist(), strict=True)
        ),
        squares,
    )
