# SPDX-License-Identifier: Apache-2.0
"""One picture, and what the chapter makes of it: light, thresholds, edges, warps."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import PIL.Image
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.types import Image
from imgu_ros.vision.processing import (
    canny,
    equalised,
    equalised_locally,
    gamma_corrected,
    gradient,
    grey_from_rgb,
    otsu_threshold,
    rotated,
    thresholded,
    warped,
    whole_picture,
)

_SIDES = (150, 110)


def draw(path: Path) -> None:
    """Draw the table of pictures to a PNG file, in 24 greys."""
    grey = grey_from_rgb(procedural_texture(*_SIDES, seed=6))
    light = np.linspace(0.15, 0.75, _SIDES[0])[None]
    dim = (grey * light).astype(np.uint8)
    tilt = np.array([[0.9, 0.25, 0], [-0.05, 0.8, 0], [4e-4, 2.2e-3, 1]])
    canvas = whole_picture(tilt, _SIDES)
    pictures: list[tuple[str, Image]] = [
        ("uneven light", dim),
        ("gamma 0.5", gamma_corrected(dim, 0.5)),
        ("equalised", equalised(dim)),
        ("CLAHE", equalised_locally(dim, 4.0, 4)),
        ("Otsu's threshold", thresholded(grey, otsu_threshold(grey))),
        ("gradient, Scharr", np.minimum(5 * gradient(grey, "scharr").magnitude, 255)),
        ("Canny", 255 - 255 * canny(grey, 6, 15).astype(np.uint8)),
        ("rotated, whole", rotated(grey, math.radians(25), whole=True, interpolation="cubic", value=255)),
        ("projective, whole", warped(grey, canvas.H, canvas.size, "cubic", value=255)),
        ("periodic border", warped(grey, np.diag([0.5, 0.5, 1.0]), _SIDES, "linear", "periodic")),
    ]
    figure = Figure(figsize=(7.6, 2.9), dpi=80, layout="constrained")
    canvas_of_figure = FigureCanvasAgg(figure)
    for axes, (title, picture) in zip(figure.subplots(2, 5).ravel(), pictures, strict=True):
        axes.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axes.set_title(title, fontsize=8)
        axes.set_axis_off()
    canvas_of_figure.draw()
    page = PIL.Image.fromarray(np.asarray(canvas_of_figure.buffer_rgba())).convert("L")
    page.quantize(24, dither=PIL.Image.Dither.NONE).save(path, optimize=True)
