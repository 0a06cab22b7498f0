# SPDX-License-Identifier: Apache-2.0
"""Make the pictures of good-targets.md: python docs/make_target_pictures.py.

Eight designs drawn here, each with what `imgu check` says of it: the picture, where its detail lies, what tells it from
itself, and how the camera sees it 64 px wide.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.check.trial_views import DEFAULT_CAMERA
from imgu_ros.check.verdict import TargetCheck, check_targets
from imgu_ros.config.parameters import Parameters
from imgu_ros.image_files.images import write_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.report.check_pictures import detail_picture, far_picture, plain_picture, telling_picture

_WIDTH, _HEIGHT = 480, 360
_SIDE, _GAP, _HEAD = 200, 8, 40
#: Longer side of the picture from afar, px.
_FAR_PX = 64.0
_FONT = cv2.FONT_HERSHEY_SIMPLEX

Pixels = np.ndarray


def card(lines: int = 3, seed: int = 3) -> Pixels:
    """Return a card: a title, a picture of shapes of several sizes, some lines."""
    rng = np.random.default_rng(seed)
    page = np.full((_HEIGHT, _WIDTH, 3), 245, np.uint8)
    cv2.putText(page, "Harbour", (18, 62), _FONT, 2.0, (30, 40, 90), 6, cv2.LINE_AA)
    for _ in range(90):
        x, y = rng.integers((190, 90), (_WIDTH - 20, _HEIGHT - 30)).tolist()
        size, colour = int(rng.integers(6, 46)), rng.integers(20, 235, 3).tolist()
        if rng.random() < 0.5:
            cv2.rectangle(page, (x, y), (min(x + size, _WIDTH - 16), min(y + size, _HEIGHT - 16)), colour, -1)
        else:
            cv2.circle(page, (x, y), size // 2, colour, -1, cv2.LINE_AA)
    for line in range(lines):
        cv2.putText(
            page, f"Quay {7 * line + 3}, {9 + line}:30", (18, 150 + 60 * line), _FONT, 0.8, (40, 40, 40), 2, cv2.LINE_AA
        )
    return page


def logo() -> Pixels:
    """Return one plain sign on white."""
    page = np.full((_HEIGHT, _WIDTH, 3), 250, np.uint8)
    cv2.circle(page, (240, 180), 110, (20, 90, 160), -1, cv2.LINE_AA)
    cv2.circle(page, (280, 150), 60, (250, 250, 250), -1, cv2.LINE_AA)
    return page


def playing_card() -> Pixels:
    """Return a card that looks the same turned by 180 degrees."""
    half = card()[: _HEIGHT // 2]
    return np.vstack((half, half[::-1, ::-1]))


def tiles() -> Pixels:
    """Return a pattern that repeats itself."""
    tile = np.full((60, 60, 3), 235, np.uint8)
    cv2.rectangle(tile, (6, 6), (30, 22), (150, 40, 40), -1)
    cv2.circle(tile, (42, 42), 11, (30, 90, 60), -1, cv2.LINE_AA)
    return np.tile(tile, (_HEIGHT // 60, _WIDTH // 60, 1))


def faint() -> Pixels:
    """Return the card in light grey on grey."""
    return np.rint(150 + 22 * (card() / 255.0)).astype(np.uint8)


def small_print() -> Pixels:
    """Return a page of small lines."""
    rng = np.random.default_rng(2)
    page = np.full((_HEIGHT, _WIDTH, 3), 250, np.uint8)
    for y in range(14, _HEIGHT - 8, 11):
        x = 16
        while x < _WIDTH - 40:
            length = int(rng.integers(8, 34))
            cv2.rectangle(page, (x, y), (min(x + length, _WIDTH - 16), y + 4), (50, 50, 50), -1)
            x += length + 6
    return page


def corner_detail() -> Pixels:
    """Return the card with all of its detail in one corner."""
    page = np.full((_HEIGHT, _WIDTH, 3), 245, np.uint8)
    page[:130, :173] = cv2.resize(card(), (173, 130), interpolation=cv2.INTER_AREA)
    return page


def ribbon() -> Pixels:
    """Return a long, narrow strip of the card."""
    strip = np.hstack([card(seed=seed)[90:190, 190:] for seed in (3, 4, 5)])
    return np.ascontiguousarray(strip)


DESIGNS: dict[str, Callable[[], Pixels]] = {
    "a card": card, "one sign": logo, "looks the same turned": playing_card, "repeats itself": tiles,
    "low contrast": faint, "small print": small_print, "detail in one corner": corner_detail, "a ribbon": ribbon,
}  # fmt: skip


def main() -> None:
    """Draw all designs into one picture, two in a row."""
    images = [TargetImage(f"design_{index}", draw(), 0.2) for index, draw in enumerate(DESIGNS.values())]
    checks = [check_targets([image], [image.name], Parameters(), DEFAULT_CAMERA)[0] for image in images]
    cells = [_cell(title, check) for title, check in zip(DESIGNS, checks, strict=True)]
    rows = [np.hstack(cells[first : first + 2]) for first in range(0, len(cells), 2)]
    write_image(Path(__file__).parent / "images" / "targets.jpg", np.vstack(rows))
    for title, check in zip(DESIGNS, checks, strict=True):
        smallest = check.smallest_width_px
        print(f"| {title} | {check.score} | {'never' if smallest is None else f'{smallest:.0f} px'} | ", end="")
        print(f"{', '.join(reason.kind.replace('_', ' ') for reason in check.reasons)} |")


def _cell(title: str, check: TargetCheck) -> Pixels:
    shown = [plain_picture(check), detail_picture(check), far_picture(check, _FAR_PX)]
    if check.traits is not None and check.traits.closest is not None:
        shown.insert(2, telling_picture(check, check.traits.closest))
    cell = np.full((_HEAD + _SIDE * 3 // 4 + 2 * _GAP, 4 * (_SIDE + _GAP) + 3 * _GAP, 3), 255, np.uint8)
    smallest = check.smallest_width_px
    found = "never found dependably" if smallest is None else f"found from {smallest:.0f} px wide"
    cv2.putText(cell, f"{title}: {check.score}, {found}", (2 * _GAP, 26), _FONT, 0.62, (30, 30, 30), 1, cv2.LINE_AA)
    for index, picture in enumerate(shown):
        factor = min(_SIDE / picture.shape[1], _SIDE * 3 / 4 / picture.shape[0])
        small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        x, y = 2 * _GAP + index * (_SIDE + _GAP), _HEAD
        cell[y : y + small.shape[0], x : x + small.shape[1]] = small
        cv2.rectangle(cell, (x, y), (x + small.shape[1] - 1, y + small.shape[0] - 1), (200, 200, 200), 1)
    return cell


if __name__ == "__main__":
    main()
