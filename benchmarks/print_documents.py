# SPDX-License-Identifier: Apache-2.0
"""Prints with text: labels, cards, posters, pages, forms, tables, tickets, calendars, and their siblings.

A sibling is a print of the same design with other contents: another number, another text below the same header.
`rng` draws the design, `own` the contents that differ.
"""

from __future__ import annotations

import calendar

import numpy as np
from print_canvas import (
    BLACK,
    WHITE,
    Canvas,
    Pixels,
    blob,
    colour,
    data_matrix_bits,
    digits,
    draw_barcode,
    mixed,
    palette,
    picture,
    price,
    qr_bits,
    star,
    title,
    turned,
    words,
)

GREY = (120, 120, 124)


def price_label(rng: np.random.Generator) -> Pixels:
    canvas = Canvas(720, 420, (252, 228, 60) if rng.random() < 0.5 else WHITE)
    canvas.rectangle(0, 0, 720, 96, colour(rng, 0.4, 0.8))
    canvas.text(28, 20, title(rng, 2), 50, WHITE, "bold")
    canvas.text(28, 112, " ".join(words(rng, 4)), 26)
    whole, cents = price(rng).split(".")
    end = 300 + canvas.text(300, 150, whole, 170, (190, 20, 25), "bold")
    canvas.text(end + 10, 160, cents, 84, (190, 20, 25), "bold")
    draw_barcode(canvas, rng, 28, 220, 230, 170, 20)
    canvas.text(end + 14, 270, f"per {rng.choice(['kg', 'piece', 'l', 'pack'])}", 24, GREY)
    canvas.text(690, 385, f"1 kg = {price(rng)}", 22, GREY, anchor="rm")
    return canvas.pixels()


def greeting_card(rng: np.random.Generator) -> Pixels:
    canvas = Canvas(760, 540, mixed(WHITE, colour(rng, 0.9), 0.2))
    tones = palette(rng, 4)
    for _ in range(int(rng.integers(9, 16))):
        where = rng.uniform((20, 20), (740, 520))
        form = (star(int(rng.integers(5, 9)), 0.6), blob(rng, 0.3))[int(rng.integers(2))]
        canvas.polygon(form * rng.uniform(15, 65) + where, tones[int(rng.integers(4))])
    canvas.rectangle(140, 180, 480, 180, WHITE, tones[0], 6, 24)
    canvas.text(380, 240, title(rng, 2), 58, tones[0], "roman_italic", "mm")
    canvas.text(380, 310, " ".join(words(rng, 4)), 26, tones[1], "roman", "mm")
    return canvas.pixels()


def poster(rng: np.random.Generator) -> Pixels:
    canvas = Canvas(640, 900, colour(rng, 0.2, 0.9))
    canvas.paste(picture(rng, 560, 480), 40, 150, 560, 480)
    canvas.text(320, 80, title(rng, 2).upper(), 62, WHITE, "bold", "mm")
    for line in range(3):
        canvas.text(40, 660 + 46 * line, title(rng, 3), 32, WHITE, str(rng.choice(["sans", "serif", "bold"])))
    canvas.text(600, 850, f"{rng.integers(1, 29)}.{rng.integers(1, 13)}. 20:00", 44, (255, 230, 90), "bold", "rm")
    return canvas.pixels()


def header_poster(rng: np.random.Generator, own: np.random.Generator) -> Pixels:
    """Draw a poster of a series: the upper 30 % and the foot are the series', the rest is its own."""
    tones = palette(rng, 3)
    canvas = Canvas(640, 900)
    canvas.rectangle(0, 0, 640, 270, tones[0])
    for _ in range(14):
        canvas.polygon(
            blob(rng) * rng.uniform(10, 45) + rng.uniform((20, 20), (620, 180)), tones[int(rng.integers(1, 3))]
        )
    canvas.text(320, 225, title(rng, 2).upper(), 54, WHITE, "bold", "mm")
    canvas.rectangle(0, 840, 640, 60, tones[0])
    canvas.text(24, 870, " ".join(words(rng, 5)), 26, WHITE, anchor="lm")
    canvas.paste(picture(own, 280, 300), 40, 300, 280, 300)
    canvas.text(350, 310, title(own, 1), 54, tones[0], "bold")
    canvas.paragraph(own, 350, 390, 250, 210, 20)
    canvas.paragraph(own, 40, 630, 560, 190, 22)
    return canvas.pixels()


def number_label(rng: np.random.Generator, own: np.random.Generator) -> Pixels:
    """Draw a shelf or room label of which only the numbers differ."""
    canvas = Canvas(720, 440)
    tone = colour(rng, 0.3, 0.6)
    canvas.rectangle(0, 0, 720, 110, tone)
    canvas.polygon(star(6, 0.5) * 40 + (70, 55), WHITE)
    canvas.text(130, 28, title(rng, 2), 52, WHITE, "bold")
    canvas.text(30, 130, f"{title(rng, 1)}:", 34)
    canvas.text(30, 320, f"{title(rng, 2)}", 30, GREY)
    canvas.rectangle(30, 375, 660, 40, None, tone, 4)
    canvas.text(45, 380, " ".join(words(rng, 5)), 24)
    canvas.text(250, 120, f"{rng.choice(['A', 'B', 'C', 'R'])!s}-{digits(own, 3)}", 128, BLACK, "bold")
    canvas.text(420, 320, digits(own, 8), 34, GREY, "mono")
    return canvas.pixels()


def text_page(rng: np.random.Generator) -> Pixels:
    canvas = Canvas(640, 900)
    canvas.text(60, 60, title(rng, 3), 34, face="roman_bold")
    y = 120.0
    while y < 800:
        y = canvas.paragraph(rng, 60, y, 520, min(rng.uniform(90, 260), 840 - y), 17, face="roman", indent=26) + 8
    canvas.text(320, 868, digits(rng, 2), 16, anchor="mm")
    return canvas.pixels()


def two_column_page(rng: np.random.Generator) -> Pixels:
    canvas = Canvas(680, 900)
    canvas.text(340, 60, title(rng, 5), 30, face="roman_bold", anchor="mm")
    canvas.text(340, 98, title(rng, 3), 18, face="roman_italic", anchor="mm")
    figure = int(rng.integers(2))
    for column in (0, 1):
        x, y = 50 + 300 * column, 140.0
        if column == figure:
            canvas.rectangle(x, y, 280, 190, None, GREY, 2)
            curve = np.column_stack((np.linspace(x + 10, x + 270, 60), y + 95 + np.cumsum(rng.normal(0, 9, 60))))
            canvas.line(np.clip(curve, (x, y + 5), (x + 280, y + 185)), BLACK, 3)
            canvas.text(x, y + 200, f"Figure {rng.integers(1, 9)}: {' '.join(words(rng, 4))}", 14, face="roman_italic")
            y += 230
        while y < 820:
            canvas.text(x, y, f"{rng.integers(1, 9)}  {title(rng, 2)}", 17, face="roman_bold")
            y = canvas.paragraph(rng, x, y + 26, 280, min(rng.uniform(120, 300), 840 - y), 14, face="roman") + 10
    return canvas.pixels()


def form(rng: np.random.Generator) -> Pixels:
    canvas = Canvas(680, 900)
    canvas.text(40, 40, title(rng, 3), 34, face="bold")
    canvas.text(640, 52, f"No. {digits(rng, 6)}", 20, face="mono", anchor="ra")
    y = 110.0
    while y < 820:
        if rng.random() < 0.3:
            canvas.rectangle(40, y, 600, 30, (215, 218, 224))
            canvas.text(50, y + 5, title(rng, 2), 18, face="bold")
            y += 40
        parts = int(rng.integers(1, 4))
        for part in range(parts):
            x, w = 40 + 600 * part / parts, 600 / parts - 14
            canvas.text(x, y, f"{title(rng, 1)}", 15)
            if rng.random() < 0.3:
                for box in range(3):
                    canvas.rectangle(x + 60 * box, y + 24, 18, 18, None, BLACK, 2)
            else:
                canvas.rectangle(x, y + 20, w, 30, None, BLACK, 2)
        y += 66
    return canvas.pixels()


def table(rng: np.random.Generator) -> Pixels:
    columns, rows = int(rng.integers(4, 8)), int(rng.integers(10, 18))
    canvas = Canvas(800, 620)
    canvas.text(30, 18, title(rng, 3), 28, face="bold")
    top, high, wide = 70, 530 / (rows + 1), 740 / columns
    canvas.rectangle(30, top, 740, high, (200, 208, 222))
    for row in range(rows + 2):
        canvas.line([(30, top + row * high), (770, top + row * high)], BLACK, 1.5)
    for column in range(columns + 1):
        canvas.line([(30 + column * wide, top), (30 + column * wide, top + (rows + 1) * high)], BLACK, 1.5)
    for row in range(rows + 1):
        for column in range(columns):
            x, y = 30 + column * wide + 6, top + (row + 0.5) * high
            text = title(rng, 1) if row == 0 or column == 0 else price(rng)
            canvas.text(x, y, text, min(0.55 * high, 18), face="bold" if row == 0 else "sans", anchor="lm")
    return canvas.pixels()


def qr_code(rng: np.random.Generator) -> Pixels:
    canvas = Canvas(600, 600)
    canvas.modules(qr_bits(rng, 4 * int(rng.integers(2, 8)) + 17), 60, 60, 480, 480)
    return canvas.pixels()


def data_matrix(rng: np.random.Generator) -> Pixels:
    canvas = Canvas(560, 560)
    canvas.modules(data_matrix_bits(rng, 2 * int(rng.integers(8, 15))), 50, 50, 460, 460)
    return canvas.pixels()


def business_card(rng: np.random.Generator) -> Pixels:
    canvas, tone = Canvas(765, 495), colour(rng, 0.2, 0.7)
    canvas.polygon(blob(rng, 0.2) * 60 + (110, 110), tone)
    canvas.polygon(turned(star(4, 0.5) * 36, rng.uniform(0, 3)) + (110, 110), WHITE)
    canvas.text(210, 80, title(rng, 2), 46, tone, "bold")
    canvas.text(210, 140, title(rng, 2), 26, GREY, "oblique")
    canvas.line([(50, 230), (715, 230)], tone, 4)
    for row, text in enumerate(
        (f"{title(rng, 2)} {rng.integers(1, 99)}", f"+{digits(rng, 2)} {digits(rng, 3)} {digits(rng, 6)}",
         f"{words(rng, 1)[0]}@{words(rng, 1)[0]}.example")
    ):  # fmt: skip
        canvas.text(50, 270 + 52 * row, text, 28)
    return canvas.pixels()


def book_cover(rng: np.random.Generator) -> Pixels:
    canvas, tone = Canvas(600, 880, colour(rng, 0.2, 0.7)), (250, 240, 215)
    canvas.text(300, 110, title(rng, 1).upper(), 76, tone, "serif_bold", "mm")
    canvas.text(300, 190, title(rng, 2), 44, tone, "serif", "mm")
    if rng.random() < 0.5:
        canvas.paste(picture(rng, 500, 440), 50, 260, 500, 440)
    else:
        tones = palette(rng, 4)
        for _ in range(22):
            canvas.polygon(
                blob(rng) * rng.uniform(20, 90) + rng.uniform((110, 330), (490, 640)), tones[int(rng.integers(4))]
            )
    canvas.text(300, 770, title(rng, 2), 40, tone, "roman_italic", "mm")
    canvas.text(300, 840, title(rng, 1), 24, tone, "sans", "mm")
    return canvas.pixels()


def month(rng: np.random.Generator, own: np.random.Generator) -> Pixels:
    """Draw a page of a calendar; other months of it have another name and the days elsewhere."""
    canvas, tone, year = Canvas(760, 620), colour(rng, 0.3, 0.6), int(rng.integers(1990, 2040))
    number = int(own.integers(1, 13))
    canvas.rectangle(0, 0, 760, 110, tone)
    canvas.text(30, 26, calendar.month_name[number], 58, WHITE, "bold")
    canvas.text(730, 26, str(year), 58, WHITE, "bold", "ra")
    wide, high = 740 / 7, 460 / 6
    for day in range(7):
        canvas.text(10 + (day + 0.5) * wide, 132, calendar.day_abbr[day], 20, tone, "bold", "mm")
    for week, days in enumerate(calendar.Calendar().monthdayscalendar(year, number)):
        for day, date in enumerate(days):
            x, y = 10 + day * wide, 152 + week * high
            canvas.rectangle(x, y, wide, high, None, GREY, 1.5)
            if date:
                canvas.text(x + 8, y + 4, str(date), 28, (190, 20, 25) if day == 6 else BLACK)
    return canvas.pixels()


def ticket(rng: np.random.Generator, own: np.random.Generator) -> Pixels:
    """Draw a ticket; others have another seat, number and code."""
    canvas, tone = Canvas(860, 380, mixed(WHITE, colour(rng, 0.9), 0.15)), colour(rng, 0.3, 0.6)
    canvas.rectangle(0, 0, 860, 70, tone)
    canvas.text(24, 14, title(rng, 3), 38, WHITE, "bold")
    canvas.line([(640, 70), (640, 380)], GREY, 3)
    for row in range(3):
        for column in range(2):
            x, y = 30 + 300 * column, 90 + 92 * row
            canvas.text(x, y, title(rng, 1), 18, GREY)
            differs = row + column > 1
            canvas.text(x, y + 24, title(rng, 2) if not differs else digits(own, 4), 36, face="bold")
    canvas.modules(qr_bits(own, 25), 670, 90, 160, 160)
    canvas.text(750, 290, digits(own, 6), 30, face="mono", anchor="mm")
    canvas.text(750, 340, price(rng), 34, tone, "bold", "mm")
    return canvas.pixels()


def score_sheet(rng: np.random.Generator) -> Pixels:
    """Draw lines of music with notes."""
    canvas = Canvas(680, 900)
    canvas.text(340, 50, title(rng, 3), 36, face="serif_bold", anchor="mm")
    for system in range(8):
        top = 110 + 96 * system
        for line in range(5):
            canvas.line([(40, top + 10 * line), (640, top + 10 * line)], BLACK, 1.3)
        for bar in (40, 190, 340, 490, 640):
            canvas.line([(bar, top), (bar, top + 40)], BLACK, 2)
        canvas.arc(58, top + 22, 14, 100, 400, BLACK, 4)
        canvas.line([(58, top - 10), (60, top + 52)], BLACK, 3)
        x = 95.0
        while x < 625:
            y = top + 5 * float(rng.integers(-1, 10))
            hollow = rng.random() < 0.25
            canvas.ellipse(x, y, 7, 5, WHITE if hollow else BLACK, BLACK, 2)
            up = y > top + 20
            canvas.line([(x + (6 if up else -6), y), (x + (6 if up else -6), y + (-34 if up else 34))], BLACK, 2)
            x += float(rng.choice([22, 30, 44]))
    return canvas.pixels()


def keyboard(rng: np.random.Generator) -> Pixels:
    """Draw the keys of a keyboard with their letters."""
    dark = rng.random() < 0.5
    ground, key, ink = ((40, 42, 46), (66, 69, 74), WHITE) if dark else ((200, 203, 206), WHITE, BLACK)
    canvas, step = Canvas(860, 330, ground), 56
    rows = ("1234567890-=", "QWERTYUIOP[]", "ASDFGHJKL;'", "ZXCVBNM,./")
    rows = rows if rng.random() < 0.5 else ("1234567890-=", "QWERTZUIOPÜ+", "ASDFGHJKLÖÄ", "YXCVBNM,.-")
    for row, letters in enumerate(rows):
        x, y = 20 + (0, 1.5, 1.8, 2.3)[row] * step * 0.99, 20 + row * step
        canvas.rectangle(20, y, max(x - 26, 1), 50, key, radius=7) if row else None
        for index, letter in enumerate(letters):
            canvas.rectangle(x + index * step, y, 50, 50, key, radius=7)
            canvas.text(x + index * step + 9, y + 6, letter, 20, ink)
        end = x + len(letters) * step
        canvas.rectangle(end, y, 840 - end, 50, key, radius=7)
    x = 20.0
    for units in (1.3, 1.3, 1.3, 6, 1.3, 1.3, 1.3):
        canvas.rectangle(x, 20 + 4 * step, units * step - 6, 50, key, radius=7)
        x += units * step + 2
    return canvas.pixels()
