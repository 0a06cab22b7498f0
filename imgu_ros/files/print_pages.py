# SPDX-License-Identifier: Apache-2.0
"""PDF pages on which a target is printed at its exact size, with what is needed to check that the printer did.

Lengths are in mm; pages have their origin at the top left, y down.
"""

from __future__ import annotations

import io
import itertools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from imgu_ros.errors import ShapeError
from imgu_ros.files.plot_style import plot_style
from imgu_ros.reference.marker_layout import CellBlock
from imgu_ros.types import Image, Mask

#: Width and height, upright (ISO 216, ANSI Y14.1).
PAPERS_MM = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
#: Largest page of a PDF: 200 inches (ISO 32000-1, annex C).
MOST_MM = 5080.0
_MM_PER_INCH = 25.4
#: Who needs more has mistaken the unit.
_MOST_PAGES = 200
#: Most printers leave a border of 5 mm or less white.
_MARGIN_MM = 12.0
#: Below the picture: ruler and text.
_STRIP_MM = 24.0
_RULER_MM = 100.0  # the narrowest page has room for it
#: Cutting marks: this far from the corner, this long.
_MARK_GAP_MM, _MARK_MM = 2.0, 6.0
_FONT_PT = 7.0
#: A size beyond the page's by less is rounding, as of letter in mm.
_ROUNDING_MM = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class PrintJob:
    """What is printed.

    Attributes
    ----------
    pixels : (H, W) or (H, W, 3) RGB, uint8
    size_mm : width and height of the picture
    width_m : what is to be entered as the target's width
    words : lines of text for the margin
    width_name : what that width is called, for the words about the ruler
    cells : of markers: they are drawn as shapes, and `pixels` are not; mm from the upper left corner, y up
    """

    pixels: Image
    size_mm: tuple[float, float]
    width_m: float
    words: Sequence[str]
    width_name: str = "width_m"
    cells: Sequence[CellBlock] = ()


@dataclass(frozen=True, slots=True)
class Tile:
    """One page: its size, the part of the picture on it (x, y, width, height), and its place among the tiles."""

    page_mm: tuple[float, float]
    part_mm: tuple[float, float, float, float]
    column: int
    row: int
    columns: int
    rows: int


def tiles_of(size_mm: tuple[float, float], paper: str, overlap_mm: float) -> list[Tile]:
    """Return the pages that a picture needs, row by row.

    Parameters
    ----------
    size_mm : width and height of the picture
    paper : one of `PAPERS_MM`, upright or turned, whichever needs fewer pages; `fit`: one page as large as it takes;
        `auto`: the first of A4 and A3 that it fits, else A4 in tiles
    overlap_mm : of neighbouring tiles

    Raises
    ------
    ShapeError
        If a page would be too large for a PDF, there would be too many, or the overlap leaves nothing of a page.
    """
    width, height = size_mm
    if paper == "fit":
        page = max(width, _RULER_MM) + 2 * _MARGIN_MM, height + 2 * _MARGIN_MM + _STRIP_MM
        if max(page) > MOST_MM:
            raise ShapeError(
                f"page: {page[0]:.0f} x {page[1]:.0f} mm; need at most {MOST_MM:.0f} mm: print it in tiles"
            )
        return [Tile(page, (0.0, 0.0, width, height), 0, 0, 1, 1)]
    names = ("a4", "a3") if paper == "auto" else (paper,)
    pages = [turned for name in names for turned in (PAPERS_MM[name], PAPERS_MM[name][::-1])]
    for page in pages:
        room_x, room_y = _room(page)
        if width <= room_x + _ROUNDING_MM and height <= room_y + _ROUNDING_MM:
            return [Tile(page, (0.0, 0.0, width, height), 0, 0, 1, 1)]
    return min((_tiled(size_mm, page, overlap_mm) for page in pages[:2]), key=len)


def _room(page: tuple[float, float]) -> tuple[float, float]:
    return page[0] - 2 * _MARGIN_MM, page[1] - 2 * _MARGIN_MM - _STRIP_MM


def _tiled(size_mm: tuple[float, float], page: tuple[float, float], overlap_mm: float) -> list[Tile]:
    room = _room(page)
    if not 0 <= overlap_mm < min(room) / 2:
        raise ShapeError(f"overlap: {overlap_mm:g} mm; need 0 to {min(room) / 2:.0f} mm")
    columns, rows = (
        max(1, math.ceil((side - overlap_mm - _ROUNDING_MM) / (space - overlap_mm)))
        for side, space in zip(size_mm, room, strict=True)
    )
    if columns * rows > _MOST_PAGES:
        raise ShapeError(f"print: {columns * rows} pages; need at most {_MOST_PAGES}: take larger paper, or `fit`")
    tiles = []
    for row in range(rows):
        for column in range(columns):
            x, y = column * (room[0] - overlap_mm), row * (room[1] - overlap_mm)
            part = x, y, min(room[0], size_mm[0] - x), min(room[1], size_mm[1] - y)
            tiles.append(Tile(page, part, column, row, columns, rows))
    return tiles


def print_pages(jobs: Sequence[tuple[PrintJob, Sequence[Tile]]], overlap_mm: float) -> bytes:
    """Return a PDF of one page for each tile of each job; the same jobs give the same bytes.

    It asks viewers to print at 100 %. Pictures are embedded as they are, not resampled.
    """
    content = io.BytesIO()
    with plot_style({"pdf.fonttype": 42, "path.simplify": False}), PdfPages(content, metadata=_metadata()) as pages:
        for job, tiles in jobs:
            for figure in _figures(job, tiles, overlap_mm):
                pages.savefig(figure)
    return _printed_unscaled(content.getvalue())


def _metadata() -> dict[str, Any]:
    return {"CreationDate": None, "Creator": "imgu make", "Producer": f"matplotlib {mpl.__version__}"}


def _figures(job: PrintJob, tiles: Sequence[Tile], overlap_mm: float) -> Iterator[Figure]:
    for tile in tiles:
        width, height = tile.page_mm
        figure = Figure(figsize=(width / _MM_PER_INCH, height / _MM_PER_INCH), dpi=72)
        axes: Any = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        _draw_picture(axes, job, tile)
        _draw_marks(axes, job, tile, overlap_mm)
        _draw_ruler(axes, tile)
        _draw_words(axes, job, tile)
        axes.set_xlim(0, width)
        axes.set_ylim(height, 0)
        yield figure


def _origin(tile: Tile) -> tuple[float, float]:
    """Return where the picture's top left corner would be on the tile's page."""
    return _MARGIN_MM - tile.part_mm[0], _MARGIN_MM - tile.part_mm[1]


def _draw_picture(axes: Any, job: PrintJob, tile: Tile) -> None:
    (x, y), (width, height) = _origin(tile), job.size_mm
    if not job.cells:
        axes.imshow(
            job.pixels, cmap="gray", vmin=0, vmax=255, extent=(x, x + width, y + height, y), interpolation="none",
            aspect="auto",
        )  # fmt: skip
    for block in job.cells:
        _draw_cells(axes, block.white, (x + block.left, y - block.top), block.side)
    # Renderers round the edges of a picture outwards to whole dots; those of white paper over it they draw exactly.
    left = top = _MARGIN_MM
    right, bottom = left + tile.part_mm[2], top + tile.part_mm[3]
    beyond = 2 * max(*tile.page_mm, *job.size_mm)
    for place, size in (
        ((left - beyond, top - beyond), (beyond, 3 * beyond)),
        ((right, top - beyond), (beyond, 3 * beyond)),
        ((left - beyond, top - beyond), (3 * beyond, beyond)),
        ((left - beyond, bottom), (3 * beyond, beyond)),
    ):
        axes.add_patch(_filled(place, *size, "white"))


def _draw_cells(axes: Any, white: Mask, origin: tuple[float, float], side: float) -> None:
    """Draw cells of a marker or a chessboard: black paper, and on it every row's and every column's runs of white."""
    x, y = origin
    rows, columns = white.shape
    axes.add_patch(_filled((x, y), columns * side, rows * side, "black"))
    for row, column, count in _runs(white):
        axes.add_patch(_filled((x + column * side, y + row * side), count * side, side, "white"))
    # Renderers show the paper between shapes that touch: the columns' runs cover what is between the rows'.
    for column, row, count in _runs(white.T):
        axes.add_patch(_filled((x + column * side, y + row * side), side, count * side, "white"))


def _runs(white: Mask) -> Iterator[tuple[int, int, int]]:
    """Yield row, first column and length of what is white without a gap."""
    for row, values in enumerate(white):
        ends = np.flatnonzero(np.diff(np.concatenate(([0], values.astype(np.int8), [0]))))
        for start, end in ends.reshape(-1, 2).tolist():
            yield row, start, end - start


def _filled(place: tuple[float, float], width: float, height: float, color: str) -> Rectangle:
    return Rectangle(place, width, height, facecolor=color, edgecolor="none", linewidth=0)


def _draw_marks(axes: Any, job: PrintJob, tile: Tile, overlap_mm: float) -> None:
    """Draw cutting marks at the picture's corners, and on tiles where the next one is laid on."""
    (left, top), (width, height) = _origin(tile), job.size_mm
    columns = [(left, -1)] * (tile.column == 0) + [(left + width, 1)] * (tile.column == tile.columns - 1)
    rows = [(top, -1)] * (tile.row == 0) + [(top + height, 1)] * (tile.row == tile.rows - 1)
    for (x, out_x), (y, out_y) in itertools.product(columns, rows):
        _line(axes, x + out_x * _MARK_GAP_MM, y, x + out_x * (_MARK_GAP_MM + _MARK_MM), y)
        _line(axes, x, y + out_y * _MARK_GAP_MM, x, y + out_y * (_MARK_GAP_MM + _MARK_MM))
    _, _, part_width, part_height = tile.part_mm
    if tile.column < tile.columns - 1:
        x = _MARGIN_MM + part_width - overlap_mm
        _line(axes, x, _MARGIN_MM - _MARK_GAP_MM - _MARK_MM, x, _MARGIN_MM - _MARK_GAP_MM)
    if tile.row < tile.rows - 1:
        y = _MARGIN_MM + part_height - overlap_mm
        _line(axes, _MARGIN_MM - _MARK_GAP_MM - _MARK_MM, y, _MARGIN_MM - _MARK_GAP_MM, y)


def _line(axes: Any, x0: float, y0: float, x1: float, y1: float) -> None:
    axes.plot((x0, x1), (y0, y1), color="black", linewidth=0.4, solid_capstyle="butt")


def _draw_ruler(axes: Any, tile: Tile) -> None:
    length = _RULER_MM
    x, y = _MARGIN_MM, tile.page_mm[1] - _MARGIN_MM - _STRIP_MM + 12
    _line(axes, x, y, x + length, y)
    for mm in range(round(length) + 1):
        _line(axes, x + mm, y, x + mm, y - (3.0 if mm % 10 == 0 else 2.0 if mm % 5 == 0 else 1.2))


def _draw_words(axes: Any, job: PrintJob, tile: Tile) -> None:
    length = _RULER_MM
    lines = [
        f"Measure this ruler: {length:g} mm. If it is L mm long, {job.width_name} is {job.width_m:g} x L / {length:g}.",
        *job.words,
    ]
    if tile.columns * tile.rows > 1:
        number = tile.row * tile.columns + tile.column + 1
        lines.append(
            f"Page {number} of {tile.columns * tile.rows}: row {tile.row + 1} of {tile.rows}, column {tile.column + 1} "
            f"of {tile.columns}. Cut the left and upper margins off the pages that follow; lay them on at the marks."
        )
    y = tile.page_mm[1] - _MARGIN_MM - _STRIP_MM + 15.5
    for index, text in enumerate(lines):
        axes.text(
            _MARGIN_MM, y + 3.2 * index, text, fontsize=_FONT_PT, color="black", va="center", parse_math=False,
            usetex=False,
        )  # fmt: skip


def _printed_unscaled(pdf: bytes) -> bytes:
    """Return a PDF with a catalogue that asks viewers not to scale to the paper (ISO 32000-1, 7.5.6 and 12.2)."""
    root = re.search(rb"/Root (\d+) 0 R", pdf)
    catalogue = re.search(rb"\n%s 0 obj\n<<(.*?)>>\nendobj" % root.group(1), pdf, re.DOTALL) if root else None
    size, start = re.search(rb"/Size (\d+)", pdf), re.search(rb"startxref\n(\d+)\n", pdf)
    if root is None or catalogue is None or size is None or start is None:
        raise ShapeError("PDF: its catalogue was not found")
    number = root.group(1)
    changed = b"%s 0 obj\n<<%s /ViewerPreferences << /PrintScaling /None >> >>\nendobj\n" % (number, catalogue.group(1))
    table = b"xref\n%s 1\n%010d 00000 n \n" % (number, len(pdf))
    trailer = b"trailer\n<< /Size %s /Root %s 0 R /Prev %s >>\n" % (size.group(1), number, start.group(1))
    return pdf + changed + table + trailer + b"startxref\n%d\n%%%%EOF\n" % (len(pdf) + len(changed))
