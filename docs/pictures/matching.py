# SPDX-License-Identifier: Apache-2.0
"""A picture of repeating tiles: matches by descriptors alone, and those that a first homography brings back."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import PIL.Image
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from imgu_ros.types import Points
from imgu_ros.vision.descriptors import describe
from imgu_ros.vision.keypoints import detect
from imgu_ros.vision.matching import guided_homography, match
from imgu_ros.vision.projective import estimate_homography, transform
from imgu_ros.vision.scale_space import build_pyramid

_VIEW = np.array([[0.78, -0.16, 75.0], [0.1, 0.72, 12.0], [2e-4, -3e-4, 1.0]])
_SIDE = 360


def draw(path: Path) -> None:
    """Draw the page's picture."""
    rng = np.random.default_rng(4)
    target = _tiles(rng)
    view = cv2.warpPerspective(target, _VIEW, (_SIDE, _SIDE), flags=cv2.INTER_CUBIC, borderValue=110)
    noise = rng.normal(0, 3, view.shape)
    view = np.clip(np.rint(0.8 * view + 20 + noise), 0, 255).astype(np.uint8)
    found = []
    for picture in (target, view):
        pyramid = build_pyramid(picture, "fine", 4)
        found.append(describe(pyramid, detect(pyramid, "orb", 600)))
    a, b = found
    plain = match(a.descriptors, b.descriptors, dst_xy=b.keypoints.xy)
    first = estimate_homography(
        a.keypoints.xy[plain.index_src], b.keypoints.xy[plain.index_dst], rng, sampler="prosac", max_iterations=5000
    )
    guided = guided_homography(a.descriptors, b.descriptors, a.keypoints.xy, b.keypoints.xy, first.H)
    figure = Figure(figsize=(9, 2.7), dpi=80, layout="constrained")
    for axes, title, matches in zip(
        figure.subplots(1, 2), ("by descriptors alone", "guided by a homography"), (plain, guided.matches), strict=True
    ):
        src, dst = a.keypoints.xy[matches.index_src], b.keypoints.xy[matches.index_dst]
        right = np.linalg.norm(transform(_VIEW, src) - dst, axis=1) < 3
        axes.imshow(np.hstack([target, view]), cmap="gray", vmin=0, vmax=255)
        for mask, color in ((~right, "#d55e00"), (right, "#56b4e9")):
            axes.plot(*_lines(src[mask], dst[mask]), color=color, linewidth=0.4)
        axes.set_title(f"{title}: {right.sum()} right, {(~right).sum()} wrong", fontsize=10)
        axes.axis("off")
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    """Few colours make a small file."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    greys = np.repeat(np.linspace(0, 1, 24), 3).reshape(-1, 3)
    colors = np.array([to_rgb(color) for color in ("#d55e00", "#56b4e9")])
    palette = PIL.Image.new("P", (1, 1))
    palette.putpalette(np.rint(255 * np.vstack([greys, colors, (colors + 1) / 2])).astype(np.uint8).tobytes())
    picture = PIL.Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.quantize(palette=palette, dither=PIL.Image.Dither.NONE).save(path, optimize=True)


def _tiles(rng: np.random.Generator) -> np.ndarray:
    """One random tile, repeated, under a faint pattern that does not repeat."""
    tile = cv2.GaussianBlur(rng.normal(size=(72, 72)), (0, 0), 3.0)
    tile = np.tile(tile / tile.std(), (_SIDE // 72, _SIDE // 72))
    other = cv2.GaussianBlur(rng.normal(size=(_SIDE, _SIDE)), (0, 0), 4.0)
    return np.clip(np.rint(128 + 42 * tile + 16 * other / other.std()), 0, 255).astype(np.uint8)


def _lines(src: Points, dst: Points) -> np.ndarray:
    """Both ends of each match and a gap, for one stroke."""
    ends = np.full((len(src), 3, 2), np.nan)
    ends[:, 0], ends[:, 1] = src, dst + (_SIDE, 0)
    return ends.reshape(-1, 2).T
