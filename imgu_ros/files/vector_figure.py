# SPDX-License-Identifier: Apache-2.0
"""Vector figures (SVG, PDF, PostScript): lines, dots and text over a raster picture, that scale without artefacts."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.textpath import text_to_path

from imgu_ros.errors import FileError
from imgu_ros.file_access.atomic_files import write_whole
from imgu_ros.files.plot_style import plot_style
from imgu_ros.types import Image, Points, as_image, as_points

#: Suffixes of vector formats.
VECTOR_SUFFIXES = (".svg", ".pdf", ".eps", ".ps")

_POSTSCRIPT = (".eps", ".ps")
_DPI = 72  # a pixel of the picture is one point of the figure, and an inch has 72 of these
_INK = "black"
_DARKENING = 0.65  # of the strip behind the text
_SETTINGS: Any = {
    "svg.fonttype": "none",  # text stays text
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "ps.papersize": "figure",  # a page as large as the figure
    "svg.hashsalt": "imgu",  # the same figure, the same bytes
    "path.simplify": False,
}


class VectorFigure:
    """A picture, and what is drawn over it, in the picture's pixel coordinates: (0, 0) is the top left pixel's centre.

    Parameters
    ----------
    picture : (H, W, 3) uint8 RGB; embedded as it is

    Raises
    ------
    ShapeError
        If it is no such picture.
    """

    def __init__(self, picture: Image) -> None:
        picture = as_image(picture, "picture", (3,), (np.uint8,))
        self._picture = picture
        self._height, self._width = (int(side) for side in picture.shape[:2])
        self._strips: list[Rectangle] = []
        with plot_style({}):
            self._figure = Figure(figsize=(self._width / _DPI, self._height / _DPI), dpi=_DPI)
        # Pixels are squares about their centres: the picture reaches from -0.5 to W - 0.5.
        left, right, top, bottom = -0.5, self._width - 0.5, -0.5, self._height - 0.5
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.imshow(picture, extent=(left, right, bottom, top), interpolation="none", aspect="auto")
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)
        axes.set_autoscale_on(False)
        self._axes: Any = axes
        self._layer = 10

    @property
    def width(self) -> float:
        """Width of a line that suits the picture's size, px."""
        return 1.0 + max(self._height, self._width) // 640

    @plot_style({})
    def line(self, points: Points, color: tuple[int, int, int], *, closed: bool = False) -> None:
        """Draw a polyline through points (N, 2), dark-edged so that it stands out on any picture."""
        points = as_points(points)
        x, y = (np.concatenate((points, points[:1])) if closed else points).T
        self._axes.plot(
            x, y, color=_rgb(color), linewidth=self.width, solid_joinstyle="round", zorder=self._on_top(),
            path_effects=[withStroke(linewidth=self.width + 2, foreground=_INK)],
        )  # fmt: skip

    @plot_style({})
    def dots(self, points: Points, color: tuple[int, int, int], radius: float) -> None:
        """Draw discs of a radius in px about points (N, 2)."""
        x, y = as_points(points).T
        self._axes.scatter(x, y, s=(2 * radius) ** 2, color=[_rgb(color)], linewidths=0, zorder=self._on_top())

    @plot_style({})
    def text(self, lines: list[tuple[str, tuple[int, int, int]]]) -> None:
        """Write lines in their colours, top left, on a darkened strip; what does not fit the width is cut."""
        size = max(8.0, max(self._height, self._width) / 60)
        spacing, margin = 1.5 * size, 0.3 * size
        strip = Rectangle(
            (-0.5, -0.5), self._width, spacing * len(lines) + margin, facecolor=_INK, alpha=_DARKENING, linewidth=0,
            zorder=self._on_top(),
        )  # fmt: skip
        self._strips.append(self._axes.add_patch(strip))
        for row, (text, color) in enumerate(lines):
            self._axes.text(
                margin, spacing * (row + 0.75) + margin / 2, _fitting(text, size, self._width - 2 * margin),
                color=_rgb(color), fontsize=size, parse_math=False, usetex=False, zorder=self._on_top(),
            )  # fmt: skip

    def _on_top(self) -> int:
        """Return a layer above all that is drawn: later covers earlier, whatever kind it is."""
        self._layer += 1
        return self._layer

    def save(self, path: Path | str) -> None:
        """Write the figure; the suffix, one of `VECTOR_SUFFIXES`, chooses the format; .eps and .ps are PostScript.

        The same figure gives the same bytes.

        Raises
        ------
        FileError
            If the suffix is another one, or the file cannot be written.
        """
        with plot_style({}):
            self._save(path)

    def _save(self, path: Path | str) -> None:
        if Path(path).suffix.lower() not in _POSTSCRIPT:
            save_figure(self._figure, path)
            return
        # What lies under a strip shows through: the darkened picture itself, for PostScript knows no transparency.
        shown = [self._darkened(strip) for strip in self._strips]
        for strip in self._strips:
            strip.set_visible(False)
        try:
            save_figure(self._figure, path)
        finally:
            for strip, image in zip(self._strips, shown, strict=True):
                strip.set_visible(True)
                image.remove()

    def _darkened(self, strip: Rectangle) -> Any:
        """Draw the picture's rows under a strip as they look through it."""
        rows = min(self._height, max(1, round(strip.get_height())))
        pixels = np.rint(self._picture[:rows] * (1 - _DARKENING)).astype(np.uint8)
        extent = (-0.5, self._width - 0.5, rows - 0.5, -0.5)
        image = self._axes.imshow(pixels, extent=extent, interpolation="none", aspect="auto", zorder=strip.get_zorder())
        self._axes.set_xlim(-0.5, self._width - 0.5)
        self._axes.set_ylim(self._height - 0.5, -0.5)
        return image


def save_figure(figure: Figure, path: Path | str) -> None:
    """Write any Matplotlib figure as .svg, .pdf, .eps or .ps; the same figure gives the same bytes.

    PostScript knows no transparency: what is transparent in the figure is opaque there.

    Raises
    ------
    FileError
        If the suffix is another one, or the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in VECTOR_SUFFIXES:
        raise FileError(f"{path}: suffix {path.suffix!r}; need one of {', '.join(VECTOR_SUFFIXES)}")
    content = _postscript(figure, suffix[1:]) if suffix in _POSTSCRIPT else _dated(figure, suffix[1:])
    write_whole(path, content)


def _dated(figure: Figure, kind: str) -> bytes:
    """Return the figure as SVG or PDF, which have a date of their own unless they are told otherwise."""
    content = io.BytesIO()
    with mpl.rc_context(_SETTINGS):
        figure.savefig(content, format=kind, metadata={"Date" if kind == "svg" else "CreationDate": None})
    return content.getvalue()


def _postscript(figure: Figure, kind: str) -> bytes:
    transparent = [artist for artist in figure.findobj() if artist.get_alpha() is not None]
    alphas = [artist.get_alpha() for artist in transparent]
    content = io.BytesIO()
    try:
        for artist in transparent:
            artist.set_alpha(None)
        with mpl.rc_context(_SETTINGS):
            figure.savefig(content, format=kind)
    finally:
        for artist, alpha in zip(transparent, alphas, strict=True):
            artist.set_alpha(alpha)
    written = re.sub(rb"^%%CreationDate: .*\n", b"", content.getvalue(), count=1, flags=re.MULTILINE)
    if kind == "ps":
        # Matplotlib leaves it to the printer: what is larger than its paper would be cut.
        width, height = (_DPI * side for side in figure.get_size_inches())
        setup = f"%%BeginSetup\n<< /PageSize [{width:g} {height:g}] >> setpagedevice\n%%EndSetup\n".encode()
        written = re.sub(rb"^(?=%%Page: 1 1$)", setup, written, count=1, flags=re.MULTILINE)
    return written


def _rgb(color: tuple[int, int, int]) -> tuple[float, float, float]:
    red, green, blue = color
    return red / 255, green / 255, blue / 255


def _fitting(text: str, size: float, width: float) -> str:
    """Return as much of `text` as fits into `width` points; only characters that every font has."""
    # SVG shows several spaces as one, unless they do not break.
    plain = text.encode("ascii", "replace").decode("ascii").replace("  ", "\N{NO-BREAK SPACE}" * 2)
    font = FontProperties(size=size)

    def fits(shown: str) -> bool:
        return float(text_to_path.get_text_width_height_descent(shown, font, False)[0]) <= width

    if not plain or fits(plain):
        return plain
    least, most = 0, len(plain)
    while most - least > 1:
        middle = (least + most) // 2
        least, most = (middle, most) if fits(plain[:middle] + "..") else (least, middle)
    return plain[:least] + ".." if least else ""
