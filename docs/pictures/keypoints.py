# SPDX-License-Identifier: Apache-2.0
"""The picture of the keypoints' page: what each detector finds on one made-up scene."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.types import Image
from imgu_ros.vision.keypoints import detect
from imgu_ros.vision.methods import DETECTORS
from imgu_ros.vision.scale_space import build_pyramid

_SIDE = 240
_COUNT = 40


def draw(path: Path) -> None:
    """Write the picture as PNG: a panel for each detector, circles of twice the scale with a hand for the angle."""
    picture = _scene()
    panels = []
    for detector in DETECTORS:
        panel = cv2.cvtColor((128 + picture.astype(np.int16) // 2).astype(np.uint8), cv2.COLOR_GRAY2BGR)
        found = detect(build_pyramid(picture, levels=4), detector, _COUNT)
        for (x, y), scale, angle in zip(found.xy, found.scale, found.angle, strict=True):
            radius = max(3.0, 2 * scale)
            center = round(x), round(y)
            tip = round(x + radius * math.cos(angle)), round(y + radius * math.sin(angle))
            cv2.circle(panel, center, round(radius), (170, 60, 20), 1, cv2.LINE_AA)
            cv2.line(panel, center, tip, (20, 60, 200), 1, cv2.LINE_AA)
        cv2.rectangle(panel, (0, 0), (_SIDE - 1, 21), (255, 255, 255), -1)
        cv2.putText(panel, str(detector), (5, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
        panels.append(cv2.copyMakeBorder(panel, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(255, 255, 255)))
    rows = [np.hstack(panels[i : i + 3]) for i in (0, 3)]
    # Sixteen shades of each colour make a small file.
    cv2.imwrite(str(path), np.vstack(rows) // 16 * 17, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _scene() -> Image:
    """Return squares, discs, a star and a checkered corner on even ground."""
    light = np.full((_SIDE, _SIDE), 150, np.uint8)
    light[34:66, 130:162] = light[66:98, 162:194] = 30
    light[34:66, 162:194] = light[66:98, 130:162] = 240
    square = cv2.boxPoints(((60, 70), (52, 36), 25)).astype(np.int32)
    cv2.fillPoly(light, [square], 60)
    for (x, y), radius, value in (
        ((50, 150), 22, 230),
        ((105, 165), 11, 40),
        ((50, 200), 8, 60),
        ((100, 205), 15, 220),
    ):
        cv2.circle(light, (x, y), radius, value, -1)
    turn = np.arange(10) * math.pi / 5
    reach = np.where(np.arange(10) % 2, 16, 40)
    star = np.column_stack((180 + reach * np.sin(turn), 170 - reach * np.cos(turn)))
    cv2.fillPoly(light, [np.rint(star).astype(np.int32)], 20)
    return cv2.GaussianBlur(light, (0, 0), 1.2)


if __name__ == "__main__":
    draw(Path("keypoints.png"))
