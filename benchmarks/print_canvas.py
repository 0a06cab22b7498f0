# SPDX-License-Identifier: Apache-2.0
"""What prints are drawn with: antialiased shapes, text in several typefaces, codes, noise, pictures."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Pixels = NDArray[np.uint8]
Floats = NDArray[np.floating]
Colour = tuple[int, int, int]

BLACK: Colour = (20, 20, 22)
WHITE: Colour = (250, 250, 247)
#: Shapes are drawn larger by this factor and reduced by area: edges are antialiased.
_FINER = 3
#: Folders of the open data with photographs.
_FOLDERS = ("kodak", "mcmaster")
#: Typefaces that matplotlib brings along.
FACES = {
    "sans": "DejaVuSans.ttf",
    "bold": "DejaVuSans-Bold.ttf",
    "oblique": "DejaVuSans-Oblique.ttf",
    "serif": "DejaVuSerif.ttf",
    "serif_bold": "DejaVuSerif-Bold.ttf",
    "mono": "DejaVuSansMono.ttf",
    "roman": "STIXGeneral.ttf",
    "roman_bold": "STIXGeneralBol.ttf",
    "roman_italic": "STIXGeneralItalic.ttf",
}
WORDS = """
about above across after again air all along also always animal answer around autumn back bank before begin below
between big bird blue boat book both bread bridge bright bring build call carry change city clear close cloud coast
coffee cold colour come corner country cover cross dark day deep direct door down draw dream each early earth east
eight engine enough evening every example eye fall family far farm fast father field fire first fish five flower fly
follow food foot forest form four friend front full garden glass gold good grass great green ground group grow half
hand harbour hard head heat high hill hold home horse hot hour house hundred idea island keep kind king lake land
large last late laugh lead leaf learn leave left letter light line list little long low machine main make many map
mark market mean measure metal mile milk mind minute money month moon more morning mother mountain move music name
near new next night nine north note number ocean off often old open order other over page paint paper part people
picture piece place plain plane plant point power press produce quick quiet rain reach read ready red rest river
road rock room round rule salt sand school sea season second seed seven shape sharp ship short side silver simple
six sky sleep slow small snow song south space spring stand star start state stone street strong summer sun table
ten theatre thing thousand three time together town tree turn under valley village wait walk wall warm water wave
west wheel white wide wild wind winter wood word work world year
""".split()


class Canvas:
    """A sheet that is drawn on, in px of the final picture; the top left corner is (0, 0), the outer edge of a pixel.

    Parameters
    ----------
    width, height : px
    paper : its colour
    """

    def __init__(self, width: int, height: int, paper: Colour = WHITE) -> None:
        self.width, self.height = width, height
        self.image = Image.new("RGB", (width * _FINER, height * _FINER), paper)
        self._draw = ImageDraw.Draw(self.image)

    def rectangle(
        self, x: float, y: float, w: float, h: float, fill: Colour | None, edge: Colour | None = None,
        line: float = 2, radius: float = 0,
    ) -> None:  # fmt: skip
        """Draw a box, with rounded corners where `radius` is not 0."""
        box = [_up(v) for v in (x, y, x + w, y + h)]
        box = [box[0], box[1], max(box[2] - 1, box[0]), max(box[3] - 1, box[1])]
        self._draw.rounded_rectangle(box, _up(radius), fill, edge, max(_up(line), 1) if edge else 0)

    def ellipse(
        self, x: float, y: float, rx: float, ry: float, fill: Colour | None, edge: Colour | None = None, line: float = 2
    ) -> None:
        """Draw an ellipse about a centre."""
        box = [_up(v) for v in (x - rx, y - ry, x + rx, y + ry)]
        self._draw.ellipse(box, fill, edge, max(_up(line), 1) if edge else 0)

    def polygon(self, points: Sequence[tuple[float, float]] | Floats, fill: Colour) -> None:
        """Fill a polygon."""
        self._draw.polygon([(x * _FINER, y * _FINER) for x, y in points], fill)

    def line(self, points: Sequence[tuple[float, float]] | Floats, colour: Colour, width: float = 2) -> None:
        """Draw a polyline."""
        points = [(x * _FINER, y * _FINER) for x, y in points]
        self._draw.line(points, colour, max(_up(width), 1), joint="curve")

    def arc(self, x: float, y: float, radius: float, start: float, end: float, colour: Colour, width: float) -> None:
        """Draw a part of a circle, angles in degrees."""
        box = [_up(v) for v in (x - radius, y - radius, x + radius, y + radius)]
        self._draw.arc(box, start, end, colour, max(_up(width), 1))

    def text(
        self, x: float, y: float, text: str, size: float, colour: Colour = BLACK, face: str = "sans", anchor: str = "la"
    ) -> float:
        """Write a line of text; return its length, px."""
        font = font_of(face, _up(size))
        self._draw.text((x * _FINER, y * _FINER), text, colour, font, anchor)
        return float(font.getlength(text)) / _FINER

    def paragraph(
        self, rng: np.random.Generator, x: float, y: float, w: float, h: float, size: float,
        colour: Colour = BLACK, face: str = "serif", leading: float = 1.4, indent: float = 0,
    ) -> float:  # fmt: skip
        """Fill a column with justified sentences; return the y below the last line."""
        font = font_of(face, _up(size))
        bottom, words = y + h, sentences(rng, int(w * h / size**2) + 20)
        space = font.getlength(" ") / _FINER
        left = x + indent
        while y + size <= bottom and words:
            line, length = [], 0.0
            while words:
                more = font.getlength(words[0]) / _FINER
                if line and left + length + more > x + w:
                    break
                line.append((words.pop(0), more))
                length += more + space
            loose = x + w - left - (length - space)
            gap = space + (loose / (len(line) - 1) if len(line) > 1 and loose < 0.25 * w else 0)
            for word, long in line:
                self.text(left, y, word, size, colour, face)
                left += long + gap
            left, y = x, y + leading * size
        return y

    def paste(self, pixels: Pixels, x: float, y: float, w: float, h: float) -> None:
        """Put a picture onto the sheet, resized."""
        size = max(_up(w), 1), max(_up(h), 1)
        self.image.paste(Image.fromarray(pixels).resize(size, Image.Resampling.BICUBIC), (_up(x), _up(y)))

    def modules(self, bits: NDArray[np.bool_], x: float, y: float, w: float, h: float, colour: Colour = BLACK) -> None:
        """Draw the set cells of a matrix as squares without gaps."""
        rows, columns = bits.shape
        for row, column in np.argwhere(bits):
            x0, x1 = x + w * column / columns, x + w * (column + 1) / columns
            y0, y1 = y + h * row / rows, y + h * (row + 1) / rows
            self.rectangle(x0, y0, x1 - x0, y1 - y0, colour)

    def pixels(self) -> Pixels:
        """Return the picture, (H, W, 3) RGB."""
        return cv2.resize(np.asarray(self.image), (self.width, self.height), interpolation=cv2.INTER_AREA)


def _up(value: float) -> int:
    return round(value * _FINER)


@lru_cache(maxsize=256)
def font_of(face: str, size: int) -> ImageFont.FreeTypeFont:
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / FACES[face]), max(size, 4), layout_engine=ImageFont.Layout.BASIC)


def words(rng: np.random.Generator, count: int) -> list[str]:
    return [str(word) for word in rng.choice(WORDS, count)]


def title(rng: np.random.Generator, count: int) -> str:
    return " ".join(words(rng, count)).title()


def sentences(rng: np.random.Generator, count: int) -> list[str]:
    """Return at least `count` words with capitals and punctuation."""
    made: list[str] = []
    while len(made) < count:
        sentence = words(rng, int(rng.integers(5, 16)))
        sentence[0] = sentence[0].capitalize()
        if len(sentence) > 8 and rng.random() < 0.6:
            sentence[len(sentence) // 2] += ","
        sentence[-1] += "."
        made += sentence
    return made


def digits(rng: np.random.Generator, count: int) -> str:
    return "".join(str(d) for d in rng.integers(0, 10, count))


def price(rng: np.random.Generator) -> str:
    return f"{rng.integers(1, 60)}.{rng.choice([0, 19, 49, 50, 95, 99]):02d}"


def colour(rng: np.random.Generator, low: float = 0.0, high: float = 1.0) -> Colour:
    """Return a saturated colour with a brightness (the largest channel) in a range."""
    hue, saturation, value = rng.uniform(0, 180), rng.uniform(130, 255), 255 * rng.uniform(low, high)
    hsv = np.array([[[hue, saturation, value]]]).astype(np.uint8)
    return _as_colour(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0])


def palette(rng: np.random.Generator, count: int) -> list[Colour]:
    """Return colours that differ in brightness, from dark to light."""
    steps = np.linspace(0.25, 1.0, count)
    return [colour(rng, step, step) for step in steps]


def mixed(a: Colour, b: Colour, share: float) -> Colour:
    return _as_colour(np.rint((1 - share) * np.array(a) + share * np.array(b)))


def _as_colour(values: Floats) -> Colour:
    r, g, b = (int(v) for v in values)
    return r, g, b


def noise(rng: np.random.Generator, width: int, height: int, cell_x: float, cell_y: float) -> Floats:
    """Return smooth noise of zero mean and unit deviation with features of about a cell's size, (H, W) float32."""
    grid = rng.normal(size=(max(int(height / cell_y), 1) + 3, max(int(width / cell_x), 1) + 3)).astype(np.float32)
    size = round(grid.shape[1] * cell_x), round(grid.shape[0] * cell_y)
    whole = cv2.resize(grid, (max(size[0], width), max(size[1], height)), interpolation=cv2.INTER_CUBIC)
    part = whole[:height, :width]
    return (part - part.mean()) / max(float(part.std()), 1e-6)


def fractal(rng: np.random.Generator, width: int, height: int, cell: float, rough: float = 0.6) -> Floats:
    """Return noise of all sizes up to a cell's, zero mean and unit deviation."""
    total, weight = np.zeros((height, width), np.float32), 1.0
    while cell >= 1:
        total += weight * noise(rng, width, height, cell, cell)
        cell, weight = cell / 2, weight * rough
    return (total - total.mean()) / max(float(total.std()), 1e-6)


def tinted(grey: Floats, dark: Colour, light: Colour) -> Pixels:
    """Map 0 ... 1 to a range of colours."""
    share = np.clip(grey, 0, 1)[..., None]
    return np.rint((1 - share) * np.array(dark) + share * np.array(light)).astype(np.uint8)


@lru_cache(maxsize=1)
def photographs() -> tuple[Pixels, ...]:
    """Return the photographs of the open data, RGB; none where there is no such folder (`$IMGU_DATA`)."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    data = Path(os.environ.get("IMGU_DATA") or default)
    files = [path for folder in _FOLDERS if (data / folder).is_dir() for path in sorted((data / folder).iterdir())]
    images = [cv2.imread(str(path), cv2.IMREAD_COLOR) for path in files]
    return tuple(cv2.cvtColor(image, cv2.COLOR_BGR2RGB) for image in images if image is not None)


def printed_photographs() -> tuple[Pixels, ...]:
    """Return those that prints may hold; the others are backgrounds."""
    return photographs()[::2]


def background_photographs() -> tuple[Pixels, ...]:
    return photographs()[1::2]


def picture(rng: np.random.Generator, width: int, height: int) -> Pixels:
    """Return a part of a photograph, or a landscape drawn by noise where there are none."""
    known = printed_photographs()
    if not known:
        return landscape(rng, width, height)
    image = known[int(rng.integers(len(known)))]
    return cropped(rng, image, width, height)


def cropped(rng: np.random.Generator, image: Pixels, width: int, height: int) -> Pixels:
    """Return a random part of a picture, with the given shape, as large as its shape allows or a little smaller."""
    fit = min(image.shape[1] / width, image.shape[0] / height) * rng.uniform(0.8, 1.0)
    w, h = int(width * fit), int(height * fit)
    x, y = int(rng.integers(image.shape[1] - w + 1)), int(rng.integers(image.shape[0] - h + 1))
    how = cv2.INTER_AREA if fit > 1 else cv2.INTER_CUBIC
    return cv2.resize(image[y : y + h, x : x + w], (width, height), interpolation=how)


def landscape(rng: np.random.Generator, width: int, height: int) -> Pixels:
    """Return sky with clouds, ridges behind each other, and grass."""
    y = np.linspace(0, 1, height, dtype=np.float32)[:, None]
    clouds = 1 / (1 + np.exp(-2 * fractal(rng, width, height, width / 4)))
    image = tinted(0.5 * clouds + 0.5 * y, (70, 120, 200), (240, 240, 245)).astype(np.float32)
    for layer, horizon in enumerate(np.sort(rng.uniform(0.35, 0.8, 4))):
        ridge = horizon + 0.08 * noise(rng, width, 1, width / 5, 1) + 0.015 * noise(rng, width, 1, width / 40, 1)
        shade = np.array(colour(rng, 0.2, 0.55)) * (1.2 - 0.2 * layer)
        grain = 1 + 0.18 * fractal(rng, width, height, width / 16, 0.8)[..., None]
        image = np.where((y > ridge)[..., None], shade * grain, image)
    return np.clip(image, 0, 255).astype(np.uint8)


def tag_bits(rng: np.random.Generator, side: int = 6) -> NDArray[np.bool_]:
    """Return a square marker's cells, black ones set: a border and `side` x `side` bits, which no turn repeats."""
    while True:
        code = rng.random((side, side)) < 0.5
        if all(np.count_nonzero(code != np.rot90(code, k)) >= 8 for k in (1, 2, 3)):
            break
    bits = np.ones((side + 2, side + 2), bool)
    bits[1:-1, 1:-1] = code
    return bits


def qr_bits(rng: np.random.Generator, side: int = 29) -> NDArray[np.bool_]:
    """Return cells as those of a QR code: finder, timing and alignment patterns, and random data."""
    bits = rng.random((side, side)) < 0.5
    bits[6, :] = bits[:, 6] = np.arange(side) % 2 == 0
    finder = np.ones((7, 7), bool)
    finder[1:6, 1:6] = False
    finder[2:5, 2:5] = True
    for top, left in ((0, 0), (0, side - 7), (side - 7, 0)):
        bits[max(top - 1, 0) : top + 8, max(left - 1, 0) : left + 8] = False
        bits[top : top + 7, left : left + 7] = finder
    small = np.ones((5, 5), bool)
    small[1:4, 1:4] = False
    small[2, 2] = True
    bits[side - 9 : side - 4, side - 9 : side - 4] = small
    return bits


def data_matrix_bits(rng: np.random.Generator, side: int = 22) -> NDArray[np.bool_]:
    """Return cells as those of a Data Matrix code: a solid L, dashed edges opposite it, and random data."""
    bits = rng.random((side, side)) < 0.5
    bits[0, :] = np.arange(side) % 2 == 0
    bits[:, -1] = np.arange(side) % 2 == 1
    bits[:, 0] = bits[-1, :] = True
    return bits


def bar_widths(rng: np.random.Generator, count: int) -> NDArray[np.int64]:
    """Return widths of bars and gaps in turn, 1 to 4 modules, with guards at both ends."""
    return np.concatenate(([1, 1, 1], rng.integers(1, 5, count), [1, 1, 1]))


def draw_barcode(
    canvas: Canvas, rng: np.random.Generator, x: float, y: float, w: float, h: float, bars: int = 42
) -> None:
    """Draw a barcode with its digits below."""
    widths = bar_widths(rng, 2 * bars + 1)
    unit = w / widths.sum()
    left = x
    for index, width in enumerate(widths):
        if index % 2 == 0:
            canvas.rectangle(left, y, unit * width, 0.82 * h, BLACK)
        left += unit * width
    size = min(0.15 * h, w / 16)
    canvas.text(x + w / 2, y + 0.85 * h, f"{digits(rng, 1)} {digits(rng, 6)} {digits(rng, 6)}", size, anchor="ma")


def turned(points: Floats, angle: float, about: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Rotate points (N, 2) by an angle, rad, about one."""
    c, s = math.cos(angle), math.sin(angle)
    return (np.asarray(points) - about) @ np.array([[c, s], [-s, c]]) + about


def star(count: int, inner: float) -> Floats:
    """Return a star with `count` points and outer radius 1, (2 count, 2)."""
    angles = np.arange(2 * count) * math.pi / count - math.pi / 2
    radius = np.where(np.arange(2 * count) % 2 == 0, 1.0, inner)
    return np.column_stack((np.cos(angles), np.sin(angles))) * radius[:, None]


def blob(rng: np.random.Generator, rough: float = 0.25, count: int = 120) -> Floats:
    """Return a smooth closed curve about the origin with radius near 1, (count, 2)."""
    angles = np.linspace(0, 2 * math.pi, count, endpoint=False)
    radius = np.ones(count)
    for wave in range(1, 6):
        radius += rough / wave * rng.normal() * np.cos(wave * angles + rng.uniform(0, 2 * math.pi))
    radius = np.clip(radius, 0.3, 2)
    return np.column_stack((np.cos(angles), np.sin(angles))) * (radius / radius.max())[:, None]
