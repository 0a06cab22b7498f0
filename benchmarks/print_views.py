# SPDX-License-Identifier: Apache-2.0
"""Views of a print by a renderer of its own, with their exact truth.

    python benchmarks/print_views.py --kinds poster --mode detection --out views/      # views as PNG files

`views(print, seed, n, mode)` yields frames of 640x480 with K and no lens distortion: raw RGGB of 10 bits with a black
level, as `RAW_PARAMETERS` says. Nothing of `imgu_ros.simulate` is used. A view is drawn in linear light, supersampled
and reduced by area, over a photograph with clutter; then come defocus, shading, channel gains, shot and read noise.

- `tracking`: one smooth path with 15 degrees of roll a frame, tilts up to 40 degrees, and changing distance.
- `detection`: independent views: any roll, tilts up to 55 degrees, 140 to 560 px of the longer side, every fourth one
  partly outside the frame, every fourth one behind a hand.
"""

from __future__ import annotations

import argparse
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from print_canvas import (
    Canvas,
    Pixels,
    background_photographs,
    blob,
    colour,
    cropped,
    fractal,
    landscape,
    mixed,
    palette,
    tinted,
    turned,
)
from print_drawing import KINDS, Print, prints

from imgu_ros.frame import Frame
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

Floats = NDArray[np.floating]

WIDTH, HEIGHT = 640, 480
FOCAL_PX = 600.0
K = np.array([[FOCAL_PX, 0, (WIDTH - 1) / 2], [0, FOCAL_PX, (HEIGHT - 1) / 2], [0, 0, 1]])
MODES = ("tracking", "detection")
ROLL_DEG = 15.0
RATE_HZ = 30.0
TILT_DEG = {"tracking": 40.0, "detection": 55.0}
#: Side of the print, the longer one, as it would be seen straight on, px.
SEEN_PX = {"tracking": (240.0, 330.0), "detection": (140.0, 560.0)}
#: Fewest of the print's area in the frame, and in view when it is behind a hand.
LEAST_INSIDE, LEAST_VISIBLE = 0.5, 0.45

#: The sensor: 10 bits, black level, electrons of a full pixel, read noise in electrons, gains of R, G and B.
BITS, BLACK_LEVEL, FULL_ELECTRONS, READ_ELECTRONS = 10, 64, 9000.0, 4.0
GAINS = (0.62, 1.0, 0.74)
#: Parameters of the pipeline for these frames: what the maker of a camera says of it.
RAW_PARAMETERS: dict[str, object] = {
    "raw.black_level": float(BLACK_LEVEL),
    "raw.white_level": float(2**BITS - 1),
    "raw.significant_bits": BITS,
    "raw.gains": [1 / gain for gain in GAINS],
}
_LAYOUT = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)

#: Supersampling of the print before it is reduced by area to `_SCENE` px a px, at which the scene is put together.
_FINE, _SCENE = 4, 2


@dataclass(frozen=True, eq=False)
class View:
    """A frame and its truth.

    Attributes
    ----------
    frame : raw pixels and camera
    H : (3, 3) px of the frame from px of the print, pixel centres at integers; None: no print is in view
    R, t : camera_from_target, the target's origin at its centre, x right, y up, z towards the viewer; m
    visible : share of the print's area that is inside the frame and not behind a hand
    occluded : whether a hand is before it
    tilt_deg : between the print's normal and the line of sight to its centre
    """

    frame: Frame
    H: Floats | None
    R: Floats | None
    t: Floats | None
    visible: float
    occluded: bool
    tilt_deg: float


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a print is: rotation, translation, m, and its tilt."""

    R: Floats
    t: Floats
    tilt_deg: float

    def homography(self, shown: Print) -> Floats:
        """Return px of the frame from px of the print, (3, 3)."""
        height, width = shown.pixels.shape[:2]
        scale = shown.width_m / width
        metres = np.array([[scale, 0, -scale * (width - 1) / 2], [0, -scale, scale * (height - 1) / 2], [0, 0, 1]])
        H = K @ np.column_stack((self.R[:, 0], self.R[:, 1], self.t)) @ metres
        return H / H[2, 2]


def views(shown: Print, seed: int, n: int, mode: str) -> Iterator[View]:
    """Yield n views of a print; the same seed gives the same views.

    Parameters
    ----------
    shown : the print
    seed : of path, background, light and noise
    n : number of views
    mode : `tracking` (one path) or `detection` (independent views)
    """
    if mode not in MODES:
        raise ValueError(f"mode: {mode}; need {' or '.join(MODES)}")
    rng = np.random.default_rng([seed, zlib.crc32(f"{shown.kind} {mode}".encode())])
    if mode == "tracking":
        scene, light = background(rng), Light.drawn(rng)
        for index, placement in enumerate(path(shown, rng, n)):
            yield rendered(shown, placement, scene, light, rng, index)
        return
    for index in range(n):
        yield rendered(
            shown, _detection_placement(shown, rng, partial=index % 4 == 2), background(rng), Light.drawn(rng), rng,
            30 * index, hand=index % 4 == 3,
        )  # fmt: skip


def empty_views(seed: int, n: int) -> Iterator[View]:
    """Yield views without any print: photographs and clutter, half of them with other sheets of paper."""
    rng = np.random.default_rng([seed, zlib.crc32(b"empty")])
    for index in range(n):
        scene = background(rng, sheets=int(rng.integers(0, 4)) if index % 2 else 0)
        yield View(exposed(scene, Light.drawn(rng), rng, 30 * index), None, None, None, 0.0, False, 0.0)


def corners_of(shown: Print) -> Floats:
    """Return the outer corners, (4, 2) px of the print: top left, top right, bottom right, bottom left."""
    height, width = shown.pixels.shape[:2]
    right, bottom = width - 0.5, height - 0.5
    return np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])


def mapped(H: Floats, points: Floats) -> Floats:
    """Map points (N, 2) by a homography."""
    xyw = np.column_stack((points, np.ones(len(points)))) @ H.T
    return xyw[:, :2] / xyw[:, 2:]


# Placements


def path(shown: Print, rng: np.random.Generator, n: int) -> Iterator[Placement]:
    """Yield the placements of a smooth path."""
    roll = rng.uniform(0, 2 * math.pi)
    way = rng.choice([-1, 1]) * math.radians(ROLL_DEG)
    phases, rates = rng.uniform(0, 2 * math.pi, 5), rng.uniform(0.06, 0.14, 5)
    # The first frame shows the print not too oblique: most tilts are in the middle of the path.
    low, high = SEEN_PX["tracking"]
    most = math.radians(TILT_DEG["tracking"])
    for index in range(n):
        wave = np.sin(phases + rates * index)
        tilt = most * (0.35 + 0.65 * math.sin(math.pi * index / max(n - 1, 1)) ** 2)
        seen = 0.5 * (low + high) + 0.5 * (high - low) * wave[0]
        at = np.array((WIDTH, HEIGHT)) * (0.5 + 0.08 * wave[1:3])
        yield placed(shown, seen, tilt, 2 * wave[3] + phases[4], roll + way * index, at)


def _detection_placement(shown: Print, rng: np.random.Generator, partial: bool) -> Placement:
    low, high = SEEN_PX["detection"]
    while True:
        seen = math.exp(rng.uniform(math.log(low), math.log(high)))
        tilt = math.radians(rng.uniform(0, TILT_DEG["detection"]))
        angles, at = rng.uniform(0, 2 * math.pi, 2), rng.uniform((0, 0), (WIDTH, HEIGHT))
        placement = placed(shown, seen, tilt, *angles, at)
        inside = inside_share(placement.homography(shown), shown)
        if LEAST_INSIDE <= inside < 0.9 if partial else inside > 0.999:
            return placement


def placed(shown: Print, seen_px: float, tilt: float, axis: float, roll: float, at: Floats) -> Placement:
    """Return a placement.

    Parameters
    ----------
    shown : the print
    seen_px : its longer side, were it straight on
    tilt, axis : angle between its normal and the line of sight, and the direction about which it is tilted, rad
    roll : in the image, rad
    at : (2,) px of its centre
    """
    height, width = shown.pixels.shape[:2]
    longer_m = shown.width_m * max(width, height) / width
    ray = np.linalg.solve(K, np.array((*at, 1.0)))
    t = ray * (FOCAL_PX * longer_m / seen_px)
    # Facing the camera: x right, y up, z towards it.
    facing = np.diag((1.0, -1.0, -1.0))
    toward = _between(np.array((0, 0, 1.0)), ray / np.linalg.norm(ray))
    R = (
        toward
        @ _about(np.array((math.cos(axis), math.sin(axis), 0.0)), tilt)
        @ _about(np.array((0, 0, 1.0)), roll)
        @ facing
    )
    return Placement(R, t, math.degrees(tilt))


def _about(axis: Floats, angle: float) -> Floats:
    return cv2.Rodrigues(np.asarray(axis, float) * angle)[0]


def _between(a: Floats, b: Floats) -> Floats:
    """Return the smallest rotation that takes one unit vector to another."""
    axis, cosine = np.cross(a, b), float(a @ b)
    length = float(np.linalg.norm(axis))
    return np.eye(3) if length < 1e-12 else _about(axis / length, math.atan2(length, cosine))


def inside_share(H: Floats, shown: Print) -> float:
    """Return the share of the print's area that the frame shows, about."""
    height, width = shown.pixels.shape[:2]
    x, y = np.meshgrid(np.linspace(0, width - 1, 25), np.linspace(0, height - 1, 25))
    seen = mapped(H, np.column_stack((x.ravel(), y.ravel())))
    return float(((seen >= 0) & (seen <= (WIDTH - 1, HEIGHT - 1))).all(axis=1).mean())


# Drawing


@dataclass(frozen=True)
class Light:
    """Exposure, shading, colour of the light, and defocus of one view.

    Attributes
    ----------
    exposure : raw share of full scale at a white sheet
    slope : (2,) relative change of brightness over half the frame
    vignette : relative loss in the corners
    tint : of red, green and blue
    defocus_px : standard deviation of the blur
    """

    exposure: float
    slope: tuple[float, float]
    vignette: float
    tint: tuple[float, float, float]
    defocus_px: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Light:
        """Draw a light by chance."""
        slope, tint = rng.uniform(-0.25, 0.25, 2), rng.uniform(0.93, 1.0, 3)
        return cls(
            float(rng.uniform(0.5, 0.8)), (float(slope[0]), float(slope[1])), float(rng.uniform(0.05, 0.25)),
            (float(tint[0]), float(tint[1]), float(tint[2])), float(rng.uniform(0.3, 0.8)),
        )  # fmt: skip


def rendered(
    shown: Print,
    placement: Placement,
    scene: Floats,
    light: Light,
    rng: np.random.Generator,
    index: int,
    hand: bool = False,
) -> View:
    """Return the view of a print in a scene."""
    H = placement.homography(shown)
    scene = scene.copy()
    cover = put_print(scene, shown.pixels, H)
    visible = cover
    if hand:
        for _ in range(20):
            before = _hand(rng, mapped(H, corners_of(shown)))
            left = cover * (1 - before[0])
            if LEAST_VISIBLE * cover.sum() <= left.sum() <= 0.92 * cover.sum():
                break
        else:
            before, left = (np.zeros_like(cover), np.zeros(3)), cover
        scene += before[0][..., None] * (before[1] - scene)
        visible = left
    whole = abs(cv2.contourArea(mapped(H, corners_of(shown)).astype(np.float32)))
    share = min(float(visible.sum()) / _SCENE**2 / whole, 1.0)
    frame = exposed(scene, light, rng, index)
    return View(frame, H, placement.R, placement.t, share, hand, placement.tilt_deg)


def put_print(scene: Floats, pixels: Pixels, H: Floats) -> Floats:
    """Draw a print into a scene, where H puts it in the frame; return the share of each px that it covers."""
    height, width = pixels.shape[:2]
    outline = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    seen = mapped(H, outline)
    low = np.clip(np.floor(seen.min(axis=0)) - 2, 0, (WIDTH, HEIGHT)).astype(int)
    high = np.clip(np.ceil(seen.max(axis=0)) + 3, 0, (WIDTH, HEIGHT)).astype(int)
    cover = np.zeros(scene.shape[:2], np.float32)
    w, h = high - low
    if min(w, h) <= 0:
        return cover
    image = linear(pixels)
    # Where several px of the print fall on one sample they are averaged first.
    area = abs(cv2.contourArea(seen.astype(np.float32))) / (width * height)
    factor = max(int(1 / (_FINE * math.sqrt(max(area, 1e-9)))), 1)
    sample_from_frame = np.array(
        [[_FINE, 0, (_FINE - 1) / 2 - _FINE * low[0]], [0, _FINE, (_FINE - 1) / 2 - _FINE * low[1]], [0, 0, 1]]
    )
    print_from_reduced = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1]])
    if factor > 1:
        bottom, right = -height % factor, -width % factor
        image = cv2.copyMakeBorder(image, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
        image = cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    size = int(w * _FINE), int(h * _FINE)
    fine = cv2.warpPerspective(
        image, sample_from_frame @ H @ print_from_reduced, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    mask = np.zeros((size[1], size[0]), np.uint8)
    at = mapped(sample_from_frame, seen)
    cv2.fillConvexPoly(mask, np.rint(at * 256).astype(np.int32), 255, cv2.LINE_AA, 8)
    reduced = int(w * _SCENE), int(h * _SCENE)
    part = np.s_[low[1] * _SCENE : high[1] * _SCENE, low[0] * _SCENE : high[0] * _SCENE]
    alpha = cv2.resize(mask.astype(np.float32) / 255, reduced, interpolation=cv2.INTER_AREA)
    colours = cv2.resize(fine, reduced, interpolation=cv2.INTER_AREA)
    scene[part] += alpha[..., None] * (colours - scene[part])
    cover[part] = alpha
    return cover


def background(rng: np.random.Generator, sheets: int | None = None) -> Floats:
    """Return a photograph, mostly with clutter before it: (H, W, 3) linear light, `_SCENE` px a px of the frame."""
    known, size = background_photographs(), (WIDTH, HEIGHT)
    if known:
        image = cropped(rng, known[int(rng.integers(len(known)))], *size)
    else:
        image = landscape(rng, *size) if rng.random() < 0.5 else _table_top(rng)
    scene = linear(cv2.resize(image, None, fx=_SCENE, fy=_SCENE, interpolation=cv2.INTER_CUBIC))
    for _ in range(int(rng.integers(0, 5)) if sheets is None else sheets):
        _put_sheet(scene, rng)
    if rng.random() < 0.6:
        _put_clutter(scene, rng)
    return scene


def _table_top(rng: np.random.Generator) -> Pixels:
    grey = 0.5 + 0.12 * fractal(rng, WIDTH, HEIGHT, 100)
    return tinted(grey, mixed(colour(rng, 0.3), (0, 0, 0), 0.3), mixed(colour(rng, 0.8), (255, 255, 255), 0.5))


def _put_sheet(scene: Floats, rng: np.random.Generator) -> None:
    """Put a sheet of another kind than the prints into a scene: lines as of text, and blocks."""
    sheet = Canvas(300, 400, mixed((250, 250, 247), colour(rng, 0.9), rng.uniform(0, 0.5)))
    ink = colour(rng, 0.1, 0.5)
    for row in range(int(rng.integers(4, 16))):
        x = 30.0
        while x < 250:
            length = rng.uniform(10, 60)
            sheet.rectangle(x, 30 + 22 * row, length, 9, ink)
            x += length + 9
    if rng.random() < 0.6:
        sheet.rectangle(*rng.uniform((30, 30), (120, 200)), *rng.uniform(50, 150, 2), colour(rng, 0.4, 0.9))
    size = rng.uniform(0.3, 0.9)
    corners = np.array([(-150, -200), (150, -200), (150, 200), (-150, 200)]) * size
    corners = turned(corners, rng.uniform(0, 6)) * rng.uniform(0.6, 1, 2) + rng.uniform((0, 0), (WIDTH, HEIGHT))
    pixels = sheet.pixels()
    source = np.array([(-0.5, -0.5), (299.5, -0.5), (299.5, 399.5), (-0.5, 399.5)], np.float32)
    put_print(scene, pixels, cv2.getPerspectiveTransform(source, corners.astype(np.float32)))


def _put_clutter(scene: Floats, rng: np.random.Generator) -> None:
    """Put some things of one colour each, shaded, into a scene."""
    tones = palette(rng, 5)
    for _ in range(int(rng.integers(2, 8))):
        shape = turned(blob(rng, 0.2) * rng.uniform(15, 70, 2), rng.uniform(0, 6)) + rng.uniform(
            (0, 0), (WIDTH, HEIGHT)
        )
        _fill(scene, shape, linear(np.array([[tones[int(rng.integers(5))]]], np.uint8))[0, 0], rng)


def _fill(scene: Floats, shape: Floats, tone: Floats, rng: np.random.Generator) -> None:
    slope = 1 + 0.4 * rng.uniform(-1, 1) * np.linspace(-1, 1, scene.shape[1], dtype=np.float32)
    at = (np.asarray(shape) + 0.5) * _SCENE - 0.5
    low = np.clip(np.floor(at.min(axis=0)).astype(int) - 1, 0, scene.shape[1::-1])
    high = np.clip(np.ceil(at.max(axis=0)).astype(int) + 2, 0, scene.shape[1::-1])
    if (high <= low).any():
        return
    mask = np.zeros((high[1] - low[1], high[0] - low[0]), np.uint8)
    cv2.fillPoly(mask, [np.rint((at - low) * 256).astype(np.int32)], 255, cv2.LINE_AA, 8)
    part = scene[low[1] : high[1], low[0] : high[0]]
    shaded = np.asarray(tone, np.float32) * slope[None, low[0] : high[0], None]
    part += (mask.astype(np.float32) / 255)[..., None] * (shaded - part)


def _mask(shapes: list[Floats]) -> Floats:
    """Return the antialiased union of closed curves given in px of the frame, at the scene's resolution."""
    mask = np.zeros((HEIGHT * _SCENE, WIDTH * _SCENE), np.uint8)
    for shape in shapes:
        at = (np.asarray(shape) + 0.5) * _SCENE - 0.5
        cv2.fillPoly(mask, [np.rint(at * 256).astype(np.int32)], 255, cv2.LINE_AA, 8)
    return mask.astype(np.float32) / 255


def _hand(rng: np.random.Generator, corners: Floats) -> tuple[Floats, Floats]:
    """Return a hand that reaches over the edge of a print: its cover, (H, W), and its colours, (H, W, 3)."""
    centre = corners.mean(axis=0)
    reach = math.sqrt(abs(cv2.contourArea(corners.astype(np.float32))))
    size = rng.uniform(0.28, 0.5) * reach
    angle = rng.uniform(0, 2 * math.pi)
    outward = np.array((math.cos(angle), math.sin(angle)))
    palm = centre + outward * rng.uniform(0.35, 0.65) * reach
    shapes = [turned(blob(rng, 0.1) * (0.6 * size, 0.5 * size), angle) + palm]
    arm = np.array([(0, -0.42), (5, -0.5), (5, 0.5), (0, 0.42)]) * size
    shapes.append(turned(arm, angle) + palm)
    for finger in range(4):
        turn = angle + math.pi + (finger - 1.5) * 0.3 + rng.normal(0, 0.06)
        length = size * rng.uniform(0.75, 1.1)
        rod = np.array([(0, -0.13), (0.9, -0.11), (1, 0), (0.9, 0.11), (0, 0.13)]) * (length, size)
        start = palm + size * 0.42 * turned(np.array([(-1.0, 0.7 * (1.5 - finger))]), angle)[0]
        shapes.append(turned(rod, turn) + start)
    mask = _mask(shapes)
    skin = np.array(rng.choice([(224, 172, 140), (198, 134, 100), (141, 85, 60), (92, 58, 42)]), np.uint8)
    fold = 1 + 0.1 * fractal(rng, mask.shape[1] // 4, mask.shape[0] // 4, 24)
    fold = cv2.resize(fold, mask.shape[::-1], interpolation=cv2.INTER_LINEAR)
    depth = cv2.GaussianBlur(mask, None, 8)
    return mask, (linear(skin[None, None])[0, 0] * (fold * (0.4 + 0.6 * depth))[..., None]).astype(np.float32)


# Light and sensor


def linear(pixels: Pixels) -> Floats:
    """Return sRGB values as linear light, float32, 0 to 1."""
    v = np.arange(256) / 255
    table = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4).astype(np.float32)
    return table[pixels]


def exposed(scene: Floats, light: Light, rng: np.random.Generator, index: int) -> Frame:
    """Return the raw frame of a scene."""
    blurred = cv2.GaussianBlur(scene, None, light.defocus_px * _SCENE)
    image = cv2.resize(blurred, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j].astype(np.float32)
    shade = (1 + light.slope[0] * x + light.slope[1] * y) * (1 - light.vignette * (x * x + y * y) / 2)
    image *= (light.exposure * shade)[..., None] * np.array(GAINS, np.float32) * np.array(light.tint, np.float32)
    mosaic = np.empty((HEIGHT, WIDTH), np.float32)
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        mosaic[row::2, column::2] = image[row::2, column::2, channel]
    mean = np.maximum(mosaic, 0) * np.float32(FULL_ELECTRONS)
    # Shot and read noise; that of the few darkest sites is Poisson's only about.
    deviation = np.sqrt(mean + np.float32(READ_ELECTRONS**2))
    electrons = mean + deviation * rng.standard_normal(mosaic.shape, np.float32)
    white = 2**BITS - 1
    values = BLACK_LEVEL + electrons / FULL_ELECTRONS * (white - BLACK_LEVEL)
    raw = np.clip(np.rint(values), 0, white).astype(np.uint16)
    return Frame(RawImage(raw, _LAYOUT), 1_000_000_000 + round(index * 1e9 / RATE_HZ), "camera", camera())


def camera() -> Camera:
    return make_camera(K, [], "plumb_bob", WIDTH, HEIGHT)


def developed(frame: Frame) -> Pixels:
    """Return a frame in colour for people and for the OpenCV recipes: black level, gains, demosaicking, sRGB."""
    raw = frame.image.pixels.astype(np.float32) - BLACK_LEVEL
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        raw[row::2, column::2] /= GAINS[channel]
    scaled = np.clip(raw / (2**BITS - 1 - BLACK_LEVEL), 0, 1)
    colours = cv2.cvtColor(np.rint(scaled * 65535).astype(np.uint16), cv2.COLOR_BayerBG2RGB)
    return _display_table()[colours]


@lru_cache(maxsize=1)
def _display_table() -> Pixels:
    """Return the sRGB value, 8 bits, of each linear one of 16 bits."""
    v = np.arange(65536) / 65535
    return np.rint(255 * np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)).astype(np.uint8)


def drawn_over(view: View, shown: Print) -> Pixels:
    """Return a view in colour with the print's true outline."""
    image = developed(view.frame)
    if view.H is not None:
        corners = np.rint(mapped(view.H, corners_of(shown)) * 16).astype(np.int32)
        cv2.polylines(image, [corners], True, (255, 0, 255), 1, cv2.LINE_AA, 4)
    return image


def main() -> None:
    """Write views as PNG files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", default=KINDS, help="of prints (default all)")
    parser.add_argument("--mode", choices=MODES, default="detection")
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--out", type=Path, required=True, help="folder")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for shown in prints(arguments.seed, arguments.kinds):
        for index, view in enumerate(views(shown, arguments.seed, arguments.views, arguments.mode)):
            path_of = arguments.out / f"{shown.name}_{arguments.mode}_{index:02d}.png"
            cv2.imwrite(str(path_of), drawn_over(view, shown)[..., ::-1])


if __name__ == "__main__":
    main()
