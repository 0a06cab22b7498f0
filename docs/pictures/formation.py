# SPDX-License-Identifier: Apache-2.0
"""A mosaic of fine and of vivid patterns, and what each demosaicking method makes of it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import PIL.Image
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from imgu_ros.types import Image
from imgu_ros.vision.formation import BayerPattern, DemosaicMethod, demosaic, mosaic, site_mask

_PATTERN = BayerPattern.RGGB
_SIZE = 120
#: The part that is shown.
_SHOWN = (slice(36, 100), slice(28, 92))


def draw(path: Path) -> None:
    """Draw the page's picture."""
    figure = Figure(figsize=(10, 3), dpi=90, layout="constrained")
    grid = figure.subplots(2, 2 + len(DemosaicMethod))
    for row, (name, picture) in zip(grid, (("fine", _fine()), ("vivid", _vivid())), strict=True):
        raw = mosaic(picture, _PATTERN)
        shown = {f"{name} scene": picture, "mosaic": _colored(raw)}
        for method in DemosaicMethod:
            found = demosaic(raw, _PATTERN, method)
            error = np.mean((found.astype(float) - picture)[8:-8, 8:-8] ** 2)
            shown[f"{method}\n{10 * np.log10(255**2 / error):.1f} dB"] = found
        for axes, (title, image) in zip(row, shown.items(), strict=True):
            axes.imshow(image[_SHOWN], interpolation="nearest")
            axes.set_title(title, fontsize=8)
            axes.axis("off")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    # Few colours make a small file.
    picture = PIL.Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.quantize(128, dither=PIL.Image.Dither.NONE).save(path, optimize=True)


def _fine() -> Image:
    """Grey rings that become finer towards the corner, slightly tinted."""
    y, x = np.mgrid[:_SIZE, :_SIZE]
    light = 128 + 85 * np.sin(0.0105 * (x * x + y * y))
    return _picture(np.stack([0.95 * light + 8, light, 0.9 * light + 6], axis=2))


def _vivid() -> Image:
    """Saturated discs whose colours have nothing to do with each other."""
    picture = np.full((_SIZE, _SIZE, 3), (230, 190, 30), np.uint8)
    for k, color in enumerate(((200, 20, 40), (20, 90, 200), (10, 150, 60), (240, 120, 200), (90, 20, 140))):
        centre = (24 + 26 * (k % 3) + 14 * (k // 3), 52 + 30 * (k // 3))
        cv2.circle(picture, centre, 17, color, -1, cv2.LINE_AA)
    return _picture(picture.astype(float))


def _picture(rgb: Image) -> Image:
    return np.clip(np.rint(cv2.GaussianBlur(rgb, (0, 0), 0.6)), 0, 255).astype(np.uint8)


def _colored(raw: Image) -> Image:
    masks = [site_mask((_SIZE, _SIZE), _PATTERN, color) for color in "rgb"]
    return np.stack([np.where(mask, raw, 0) for mask in masks], axis=2)
