# SPDX-License-Identifier: Apache-2.0
"""The same four keypoints in two views: their patches, and how far each descriptor changes from view to view."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from imgu_ros.simulate.sequence import default_targets
from imgu_ros.types import Image, Points
from imgu_ros.vision.descriptors import describe
from imgu_ros.vision.descriptors.patch import SIDE, STEP_PER_SIGMA
from imgu_ros.vision.keypoints import Keypoints, detect
from imgu_ros.vision.matching import metric_for, prepare_gallery
from imgu_ros.vision.methods import DESCRIPTORS
from imgu_ros.vision.scale_space import build_pyramid

_TURN_RAD = math.radians(40)
_SCALE = 0.9
_COLORS = ("#d55e00", "#56b4e9", "#009e73", "#cc79a7")


def draw(path: Path) -> None:
    """Draw the page's picture."""
    target = cv2.resize(cv2.cvtColor(default_targets(1, seed=1)[0].pixels, cv2.COLOR_RGB2GRAY), (300, 300))
    centre = (149.5, 149.5)
    A = cv2.getRotationMatrix2D(centre, -math.degrees(_TURN_RAD), _SCALE)
    turned = cv2.warpAffine(target, A, (300, 300), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    view = np.rint(0.6 * turned + 60).astype(np.uint8)
    found = detect(build_pyramid(target, levels=1), "dog", 400)
    some = _spread_out(found)
    moved = Keypoints(
        some.xy @ A[:, :2].T + A[:, 2], some.scale * _SCALE, some.angle + _TURN_RAD, some.response, some.octave
    )
    figure = Figure(figsize=(10, 3.6), dpi=80, layout="constrained")
    left, right, patches, table = figure.subplots(1, 4, width_ratios=(3, 3, 1.5, 3.2))
    for axes, picture, points in ((left, target, some), (right, view, moved)):
        axes.imshow(picture, cmap="gray", vmin=0, vmax=255)
        for color, square in zip(_COLORS, _squares(points), strict=True):
            axes.plot(*square.T, color=color, linewidth=2)
    left.set_title("a target", fontsize=9)
    right.set_title("a view: turned, smaller, less contrast", fontsize=9)
    _draw_patches(patches, [_patches(target, some), _patches(view, moved)])
    _draw_changes(table, target, some, view, moved)
    for axes in (left, right, patches, table):
        axes.axis("off")
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    """Few colours make a small file."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    greys = np.repeat(np.linspace(0, 1, 24), 3).reshape(-1, 3)
    colors = np.array([to_rgb(color) for color in _COLORS])
    palette = PIL.Image.new("P", (1, 1))
    palette.putpalette(np.rint(255 * np.vstack([greys, colors, (colors + 1) / 2])).astype(np.uint8).tobytes())
    picture = PIL.Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.quantize(palette=palette, dither=PIL.Image.Dither.NONE).save(path, optimize=True)


def _spread_out(found: Keypoints) -> Keypoints:
    near = np.flatnonzero((np.linalg.norm(found.xy - 149.5, axis=1) < 95) & (found.scale > 1.8) & (found.scale < 3))
    chosen = [int(near[0])]
    while len(chosen) < len(_COLORS):
        apart = np.min([np.linalg.norm(found.xy[near] - found.xy[k], axis=1) for k in chosen], axis=0)
        chosen.append(int(near[apart.argmax()]))
    return found.chosen(np.array(chosen))


def _squares(points: Keypoints) -> list[Points]:
    """Outlines with a stroke along the orientation."""
    shape = np.array([[0, 0], [1, 0], [1, -1], [-1, -1], [-1, 1], [1, 1], [1, 0]]) * (SIDE - 1) / 2 * STEP_PER_SIGMA
    return [
        xy + scale * shape @ np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        for xy, scale, angle in zip(points.xy, points.scale, points.angle, strict=True)
    ]


def _described(picture: Image, points: Keypoints, kind: str) -> Image:
    return describe(build_pyramid(picture, levels=1), points, kind).descriptors


def _patches(picture: Image, points: Keypoints) -> Image:
    return _described(picture, points, "patch").reshape(-1, SIDE, SIDE)


def _draw_patches(axes, pairs: list[Image]) -> None:  # type: ignore[no-untyped-def]
    gap = 4
    sheet = np.full((len(_COLORS) * (SIDE + gap), 2 * SIDE + gap), 255.0)
    for column, patches in enumerate(pairs):
        for row, patch in enumerate(patches):
            top, left = row * (SIDE + gap), column * (SIDE + gap)
            sheet[top : top + SIDE, left : left + SIDE] = patch
    axes.imshow(sheet, cmap="gray", vmin=0, vmax=255)
    for row, color in enumerate(_COLORS):
        top = row * (SIDE + gap) - 1
        axes.plot([-1, -1], [top, top + SIDE + 1], color=color, linewidth=3)
    axes.set_title("their patches", fontsize=9)


def _draw_changes(axes, target: Image, some: Keypoints, view: Image, moved: Keypoints) -> None:  # type: ignore[no-untyped-def]
    """To the same keypoint in the view, beside the nearest of the other three."""
    axes.set_title("distance from view to view\nto itself / to the nearest other", fontsize=9)
    axes.set_xlim(0, 1)
    axes.set_ylim(-6.4, 0.2)
    for row, kind in enumerate(DESCRIPTORS):
        metric = metric_for(kind)
        gallery = prepare_gallery(_described(view, moved, kind), metric)
        rows = _described(target, some, kind)
        count = len(_COLORS)
        distances = np.array([gallery.prepared.distances(rows, np.full(count, k)) for k in range(count)]).T
        own, others = np.diag(distances), distances[~np.eye(count, dtype=bool)].reshape(count, -1).min(axis=1)
        axes.text(0, -1.1 * row - 0.4, f"{kind}\n{metric}", fontsize=8, va="center")
        for k, color in enumerate(_COLORS):
            digits = 0 if others.max() > 10 else 2
            text = f"{own[k]:.{digits}f}\n/ {others[k]:.{digits}f}"
            good = own[k] < others[k]
            weight = "bold" if good else "normal"
            axes.text(0.32 + 0.18 * k, -1.1 * row - 0.4, text, fontsize=8, va="center", color=color, weight=weight)
