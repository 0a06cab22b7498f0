# SPDX-License-Identifier: Apache-2.0
"""Prints of flat shapes: logos, silhouettes, symmetric signs, periodic patterns, calibration boards."""

from __future__ import annotations

import math

import numpy as np
from print_canvas import (
    BLACK,
    WHITE,
    Canvas,
    Colour,
    Floats,
    Pixels,
    blob,
    colour,
    digits,
    draw_barcode,
    mixed,
    palette,
    star,
    tag_bits,
    title,
    turned,
    words,
)


def logo(rng: np.random.Generator) -> Pixels:
    """Draw a few flat shapes in two or three colours, and mostly a word."""
    canvas = Canvas(700, 560)
    dark, middle, light = palette(rng, 3)
    centre = np.array((350, 230))
    form = int(rng.integers(4))
    if form == 0:
        canvas.ellipse(*centre, 180, 180, dark)
        canvas.polygon(turned(star(5, 0.45) * 150, rng.uniform(0, 6)) + centre + (20, -10), light)
        canvas.ellipse(centre[0] - 60, centre[1] + 70, 50, 50, middle)
    elif form == 1:
        for index, tone in enumerate((dark, middle, light)):
            leaf = np.array([(0, 0), (60, -70), (40, -190), (-50, -120)], float)
            canvas.polygon(turned(leaf, 2.3 * index + rng.uniform(-0.3, 0.3)) + centre, tone)
    elif form == 2:
        canvas.polygon(blob(rng, 0.3) * 190 + centre, dark)
        canvas.polygon(blob(rng, 0.3) * 90 + centre + rng.uniform(-50, 50, 2), light)
    else:
        canvas.rectangle(180, 70, 340, 320, dark, radius=60)
        canvas.arc(*centre, 110, rng.uniform(0, 90), rng.uniform(200, 330), light, 46)
        canvas.ellipse(*(centre + rng.uniform(-60, 60, 2)), 36, 36, middle)
    if rng.random() < 0.7:
        canvas.text(350, 500, str(words(rng, 1)[0]).upper(), 84, dark, "bold", "mm")
    return canvas.pixels()


def silhouette(rng: np.random.Generator) -> Pixels:
    """Draw the outline of a plant, a range of mountains with trees, or a rounded figure, filled with one colour."""
    canvas = Canvas(600, 700, mixed(WHITE, colour(rng, 0.9), 0.15))
    dark = colour(rng, 0.1, 0.3)
    form = int(rng.integers(3))
    if form == 0:
        _branch(canvas, rng, np.array((300.0, 680.0)), -math.pi / 2, 170.0, 34.0, dark)
    elif form == 1:
        x = np.linspace(0, 600, 200)
        ridge = (
            420 + 90 * np.sin(x / rng.uniform(60, 110) + rng.uniform(0, 6)) + 40 * np.sin(x / 31 + rng.uniform(0, 6))
        )
        canvas.polygon([(0, 700), *zip(x, ridge, strict=True), (600, 700)], dark)
        for left in rng.uniform(30, 570, 7):
            top, height = float(np.interp(left, x, ridge)), rng.uniform(80, 200)
            for step in range(3):
                y, w = top - height * (0.3 + 0.25 * step), height * (0.3 - 0.07 * step)
                canvas.polygon([(left - w, y + 0.4 * height), (left + w, y + 0.4 * height), (left, y - 20)], dark)
    else:
        body = blob(rng, 0.2) * (150, 190) + (300, 430)
        canvas.polygon(body, dark)
        head = np.array((300 + rng.uniform(-80, 80), 220))
        canvas.ellipse(*head, 95, 85, dark)
        for side in (-1, 1):
            canvas.polygon(np.array([(-10, 0), (40, -10), (30, -110)]) * (side, 1) + head + (50 * side, -50), dark)
        tail = np.column_stack((np.linspace(420, 520, 20), 520 - 190 * np.linspace(0, 1, 20) ** 2))
        canvas.line(tail, dark, 34)
    return canvas.pixels()


def _branch(
    canvas: Canvas, rng: np.random.Generator, at: Floats, angle: float, length: float, width: float, fill: Colour
) -> None:
    end = at + length * np.array((math.cos(angle), math.sin(angle)))
    canvas.line([tuple(at), tuple(end)], fill, width)
    canvas.ellipse(*end, width / 2, width / 2, fill)
    if length < 45:
        canvas.ellipse(*end, 22, 15, fill)
        return
    for side in (-1, 1):
        turn = side * rng.uniform(0.25, 0.65)
        _branch(canvas, rng, end, angle + turn, length * rng.uniform(0.68, 0.8), 0.68 * width, fill)


def rotational_2(rng: np.random.Generator) -> Pixels:
    return _rosette(rng, 2)


def rotational_3(rng: np.random.Generator) -> Pixels:
    return _rosette(rng, 3)


def rotational_4(rng: np.random.Generator) -> Pixels:
    return _rosette(rng, 4)


def _rosette(rng: np.random.Generator, order: int) -> Pixels:
    """Draw shapes that a turn by a full circle over `order` maps to themselves, on white."""
    side = 640
    canvas = Canvas(side, side)
    tones, middle = palette(rng, 3), np.array((side / 2, side / 2))
    canvas.ellipse(*middle, 300, 300, None, tones[0], 16)
    shapes: list[tuple[Floats, Colour]] = []
    for _ in range(int(rng.integers(3, 6))):
        reach, size = rng.uniform(90, 220), rng.uniform(25, 65)
        form = (star(int(rng.integers(3, 7)), rng.uniform(0.4, 0.8)), blob(rng, 0.3))[int(rng.integers(2))]
        shape = turned(form * size, rng.uniform(0, 6)) + (reach, 0)
        shapes.append((turned(shape, rng.uniform(0, 2 * math.pi)), tones[int(rng.integers(3))]))
    for shape, tone in shapes:
        for turn in range(order):
            canvas.polygon(turned(shape, 2 * math.pi * turn / order) + middle, tone)
    for turn in range(order):
        curve = np.column_stack((np.linspace(0, 200, 30), 70 * np.sin(np.linspace(0, 3, 30))))
        canvas.line(turned(curve, 2 * math.pi * turn / order + 0.4) + middle, tones[0], 14)
    return canvas.pixels()


def mirror_symmetric(rng: np.random.Generator) -> Pixels:
    """Draw an emblem whose left half mirrors its right half."""
    canvas = Canvas(600, 640)
    tones = palette(rng, 3)
    shield = np.array([(0, -280), (230, -250), (225, 20), (150, 190), (0, 290)], float)
    canvas.polygon(np.vstack((shield, (shield * (-1, 1))[::-1])) + (300, 320), tones[0])
    for _ in range(int(rng.integers(3, 6))):
        form = turned(star(int(rng.integers(3, 7)), rng.uniform(0.4, 0.8)), rng.uniform(0, 6))
        shape = form * rng.uniform(25, 60) + (rng.uniform(30, 150), rng.uniform(-200, 90))
        tone = tones[int(rng.integers(1, 3))]
        for side in (1, -1):
            canvas.polygon(shape * (side, 1) + (300, 320), tone)
    for level in rng.uniform(-180, 120, 2):
        wing = np.array([(0, level), (170, level - 40), (190, level + 10), (0, level + 30)])
        canvas.polygon(np.vstack((wing, (wing * (-1, 1))[::-1])) + (300, 320), mixed(tones[2], WHITE, 0.4))
    return canvas.pixels()


def tiles(rng: np.random.Generator) -> Pixels:
    """Draw a floor of tiles with one ornament, and one tile of another colour."""
    canvas = Canvas(720, 720, mixed(WHITE, BLACK, 0.3))
    tones, count = palette(rng, 3), int(rng.integers(5, 9))
    step = 720 / count
    form = star(int(rng.integers(4, 9)), rng.uniform(0.4, 0.8))
    odd = tuple(rng.integers(0, count, 2))
    for row in range(count):
        for column in range(count):
            x, y = column * step, row * step
            ground = tones[2] if (row, column) != odd else tones[0]
            canvas.rectangle(x + 2, y + 2, step - 4, step - 4, ground)
            canvas.polygon(form * 0.38 * step + (x + step / 2, y + step / 2), tones[1])
            for dx in (0, 1):
                for dy in (0, 1):
                    canvas.ellipse(
                        x + step * (0.1 + 0.8 * dx), y + step * (0.1 + 0.8 * dy), step / 16, step / 16, tones[0]
                    )
    return canvas.pixels()


def checker(rng: np.random.Generator) -> Pixels:
    """Draw a checker in two colours with one round marker."""
    count = int(rng.integers(6, 11))
    canvas = Canvas(700, 700)
    dark, step = colour(rng, 0.1, 0.4), 700 / count
    for row in range(count):
        for column in range(count):
            if (row + column) % 2:
                canvas.rectangle(column * step, row * step, step, step, dark)
    _marker(canvas, rng, 700, 700, 0.3 * step)
    return canvas.pixels()


def dots(rng: np.random.Generator) -> Pixels:
    """Draw dots on a grid, in rows shifted by half a step, with one marker."""
    canvas = Canvas(760, 600, mixed(WHITE, colour(rng, 0.8), 0.25))
    tone, step = colour(rng, 0.2, 0.6), rng.uniform(40, 70)
    for row in range(int(600 / step) + 1):
        for column in range(int(760 / step) + 1):
            canvas.ellipse((column + 0.5 * (row % 2)) * step, (row + 0.5) * step, 0.28 * step, 0.28 * step, tone)
    _marker(canvas, rng, 760, 600, 0.6 * step)
    return canvas.pixels()


def stripes(rng: np.random.Generator) -> Pixels:
    """Draw slanting stripes with one marker."""
    canvas = Canvas(760, 560, mixed(WHITE, colour(rng, 0.9), 0.2))
    tone, step, slant = colour(rng, 0.1, 0.5), rng.uniform(36, 60), rng.uniform(-0.6, 0.6) * 560
    for index in range(-14, 36):
        x = index * step
        canvas.polygon([(x, 0), (x + step / 2, 0), (x + step / 2 + slant, 560), (x + slant, 560)], tone)
    _marker(canvas, rng, 760, 560, 1.2 * step)
    return canvas.pixels()


def _marker(canvas: Canvas, rng: np.random.Generator, width: float, height: float, radius: float) -> None:
    x, y = rng.uniform(0.15, 0.85) * width, rng.uniform(0.15, 0.85) * height
    canvas.ellipse(x, y, radius, radius, colour(rng, 0.8))
    canvas.polygon(turned(star(3, 0.5) * 0.6 * radius, rng.uniform(0, 6)) + (x, y), BLACK)


def chessboard(rng: np.random.Generator) -> Pixels:
    """Draw a calibration board of 9 x 6 or more squares with a white margin."""
    columns, rows = int(rng.integers(8, 12)), int(rng.integers(6, 9))
    step = 760 / (columns + 1)
    canvas = Canvas(760, round(step * (rows + 1)))
    for row in range(rows):
        for column in range(columns):
            if (row + column) % 2 == 0:
                canvas.rectangle((column + 0.5) * step, (row + 0.5) * step, step, step, BLACK)
    return canvas.pixels()


def charuco(rng: np.random.Generator) -> Pixels:
    """Draw a chessboard with a tag in every white square."""
    columns, rows = int(rng.integers(6, 9)), int(rng.integers(4, 7))
    step = 800 / (columns + 1)
    canvas = Canvas(800, round(step * (rows + 1)))
    for row in range(rows):
        for column in range(columns):
            x, y = (column + 0.5) * step, (row + 0.5) * step
            if (row + column) % 2 == 0:
                canvas.rectangle(x, y, step, step, BLACK)
            else:
                canvas.modules(tag_bits(rng, 4), x + 0.15 * step, y + 0.15 * step, 0.7 * step, 0.7 * step)
    return canvas.pixels()


def circle_grid(rng: np.random.Generator) -> Pixels:
    """Draw a calibration board of circles, in straight or shifted rows."""
    columns, rows, shifted = int(rng.integers(7, 12)), int(rng.integers(5, 9)), rng.random() < 0.5
    step = 760 / (columns + 1)
    canvas = Canvas(760, round(step * (rows + 1)))
    for row in range(rows):
        for column in range(columns - (shifted and row % 2)):
            x = (column + 1 + 0.5 * (shifted and row % 2)) * step
            canvas.ellipse(x, (row + 1) * step, 0.3 * step, 0.3 * step, BLACK)
    return canvas.pixels()


def tag(rng: np.random.Generator) -> Pixels:
    """Draw one square marker with its quiet zone."""
    canvas = Canvas(600, 600)
    canvas.modules(tag_bits(rng), 75, 75, 450, 450)
    return canvas.pixels()


def tag_board(rng: np.random.Generator) -> Pixels:
    """Draw a board of different markers with their numbers."""
    columns, rows = int(rng.integers(3, 6)), int(rng.integers(2, 5))
    step = 800 / columns
    canvas = Canvas(800, round(step * rows))
    for row in range(rows):
        for column in range(columns):
            x, y = (column + 0.12) * step, (row + 0.12) * step
            canvas.modules(tag_bits(rng), x, y, 0.76 * step, 0.76 * step)
            canvas.text(x, y + 0.78 * step, digits(rng, 3), 0.06 * step)
    return canvas.pixels()


def landing_pad(rng: np.random.Generator) -> Pixels:
    """Draw an H in a circle; half of them with a number below the H."""
    ground = mixed((70, 74, 78), colour(rng, 0.5), 0.3)
    canvas, tone = Canvas(640, 640, ground), WHITE if rng.random() < 0.5 else (245, 205, 40)
    canvas.ellipse(320, 320, 290, 290, None, tone, rng.uniform(16, 34))
    if rng.random() < 0.5:
        canvas.ellipse(320, 320, 245, 245, None, tone, 8)
    w, h, bar = rng.uniform(170, 220), rng.uniform(230, 290), rng.uniform(38, 56)
    canvas.rectangle(320 - w / 2, 320 - h / 2, bar, h, tone)
    canvas.rectangle(320 + w / 2 - bar, 320 - h / 2, bar, h, tone)
    canvas.rectangle(320 - w / 2, 320 - bar / 2, w, bar, tone)
    if rng.random() < 0.5:
        canvas.text(320, 320 + h / 2 + 45, digits(rng, 2), 64, tone, "bold", "mm")
    return canvas.pixels()


def flat_board(rng: np.random.Generator) -> Pixels:
    """Draw a sign with large flat areas: a frame, a symbol, one or two short lines of text."""
    canvas = Canvas(800, 560, colour(rng, 0.6, 0.95))
    dark = colour(rng, 0.1, 0.3)
    canvas.rectangle(24, 24, 752, 512, None, dark, 10, 30)
    canvas.polygon([(230, 90), (350, 290), (110, 290)], dark)
    canvas.text(230, 225, str(rng.choice(["!", "?", "i", "P"])), 110, WHITE, "bold", "mm")
    canvas.text(400, 130, title(rng, 1), 64, dark, "bold")
    if rng.random() < 0.6:
        canvas.text(400, 220, title(rng, 2), 34, dark)
    canvas.rectangle(60, 380, rng.uniform(300, 600), 90, mixed(dark, WHITE, 0.7), radius=12)
    return canvas.pixels()


def playing_card(rng: np.random.Generator) -> Pixels:
    """Draw a playing card, which half a turn maps to itself."""
    canvas = Canvas(500, 700)
    red = rng.random() < 0.5
    tone = (200, 24, 30) if red else BLACK
    rank = str(rng.choice(["4", "6", "8", "10", "K", "Q", "J"]))
    suit = "♥♦"[int(rng.integers(2))] if red else "♠♣"[int(rng.integers(2))]
    half = Canvas(500, 350)
    half.text(50, 55, rank, 56, tone, "bold", "mm")
    half.text(50, 115, suit, 56, tone, "sans", "mm")
    if rank.isalpha():
        for _ in range(6):
            where = rng.uniform((130, 80), (370, 330))
            half.polygon(turned(star(4, 0.5) * rng.uniform(20, 60), rng.uniform(0, 6)) + where, colour(rng, 0.3, 1.0))
        half.rectangle(110, 50, 280, 320, None, tone, 5)
    else:
        for row in range(int(rank) // 2 // 2):
            for column in (0, 1):
                half.text(170 + 160 * column, 110 + 100 * row, suit, 84, tone, "sans", "mm")
        if int(rank) // 2 % 2:
            half.text(250, 290, suit, 84, tone, "sans", "mm")
    top = half.pixels()
    whole = canvas.pixels()
    whole[:350], whole[350:] = top, top[::-1, ::-1]
    return whole


def barcode(rng: np.random.Generator) -> Pixels:
    """Draw a barcode with its digits, and a line of text above."""
    canvas = Canvas(720, 420)
    canvas.text(40, 22, f"{title(rng, 2)} {digits(rng, 4)}", 34, face="mono")
    draw_barcode(canvas, rng, 40, 80, 640, 320, int(rng.integers(24, 48)))
    return canvas.pixels()
