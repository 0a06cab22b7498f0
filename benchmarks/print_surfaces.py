# SPDX-License-Identifier: Apache-2.0
"""Prints and surfaces full of detail: floors, brushed metal, maps, circuit boards, photographs, halftone, drawings."""

from __future__ import annotations

import math
from itertools import pairwise

import cv2
import numpy as np
from print_canvas import (
    BLACK,
    WHITE,
    Canvas,
    Pixels,
    blob,
    colour,
    digits,
    fractal,
    mixed,
    noise,
    palette,
    picture,
    tinted,
    title,
    turned,
    words,
)


def wood(rng: np.random.Generator) -> Pixels:
    """Draw planks with grain and knots."""
    w, h, count = 800, 640, int(rng.integers(3, 6))
    image = np.zeros((h, w, 3), np.uint8)
    edges = np.linspace(0, h, count + 1).astype(int)
    dark, light = mixed((92, 52, 24), BLACK, rng.uniform(0, 0.3)), mixed((205, 160, 105), WHITE, rng.uniform(0, 0.3))
    for top, bottom in pairwise(edges):
        high = bottom - top
        y, x = np.mgrid[0:high, 0:w].astype(np.float32)
        bend = 12 * noise(rng, w, high, w / 3, high)
        for _ in range(int(rng.integers(0, 3))):
            knot = rng.uniform((0, 0.2 * high), (w, 0.8 * high))
            far = np.hypot((x - knot[0]) / 2.5, y - knot[1])
            bend += 26 * np.exp(-((far / 16) ** 2)) * np.sign(y - knot[1])
        rings = np.sin((y + bend) / rng.uniform(2.2, 4) + 2 * noise(rng, w, high, w / 4, high / 6))
        grain = 0.5 + 0.2 * rings + 0.12 * noise(rng, w, high, 60, 1.5) + 0.1 * noise(rng, w, high, w, high)
        image[top:bottom] = tinted(grain + rng.uniform(-0.15, 0.15), dark, light)
        image[max(bottom - 2, 0) : bottom] = mixed(dark, BLACK, 0.6)
        joint = int(rng.uniform(0.1, 0.9) * w)
        image[top:bottom, joint : joint + 2] = mixed(dark, BLACK, 0.6)
    return image


def terrazzo(rng: np.random.Generator) -> Pixels:
    """Draw chips of stone in cement."""
    ground = mixed((205, 200, 192), colour(rng, 0.7), 0.15)
    canvas, tones = Canvas(720, 720, ground), palette(rng, 5)
    for _ in range(int(rng.integers(350, 700))):
        chip = turned(blob(rng, 0.35, 9) * (1, rng.uniform(0.5, 1)), rng.uniform(0, 6)) * rng.gamma(2.0, 6.0)
        tone = mixed(tones[int(rng.integers(5))], (150, 140, 130), rng.uniform(0.2, 0.8))
        canvas.polygon(chip + rng.uniform(0, 720, 2), tone)
    return _grained(rng, canvas.pixels(), 3)


def carpet(rng: np.random.Generator) -> Pixels:
    """Draw woven yarn of a few colours."""
    w, h = 720, 600
    y, x = np.mgrid[0:h, 0:w]
    step = int(rng.integers(5, 9))
    weave = 0.5 + 0.5 * np.abs(np.sin(np.pi * x / step) * np.sin(np.pi * y / step))
    yarn = noise(rng, w // step + 1, h // step + 1, 1, 1)
    yarn = np.kron(yarn, np.ones((step, step), np.float32))[:h, :w]
    pattern = noise(rng, w, h, rng.uniform(40, 90), rng.uniform(40, 90)) > 0.3
    a, b = (mixed(colour(rng, 0.3, 0.7), (128, 128, 128), 0.5) for _ in range(2))
    base = np.where(pattern[..., None], np.array(a), np.array(b)) * (weave * (1 + 0.22 * yarn))[..., None]
    return _grained(rng, np.clip(base, 0, 255).astype(np.uint8), 8)


def concrete(rng: np.random.Generator) -> Pixels:
    """Draw cement with stains, pores and a crack."""
    w, h = 760, 620
    stains = 0.55 + 0.1 * fractal(rng, w, h, 200, 0.65)
    canvas = Canvas(w, h)
    canvas.paste(tinted(stains, (70, 70, 68), (200, 198, 192)), 0, 0, w, h)
    for _ in range(int(rng.integers(60, 160))):
        where, size = rng.uniform((0, 0), (w, h)), rng.gamma(1.5, 1.2) + 0.5
        canvas.ellipse(*where, size, 0.8 * size, (72, 70, 68))
    crack = np.cumsum(rng.normal((8, 0), (3, 7), (120, 2)), axis=0) + (0, rng.uniform(0.2, 0.8) * h)
    canvas.line(crack, (60, 58, 56), 2)
    return _grained(rng, canvas.pixels(), 5)


def asphalt(rng: np.random.Generator) -> Pixels:
    """Draw small stones in tar."""
    w, h = 700, 620
    stones = fractal(rng, w, h, 7, 0.9)
    grey = 0.35 + 0.16 * stones + 0.05 * fractal(rng, w, h, 200)
    image = tinted(grey, (30, 30, 32), (170, 168, 164))
    bright = noise(rng, w, h, 3.5, 3.5) > 2.1
    image[bright] = np.clip(image[bright] * 1.5 + 30, 0, 255).astype(np.uint8)
    return image


def brushed_surface(rng: np.random.Generator) -> Pixels:
    """Draw brushed metal: streaks along one direction, and scratches across."""
    w, h = 760, 560
    streaks = (
        0.6 + 0.1 * noise(rng, w, h, 160, 1.2) + 0.07 * noise(rng, w, h, 60, 2.5) + 0.08 * noise(rng, w, h, 400, 200)
    )
    canvas = Canvas(w, h)
    canvas.paste(tinted(streaks, (70, 74, 80), (225, 228, 232)), 0, 0, w, h)
    for _ in range(int(rng.integers(4, 12))):
        start, along = rng.uniform((0, 0), (w, h)), rng.normal(0, 90, 2)
        canvas.line([tuple(start), tuple(start + along)], (232, 234, 236), 1.2)
    return _grained(rng, canvas.pixels(), 4)


def street_map(rng: np.random.Generator) -> Pixels:
    """Draw roads, water, parks, buildings and names."""
    w, h = 800, 640
    canvas = Canvas(w, h, (242, 238, 230))
    for _ in range(4):
        canvas.polygon(blob(rng) * rng.uniform(60, 140) + rng.uniform((0, 0), (w, h)), (200, 226, 180))
    river = np.column_stack((np.linspace(-20, w + 20, 80), rng.uniform(0.2, 0.8) * h + np.cumsum(rng.normal(0, 7, 80))))
    canvas.line(river, (160, 200, 232), 34)
    angle, roads = rng.uniform(0, math.pi), []
    for _ in range(int(rng.integers(16, 26))):
        at, turn = rng.uniform((0, 0), (w, h)), angle + rng.choice([0, math.pi / 2]) + rng.normal(0, 0.12)
        reach = rng.uniform(150, 900) * np.array((math.cos(turn), math.sin(turn)))
        bend = at + rng.normal(0, 22, 2)
        roads.append(([tuple(at - reach), tuple(bend), tuple(at + reach)], float(rng.choice([6, 6, 9, 15])), turn, at))
    for points, width, _, _ in roads:
        canvas.line(points, (176, 168, 158), width + 3)
    for points, width, _, _ in roads:
        canvas.line(points, (250, 214, 120) if width > 9 else WHITE, width)
    for _ in range(150):
        size, at = rng.uniform(7, 20, 2), rng.uniform((0, 0), (w, h))
        box = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size
        canvas.polygon(turned(box, angle) + at, (216, 204, 192))
    for _, _, _, at in roads:
        canvas.text(
            *at, f"{title(rng, 1)} {rng.choice(['St', 'Rd', 'Ave', 'Ln'])}", float(rng.uniform(12, 19)), (70, 66, 62)
        )
    for _ in range(6):
        at = rng.uniform((20, 20), (w - 20, h - 20))
        canvas.ellipse(*at, 9, 9, colour(rng, 0.6, 0.9), WHITE, 2)
    return canvas.pixels()


def circuit_board(rng: np.random.Generator) -> Pixels:
    """Draw traces, pads, chips and their names."""
    w, h = 760, 580
    ground = mixed((18, 88, 46), colour(rng, 0.3, 0.5), 0.2)
    canvas, trace, pad = Canvas(w, h, ground), mixed(ground, WHITE, 0.22), (214, 190, 120)
    for _ in range(int(rng.integers(60, 100))):
        at, points = rng.integers(1, 58, 2) * 10.0, []
        for _ in range(int(rng.integers(3, 6))):
            points.append(tuple(at))
            turn = math.pi / 4 * rng.integers(8)
            at = at + rng.uniform(20, 110) * np.array((math.cos(turn), math.sin(turn)))
        points = [(x * w / 580, y) for x, y in points]
        canvas.line(points, trace, float(rng.choice([3, 4, 7])))
        canvas.ellipse(*points[0], 6, 6, pad)
        canvas.ellipse(*points[0], 2.5, 2.5, BLACK)
    for number in range(int(rng.integers(4, 8))):
        x, y = rng.uniform((30, 30), (w - 170, h - 130))
        cw, ch = rng.uniform(50, 130), rng.uniform(45, 100)
        for pin in np.arange(8, cw - 8, 12):
            canvas.rectangle(x + pin, y - 9, 6, 9, pad)
            canvas.rectangle(x + pin, y + ch, 6, 9, pad)
        canvas.rectangle(x, y, cw, ch, (28, 28, 30))
        canvas.text(
            x + 6, y + ch / 2, f"{words(rng, 1)[0][:2].upper()}{digits(rng, 3)}", 15, (190, 190, 190), anchor="lm"
        )
        canvas.text(x, y - 26, f"U{number}", 14, WHITE)
    for number in range(int(rng.integers(20, 34))):
        x, y = rng.uniform((10, 10), (w - 50, h - 30))
        canvas.rectangle(x, y, 8, 12, pad)
        canvas.rectangle(x + 20, y, 8, 12, pad)
        canvas.rectangle(x + 7, y + 1, 14, 10, BLACK if rng.random() < 0.5 else (150, 110, 70))
        canvas.text(x, y - 14, f"{rng.choice(['R', 'C', 'L'])}{number}", 11, WHITE)
    return canvas.pixels()


def photograph(rng: np.random.Generator) -> Pixels:
    return picture(rng, 768, 512)


def halftone(rng: np.random.Generator) -> Pixels:
    """Draw a picture by black dots on a slanting grid, larger where it is darker."""
    w, h, step = 720, 540, float(rng.uniform(9, 14))
    grey = cv2.cvtColor(picture(rng, w, h), cv2.COLOR_RGB2GRAY)
    grey = cv2.createCLAHE(2.0, (4, 4)).apply(grey)
    canvas = Canvas(w, h)
    tone = BLACK if rng.random() < 0.6 else colour(rng, 0.2, 0.5)
    count = int(math.hypot(w, h) / step) // 2 + 1
    for row in range(-count, count):
        for column in range(-count, count):
            x, y = turned(np.array([(column * step, row * step)]), math.pi / 4)[0] + (w / 2, h / 2)
            if 0 <= x < w and 0 <= y < h:
                radius = 0.62 * step * math.sqrt(1 - grey[int(y), int(x)] / 255)
                canvas.ellipse(x, y, radius, radius, tone)
    return canvas.pixels()


def line_art(rng: np.random.Generator) -> Pixels:
    """Draw figures, hatching and foliage by thin lines."""
    w, h = 700, 700
    canvas = Canvas(w, h)
    for _ in range(int(rng.integers(7, 12))):
        at, size = rng.uniform(80, 620, 2), rng.uniform(40, 140)
        shape = blob(rng, 0.3) * size + at
        canvas.polygon(shape, WHITE)
        canvas.line([*map(tuple, shape), tuple(shape[0])], BLACK, 2.5)
        if rng.random() < 0.7:
            slant = rng.uniform(0, math.pi)
            for offset in np.arange(-0.7 * size, 0.7 * size, rng.uniform(6, 11)):
                half = math.sqrt(max((0.6 * size) ** 2 - offset**2, 0))
                ends = turned(np.array([(-half, offset), (half, offset)]), slant) + at
                canvas.line([*map(tuple, ends)], BLACK, 1.2)
    for _ in range(int(rng.integers(4, 8))):
        x = np.linspace(0, 1, 50)
        start, end = rng.uniform(0, 700, (2, 2))
        curve = start + (end - start) * x[:, None] + 40 * np.sin(rng.uniform(4, 14) * x)[:, None]
        canvas.line(curve, BLACK, 2)
    return canvas.pixels()


def comic(rng: np.random.Generator) -> Pixels:
    """Draw panels with flat figures in black outlines and speech balloons."""
    w, h = 660, 880
    canvas = Canvas(w, h)
    y = 20.0
    for high in (260, 290, 270):
        split = rng.uniform(0.35, 0.65) * 620
        for x, wide in ((20.0, split - 6), (26 + split, 614 - split)):
            panel = Canvas(int(wide), high, colour(rng, 0.7, 1.0))
            panel.polygon(
                [(0, 0.7 * high), (wide, rng.uniform(0.5, 0.9) * high), (wide, high), (0, high)], colour(rng, 0.4, 0.8)
            )
            for _ in range(int(rng.integers(1, 4))):
                at, size = np.array((rng.uniform(0.2, 0.8) * wide, rng.uniform(0.55, 0.8) * high)), rng.uniform(35, 70)
                shape = blob(rng, 0.25) * (0.8 * size, size) + at
                panel.polygon(shape, colour(rng, 0.3, 1.0))
                panel.line([*map(tuple, shape), tuple(shape[0])], BLACK, 4)
                for side in (-0.25, 0.2):
                    panel.ellipse(at[0] + side * size, at[1] - 0.3 * size, 8, 10, WHITE, BLACK, 2)
                    panel.ellipse(at[0] + side * size + 2, at[1] - 0.3 * size, 3, 4, BLACK)
            text = " ".join(words(rng, 3)).upper()
            panel.ellipse(wide / 2, 45, 0.42 * wide, 34, WHITE, BLACK, 2.5)
            panel.text(wide / 2, 45, text, min(17, wide / len(text)), BLACK, "oblique", "mm")
            canvas.paste(panel.pixels(), x, y, wide, high)
            canvas.rectangle(x, y, wide, high, None, BLACK, 4)
        y += high + 12
    return canvas.pixels()


def _grained(rng: np.random.Generator, pixels: Pixels, deviation: float) -> Pixels:
    grain = rng.normal(0, deviation, pixels.shape[:2])[..., None]
    return np.clip(pixels + grain, 0, 255).astype(np.uint8)
