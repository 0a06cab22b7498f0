# SPDX-License-Identifier: Apache-2.0
"""Sheets and scenes of `negatives.py`: drawn by OpenCV's own lines and letters, seen by a renderer of its own.

Nothing of the package's simulation, nor of the prints and views of `printed_targets.py`, is in them. Sheets are
photographs, pages, labels, logos, tags and boards of tags, as 8-bit sRGB. A scene without a target is a photograph,
a page, tiles, a checkerboard, stripes, noise, a gradient or blobs, flat or in perspective, or several of them.
"""

from __future__ import annotations

import math
import string
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from print_canvas import Pixels, photographs

from imgu_ros.frame import Frame
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

Floats = NDArray[np.floating]
Sheet = Callable[[np.random.Generator], Pixels]

WIDTH, HEIGHT = 640, 480
FOCAL_PX = 550.0
K = np.array([[FOCAL_PX, 0, WIDTH / 2], [0, FOCAL_PX, HEIGHT / 2], [0, 0, 1]])
_FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_TRIPLEX,
)  # fmt: skip
_LETTERS = np.array(list(string.ascii_lowercase))
#: Bytes in a Bayer frame, by whether they are linear in the light.
_LAYOUT = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)


# Sheets


def photo(rng: np.random.Generator, of_targets: bool = True) -> Pixels:
    """Return a part of a photograph; every second one is for targets, the others are not."""
    known = photographs()[0 if of_targets else 1 :: 2] or (_blobs(rng, 768, 512),)
    image = known[int(rng.integers(len(known)))]
    scale = rng.uniform(0.55, 1.0)
    h, w = (int(side * scale) for side in image.shape[:2])
    y, x = rng.integers(image.shape[0] - h + 1), rng.integers(image.shape[1] - w + 1)
    part = image[y : y + h, x : x + w]
    return np.ascontiguousarray(part[:, ::-1] if rng.random() < 0.5 else part)


def page(rng: np.random.Generator) -> Pixels:
    """Draw lines of letters under a heading."""
    w, h = 620, 840
    image = np.full((h, w, 3), 250, np.uint8)
    font, size = int(rng.choice(_FONTS)), rng.uniform(0.4, 0.7)
    _letters(image, _word(rng, 5, 14).title(), (50, 70), 1.6 * size + 0.4, (20, 20, 20), font, 2)
    y = 110.0
    while y < h - 40:
        x = 50.0
        while x < w - 90 and rng.random() > 0.04:
            word = _word(rng, 2, 9)
            _letters(image, word, (x, y), size, (30, 30, 30), font)
            x += cv2.getTextSize(word, font, size, 1)[0][0] + 14 * size
        y += 34 * size + (20 if rng.random() < 0.15 else 0)
    return image


def label(rng: np.random.Generator) -> Pixels:
    """Draw a name, fields, a code of bars and a large number in a frame."""
    w, h = 640, 420
    image = np.full((h, w, 3), 245, np.uint8)
    ink = _colour(rng, 110)
    cv2.rectangle(image, (12, 12), (w - 13, h - 13), ink, 3)
    image[12 : int(rng.integers(60, 110)), 12 : w - 12] = ink
    _letters(image, _word(rng, 5, 10).upper(), (30, 58), 1.3, (250, 250, 250), cv2.FONT_HERSHEY_DUPLEX, 3)
    for row in range(3):
        _letters(image, f"{_word(rng, 3, 7)}: {_digits(rng, 6)}", (30, 150 + 40 * row), 0.8, (20, 20, 20), _FONTS[0], 2)
    _letters(image, _digits(rng, 3), (400, 200), 2.4, ink, cv2.FONT_HERSHEY_DUPLEX, 6)
    x = 30
    while x < w - 60:
        thick = int(rng.integers(2, 9))
        cv2.rectangle(image, (x, 280), (x + thick, 380), (10, 10, 10), -1)
        x += thick + int(rng.integers(3, 10))
    return image


def logo(rng: np.random.Generator) -> Pixels:
    """Draw a few large shapes and a name."""
    w, h = 560, 480
    image = np.full((h, w, 3), _colour(rng, 256, 190), np.uint8)
    for _ in range(int(rng.integers(3, 8))):
        centre, radius = rng.uniform((80, 60), (w - 80, h - 180)), rng.uniform(25, 110)
        corners = int(rng.integers(3, 9))
        angles = np.sort(rng.uniform(0, 2 * math.pi, corners))
        shape = centre + radius * np.column_stack((np.cos(angles), np.sin(angles)))
        if rng.random() < 0.4:
            cv2.circle(image, _at(centre), int(radius * 0.6), _colour(rng), -1, cv2.LINE_AA)
        else:
            cv2.fillPoly(image, [np.rint(shape).astype(np.int32)], _colour(rng), cv2.LINE_AA)
    _letters(image, _word(rng, 4, 8).upper(), (60, h - 50), 2.2, _colour(rng, 90), cv2.FONT_HERSHEY_DUPLEX, 6)
    return image


def tag(rng: np.random.Generator) -> Pixels:
    """Draw a square of random bits in a black border."""
    return _bits(rng, 8, 52)


def board(rng: np.random.Generator) -> Pixels:
    """Draw several tags beside each other."""
    image = np.full((520, 720, 3), 255, np.uint8)
    for row in range(2):
        for column in range(3):
            size = _bits(rng, 7, 24)
            image[30 + 250 * row : 30 + 250 * row + 216, 20 + 235 * column : 20 + 235 * column + 216] = size[:216, :216]
    return image


SHEETS: dict[str, Sheet] = {each.__name__: each for each in (photo, page, label, logo, tag, board)}


def sibling(rng: np.random.Generator, sheet: Pixels, share: float) -> Pixels:
    """Return a sheet of which a part of `share` of the area, a rectangle, is of other letters on its own ground."""
    h, w = sheet.shape[:2]
    image = sheet.copy()
    aspect = math.exp(rng.uniform(-0.7, 0.7))
    ph, pw = (int(min(side * math.sqrt(share) * by, 0.9 * side)) for side, by in ((h, aspect), (w, 1 / aspect)))
    y, x = int(rng.uniform(0.04 * h, 0.96 * h - ph)), int(rng.uniform(0.04 * w, 0.96 * w - pw))
    ground = np.median(sheet[y : y + ph, x : x + pw].reshape(-1, 3), axis=0)
    part = np.full((ph, pw, 3), ground, np.uint8)
    ink = (20, 20, 20) if ground.mean() > 110 else (240, 240, 240)
    size = rng.uniform(0.6, 1.6)
    for line in range(int(24 * size), ph, int(34 * size)):
        _letters(part, _word(rng, 8, 40), (3, line), size, ink, _FONTS[1], max(round(2 * size), 1))
    image[y : y + ph, x : x + pw] = part
    return image


# Scenes


def scene(rng: np.random.Generator) -> Pixels:
    """Return a scene that shows no target, (HEIGHT, WIDTH, 3) sRGB."""
    image = SCENES[int(rng.integers(len(SCENES)))](rng)
    if rng.random() < 0.5:
        size = np.array(image.shape[1::-1])
        corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * size
        turned = corners + rng.uniform(-0.25, 0.25, (4, 2)) * size
        H = cv2.getPerspectiveTransform(corners.astype(np.float32), turned.astype(np.float32))
        image = cv2.warpPerspective(image, H, size.tolist(), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REFLECT)
    return cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)


def _of_photograph(rng: np.random.Generator) -> Pixels:
    return photo(rng, of_targets=False)


def _tiles(rng: np.random.Generator) -> Pixels:
    """Repeat a small picture."""
    part = label(rng) if rng.random() < 0.5 else photo(rng, of_targets=False)
    side = int(rng.integers(60, 220))
    tile = cv2.resize(part, (side, side), interpolation=cv2.INTER_AREA)
    if rng.random() < 0.5:
        tile = np.vstack((np.hstack((tile, tile[:, ::-1])), np.hstack((tile[::-1], tile[::-1, ::-1]))))
    return np.tile(tile, (HEIGHT // tile.shape[0] + 1, WIDTH // tile.shape[1] + 1, 1))[:HEIGHT, :WIDTH]


def _checker(rng: np.random.Generator) -> Pixels:
    step = rng.uniform(8, 90, 2)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    odd = (x // step[0] + y // step[1]) % 2 > 0
    return np.where(odd[..., None], np.array(_colour(rng)), np.array(_colour(rng))).astype(np.uint8)


def _stripes(rng: np.random.Generator) -> Pixels:
    period, angle = rng.uniform(5, 80), rng.uniform(0, math.pi)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    wave = 0.5 + 0.5 * np.clip(
        rng.uniform(1, 8) * np.sin((x * np.cos(angle) + y * np.sin(angle)) * 6.28 / period), -1, 1
    )
    return (wave[..., None] * np.array(_colour(rng)) + (1 - wave[..., None]) * np.array(_colour(rng))).astype(np.uint8)


def _noise(rng: np.random.Generator) -> Pixels:
    cell = rng.uniform(1, 24)
    small = rng.integers(0, 256, (int(HEIGHT / cell) + 2, int(WIDTH / cell) + 2, 3), np.uint8)
    how = cv2.INTER_NEAREST if rng.random() < 0.5 else cv2.INTER_CUBIC
    return cv2.resize(small, (WIDTH, HEIGHT), interpolation=how)


def _gradient(rng: np.random.Generator) -> Pixels:
    corners = rng.integers(0, 256, (2, 2, 3), np.uint8)
    return cv2.resize(corners, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)


def _blobs(rng: np.random.Generator, width: int = WIDTH, height: int = HEIGHT) -> Pixels:
    image = np.full((height, width, 3), _colour(rng), np.uint8)
    for _ in range(int(rng.integers(20, 200))):
        axes = tuple(int(side) for side in rng.gamma(2, 20, 2) + 2)
        cv2.ellipse(
            image, _at(rng.uniform((0, 0), (width, height))), axes, rng.uniform(0, 180), 0, 360, _colour(rng), -1
        )
    return image


def _clutter(rng: np.random.Generator) -> Pixels:
    """Lay sheets that are not the targets over a photograph."""
    image = cv2.resize(photo(rng, of_targets=False), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    for _ in range(int(rng.integers(1, 4))):
        sheet = SHEETS[str(rng.choice([kind for kind in SHEETS if kind != "photo"]))](rng)
        put(image, sheet, placed(rng, sheet, (120, 420))[0])
    return image


#: Photographs and clutter more often than patterns.
SCENES = (
    _of_photograph, _of_photograph, _of_photograph, _clutter, _clutter, page, _tiles, _checker, _stripes, _noise,
    _gradient, _blobs,
)  # fmt: skip


# Views


@dataclass(frozen=True)
class Look:
    """Light, blur and noise of a view, the same for all frames of a sequence."""

    exposure: float
    shade: tuple[float, float]
    blur_px: float
    electrons: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Look:
        """Draw a look by chance."""
        shade = rng.uniform(-0.2, 0.2, 2)
        return cls(
            float(rng.uniform(0.35, 0.95)), (float(shade[0]), float(shade[1])), float(rng.uniform(0.35, 1.1)),
            float(rng.choice([1500.0, 5000.0, 15000.0])),
        )  # fmt: skip


def placed(
    rng: np.random.Generator, sheet: Pixels, seen_px: tuple[float, float], tilt_deg: float = 55.0
) -> tuple[Floats, Floats]:
    """Return H_frame_sheet, px, of a sheet that is wholly in view, and its rotation and place (3, 4)."""
    while True:
        seen, tilt = math.exp(rng.uniform(*np.log(seen_px))), math.radians(rng.uniform(0, tilt_deg))
        at = np.linalg.solve(K, (*rng.uniform((0, 0), (WIDTH, HEIGHT)), 1.0))
        axis = rng.uniform(0, 2 * math.pi)
        R = rotation((0, 0, axis)) @ rotation((tilt, 0, 0)) @ rotation((0, 0, rng.uniform(0, 2 * math.pi)))
        place = np.column_stack((R, at * FOCAL_PX / seen))
        H = homography(sheet, place)
        if in_view(sheet, H):
            return H, place


def homography(sheet: Pixels, place: Floats) -> Floats:
    """Return H_frame_sheet of a sheet whose longer side is 1."""
    h, w = sheet.shape[:2]
    s = 1 / max(h, w)
    H = K @ place[:, [0, 1, 3]] @ np.array([[s, 0, -s * (w - 1) / 2], [0, s, -s * (h - 1) / 2], [0, 0, 1]])
    return H / H[2, 2]


def in_view(sheet: Pixels, H: Floats) -> bool:
    """Return whether all of a sheet is in the frame."""
    xy = corners(sheet, H)
    return bool(((xy > 1) & (xy < (WIDTH - 2, HEIGHT - 2))).all())


def corners(sheet: Pixels, H: Floats) -> Floats:
    """Return the outer corners of a sheet by a homography, (4, 2)."""
    h, w = sheet.shape[:2]
    xyw = np.array([(-0.5, -0.5, 1), (w - 0.5, -0.5, 1), (w - 0.5, h - 0.5, 1), (-0.5, h - 0.5, 1)]) @ H.T
    return xyw[:, :2] / xyw[:, 2:]


def rotation(vector: tuple[float, float, float]) -> Floats:
    return cv2.Rodrigues(np.array(vector, float))[0]


def put(image: Pixels, sheet: Pixels, H: Floats) -> None:
    """Lay a sheet over a picture where H says, averaged over the area of each px."""
    fine = 3
    area = abs(cv2.contourArea(corners(sheet, H).astype(np.float32))) / (sheet.shape[0] * sheet.shape[1])
    reduce = max(1.0, 1 / (fine * math.sqrt(area)))
    small = cv2.resize(sheet, None, fx=1 / reduce, fy=1 / reduce, interpolation=cv2.INTER_AREA)
    sx, sy = sheet.shape[1] / small.shape[1], sheet.shape[0] / small.shape[0]
    full_from_small = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])
    enlarged = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1.0]]) @ H @ full_from_small
    size = image.shape[1] * fine, image.shape[0] * fine
    colours = cv2.warpPerspective(small, enlarged, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mask = np.zeros(size[::-1], np.uint8)
    seen = corners(small, enlarged)
    cv2.fillConvexPoly(mask, np.rint(seen * 16).astype(np.int32), 255, cv2.LINE_AA, 4)
    share = cv2.resize(mask, image.shape[1::-1], interpolation=cv2.INTER_AREA)[..., None] / 255
    reduced = cv2.resize(colours, image.shape[1::-1], interpolation=cv2.INTER_AREA)
    image[:] = np.rint(share * reduced + (1 - share) * image)


def exposed(image: Pixels, look: Look, rng: np.random.Generator, stamp_ns: int) -> Frame:
    """Return the Bayer mosaic of a picture, 8 bits, linear in the light."""
    light = _linear()[image] * look.exposure
    light = cv2.GaussianBlur(light, (0, 0), look.blur_px)
    y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j].astype(np.float32)
    light *= (1 + look.shade[0] * x + look.shade[1] * y)[..., None]
    mosaic = light[..., 1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = light[::2, ::2, 0], light[1::2, 1::2, 2]
    mosaic += np.sqrt(np.maximum(mosaic, 0) / look.electrons + 1e-6) * rng.standard_normal(mosaic.shape, np.float32)
    raw = np.clip(np.rint(255 * mosaic), 0, 255).astype(np.uint8)
    camera = make_camera(K, [], "plumb_bob", WIDTH, HEIGHT)
    return Frame(RawImage(raw, _LAYOUT), stamp_ns, "camera", camera)


@lru_cache(maxsize=1)
def _linear() -> Floats:
    v = np.arange(256) / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _bits(rng: np.random.Generator, count: int, cell: int) -> Pixels:
    """Draw bits in a black border one cell wide and a white one around it."""
    bits = np.zeros((count + 2, count + 2), np.uint8)
    bits[1:-1, 1:-1] = rng.integers(0, 2, (count, count))
    whole = np.pad(255 * np.kron(bits, np.ones((cell, cell), np.uint8)), cell, constant_values=255)
    return np.repeat(whole[..., None], 3, axis=2)


def _letters(
    image: Pixels, text: str, at: tuple[float, float], size: float, ink: tuple[int, ...], font: int, thick: int = 1
) -> None:
    cv2.putText(image, text, _at(at), font, size, ink, thick, cv2.LINE_AA)


def _at(xy: tuple[float, float] | Floats) -> tuple[int, int]:
    return int(xy[0]), int(xy[1])


def _word(rng: np.random.Generator, least: int, most: int) -> str:
    return "".join(rng.choice(_LETTERS, int(rng.integers(least, most))))


def _digits(rng: np.random.Generator, count: int) -> str:
    return "".join(str(digit) for digit in rng.integers(0, 10, count))


def _colour(rng: np.random.Generator, high: int = 256, low: int = 0) -> tuple[int, int, int]:
    r, g, b = (int(v) for v in rng.integers(low, high, 3))
    return r, g, b
