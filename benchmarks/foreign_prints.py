# SPDX-License-Identifier: Apache-2.0
"""Printed pictures of benchmarks/foreign_frames.py: photographs, a text page, a label, a grid of dots."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from PIL import Image as Drawing
from PIL import ImageDraw, ImageFont

from imgu_ros.types import Floats, Image

_SYLLABLES = "ka lo mi ren tas vor el un di per so an quel bra ti mon gra fe lu ex ist or ha by zen wic dup".split()
#: Of Matplotlib: OpenCV's fonts differ between its versions.
_FONTS = ("DejaVuSans", "DejaVuSans-Bold", "DejaVuSerif", "DejaVuSerif-Bold", "DejaVuSansMono", "STIXGeneral")
#: Drawn at so many times the size, then reduced by area.
_OVERSAMPLED = 4
#: Dots of the test print: columns and rows, px between them, radius; size of the print.
DOT_GRID, DOT_STEP_PX, DOT_RADIUS_PX = (11, 7), 60, 17
DOTS_SIZE = (720, 480)


def photographs() -> list[Path]:
    """Return the photographs of `$IMGU_DATA`, or of `../shared/data`."""
    data = Path(os.environ.get("IMGU_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
    return sorted([*(data / "kodak").glob("*.png"), *(data / "mcmaster").glob("*.tif")])


def photograph(path: Path) -> Image:
    """Return RGB."""
    return np.ascontiguousarray(cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1])


def text_page(rng: np.random.Generator) -> Image:
    """Return a landscape page, 840 x 594: a heading and two columns of words that mean nothing."""
    width, height = 840, 594
    page = _Canvas(width, height, (245, 243, 238))
    ink = tuple(int(v) for v in rng.integers(10, 45, 3))
    font = _FONTS[rng.integers(len(_FONTS))]
    page.text(" ".join(_word(rng).capitalize() for _ in range(3)), (44, 66), 40, ink, font)
    size, leading = rng.uniform(16, 21), 0.0
    for left, right in ((44, 404), (440, 800)):
        y = 110.0
        while y < height - 36:
            leading = size * 1.35
            x = left + (22 if rng.random() < 0.15 else 0)
            while True:
                word = _word(rng) + ("," if rng.random() < 0.1 else "." if rng.random() < 0.1 else "")
                advance = page.width_of(word, size, font)
                if x + advance > right:
                    break
                page.text(word, (x, y), size, ink, font)
                x += advance + size * 0.3
            y += leading
    return page.pixels()


def label(rng: np.random.Generator) -> Image:
    """Return a parcel or product label, 640 x 420: flat colours, a bar code, few words, a mark."""
    width, height = 640, 420
    hue = rng.integers(0, 180)
    colour, dark, pale = (_hsv(hue, *sv) for sv in ((190, 200), (200, 90), (40, 250)))
    accent = _hsv(int(hue + rng.integers(60, 120)) % 180, 210, 230)
    canvas = _Canvas(width, height, pale)
    split = rng.uniform(0.3, 0.4) * height
    canvas.box((0, 0), (width, split), colour)
    canvas.box((0, split), (width, split + 8), dark)
    font = _FONTS[rng.integers(len(_FONTS))]
    canvas.text(_word(rng, 2).upper(), (30, split * 0.62), split * 0.5, pale, font)
    canvas.text(_word(rng, 3), (34, split * 0.9), 20, pale, font)
    centre = (width * rng.uniform(0.74, 0.84), split * rng.uniform(0.9, 1.15))
    canvas.disc(centre, 58, accent)
    canvas.disc(centre, 44, pale)
    canvas.text(f"{rng.integers(10, 99)}", (centre[0] - 26, centre[1] + 15), 40, dark, font)
    for row in range(3):
        words = f"{_word(rng, 3)} {rng.integers(100, 9999)}"
        canvas.text(words, (34, split + 58 + 34 * row), 22, (30, 30, 30), font)
    x, end, bottom = 34.0, width * rng.uniform(0.4, 0.55), height - 26.0
    while x < end:
        bar = float(rng.integers(1, 4)) * 2.2
        canvas.box((x, bottom - 78), (x + bar, bottom), (20, 20, 20))
        x += bar + float(rng.integers(1, 4)) * 2.2
    canvas.box((end + 60, height - 96), (width - 34, height - 30), accent)
    return canvas.pixels()


def dots() -> Image:
    """Return the test print: black discs on white."""
    canvas = _Canvas(*DOTS_SIZE, (235, 235, 235))
    for x, y in dot_centres():
        canvas.disc((float(x), float(y)), DOT_RADIUS_PX, (12, 12, 12))
    return canvas.pixels()


def dot_centres() -> Floats:
    """Return (N, 2) template px."""
    columns, rows = DOT_GRID
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    grid = np.column_stack((x.ravel(), y.ravel())) - (np.array(DOT_GRID) - 1) / 2
    return np.asarray(grid * DOT_STEP_PX + (np.array(DOTS_SIZE) - 1) / 2)


class _Canvas:
    """Draws in px of the picture, pixel centres at integers."""

    def __init__(self, width: int, height: int, colour: tuple[int, ...]) -> None:
        self._k = _OVERSAMPLED
        self._big = Drawing.new("RGB", (width * self._k, height * self._k), colour)
        self._pen = ImageDraw.Draw(self._big)
        self._size = (width, height)

    def text(self, words: str, at: tuple[float, float], size: float, colour: tuple[int, ...], font: str) -> None:
        """Draw words; `size` is the font's, px; `at` the left end of the baseline."""
        place = (at[0] * self._k, at[1] * self._k)
        self._pen.text(place, words, colour, self._font(size, font), anchor="ls")

    def width_of(self, words: str, size: float, font: str) -> float:
        """Return the width of words, px."""
        return float(self._font(size, font).getlength(words)) / self._k

    def box(self, start: tuple[float, float], end: tuple[float, float], colour: tuple[int, ...]) -> None:
        """Fill a rectangle between two edges."""
        (x0, y0), (x1, y1) = ([round(v * self._k) for v in p] for p in (start, end))
        self._pen.rectangle((x0, y0, x1 - 1, y1 - 1), colour)

    def disc(self, centre: tuple[float, float], radius: float, colour: tuple[int, ...]) -> None:
        """Fill a disc."""
        x, y, r = ((centre[0] + 0.5) * self._k - 0.5, (centre[1] + 0.5) * self._k - 0.5, radius * self._k)
        box = (int(x - r) - 2, int(y - r) - 2, int(x + r) + 3, int(y + r) + 3)
        pixels = np.array(self._big.crop(box))
        v, u = np.indices(pixels.shape[:2])
        inside = np.clip(r - np.hypot(u + box[0] - x, v + box[1] - y) + 0.5, 0, 1)[..., None]
        disc = np.rint(pixels + inside * (np.array(colour) - pixels)).astype(np.uint8)
        self._big.paste(Drawing.fromarray(disc), box[:2])

    def pixels(self) -> Image:
        """Return the picture."""
        return np.asarray(cv2.resize(np.array(self._big), self._size, interpolation=cv2.INTER_AREA), np.uint8)

    def _font(self, size: float, font: str) -> ImageFont.FreeTypeFont:
        return ImageFont.truetype(str(Path(matplotlib.get_data_path(), "fonts", "ttf", f"{font}.ttf")), size * self._k)


def _word(rng: np.random.Generator, most: int = 4) -> str:
    return "".join(rng.choice(_SYLLABLES, rng.integers(1, most + 1)))


def _hsv(*value: int) -> tuple[int, ...]:
    pixel = cv2.cvtColor(np.array([[value]], np.uint8), cv2.COLOR_HSV2RGB)
    return tuple(int(v) for v in pixel[0, 0])
