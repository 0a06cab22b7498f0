# SPDX-License-Identifier: Apache-2.0
"""Pictures of a check: where a target's detail lies, what tells it from its copies, how it looks from afar; plots."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure

from imgu_ros.check.listing import farthest
from imgu_ros.check.trial_views import grey_picture
from imgu_ros.check.verdict import TargetCheck
from imgu_ros.files.plot_style import plot_style
from imgu_ros.reference.self_similarity import Copy
from imgu_ros.reference.template_cells import CELL, cell_means
from imgu_ros.types import Image

#: Longer side of a picture in the page, px.
_SIDE_PX = 420
#: Longer side of the picture whose cells are compared with a copy, px.
_COMPARED_PX = 160
#: Standard deviation at which detail is drawn in full colour, and of a cell with enough to compare; correlation of
#: cells that are alike.
_STRONG, _TEXTURED, _ALIKE = 45.0, 6.0, 0.6
#: How much paler the picture is under a map.
_PALE = 0.65
#: Okabe & Ito 2008.
_BLUE, _ORANGE, _GREEN, _GREY = "#0072b2", "#d55e00", "#009e73", "#888888"
_STYLE: Any = {
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "axes.axisbelow": True,
    "axes.edgecolor": "#888888",
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
}


def plain_picture(check: TargetCheck) -> Image:
    """Return the target, (h, w, 3) RGB."""
    pixels = check.image.pixels
    colour = pixels if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)
    return _scaled(colour, _SIDE_PX)


def detail_picture(check: TargetCheck) -> Image:
    """Return a paler target with its detail in orange, the stronger the more: (h, w, 3) RGB."""
    assert check.traits is not None
    return _tinted(plain_picture(check), np.clip(check.traits.detail / _STRONG, 0, 1), (213, 94, 0))


def telling_picture(check: TargetCheck, copy: Copy) -> Image:
    """Return a paler target with those parts in blue that tell it from its copy: (h, w, 3) RGB."""
    grey = _scaled(grey_picture(check.image), _COMPARED_PX).astype(np.float32)
    height, width = (side // CELL * CELL for side in grey.shape)
    factor = grey.shape[1] / check.image.pixels.shape[1]
    S = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1]])
    flags, border = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE
    moved = cv2.warpPerspective(grey, S @ copy.H @ np.linalg.inv(S), grey.shape[::-1], flags=flags, borderMode=border)
    a, b = (cv2.GaussianBlur(each, (0, 0), 1.0)[:height, :width].copy() for each in (grey, np.asarray(moved)))
    mean_a, mean_b = cell_means(a), cell_means(b)
    power_a, power_b = cell_means(a * a) - mean_a * mean_a, cell_means(b * b) - mean_b * mean_b
    alike = cell_means(a * b) - mean_a * mean_b >= _ALIKE * np.sqrt(np.maximum(power_a * power_b, 0))
    telling = (np.maximum(power_a, power_b) >= _TEXTURED**2) & ~alike
    whole = np.zeros((-(-grey.shape[0] // CELL), -(-grey.shape[1] // CELL)), np.float32)
    whole[: telling.shape[0], : telling.shape[1]] = telling
    return _tinted(plain_picture(check), whole, (0, 80, 200))


def far_picture(check: TargetCheck, longer_px: float) -> Image:
    """Return how a target looks where its longer side has so many px, enlarged: (h, w, 3) RGB."""
    pixels = check.image.pixels
    colour = pixels if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)
    small = cv2.GaussianBlur(_scaled(colour, longer_px), (0, 0), 0.6)
    factor = _SIDE_PX / max(small.shape)
    size = round(small.shape[1] * factor), round(small.shape[0] * factor)
    return np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_NEAREST))


def plot_found(check: TargetCheck) -> Figure:
    """Draw the share of views in which a target is found, by its width, with each view."""
    assert check.curve is not None
    curve, by = check.curve, check.width_of_longer
    sizes = np.geomspace(16, 512, 200)
    with plot_style(_STYLE):
        figure = Figure(figsize=(5.2, 2.9), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(sizes * by, [100 * curve.share(size) for size in sizes], color=_BLUE, label="expected")
        for found, colour, y in ((True, _GREEN, 104), (False, _ORANGE, -4)):
            across = [t.seen_px * math.cos(math.radians(t.tilt_deg)) * by for t in curve.trials if t.found is found]
            axes.plot(across, [y] * len(across), "|", color=colour, label="found" if found else "not found")
        smallest = check.smallest_width_px
        if smallest is not None:
            axes.axvline(smallest, color=_GREY, linestyle="--", linewidth=1)
            axes.annotate(f" {smallest:.0f} px", (smallest, 8), color="#444444")
        axes.set(
            xscale="log", xlabel="width in the image, px (tilted: the shorter, foreshortened way)", ylabel="found, %",
            ylim=(-8, 108), xlim=(16 * by, 512 * by),
        )  # fmt: skip
        _plain_ticks(axes, [size for size in (10, 20, 50, 100, 200, 500) if 16 * by <= size <= 512 * by])
        axes.legend(loc="center right", fontsize=8.5)
    return figure


def plot_accuracy(check: TargetCheck) -> Figure | None:
    """Draw the expected error of position and rotation by distance; None where no pose is expected."""
    known = [e for e in check.errors if e.position_m is not None and e.rotation_deg is not None]
    if len(known) < 2:
        return None
    distances = [e.distance_m for e in known]
    unit = "m" if check.width_m else "widths"
    if check.width_m:
        position, label = [1e3 * float(e.position_m or 0) for e in known], "position, mm"
    else:
        position = [100 * float(e.position_m or 0) / e.distance_m for e in known]
        label = "position, % of the distance"
    with plot_style(_STYLE):
        figure = Figure(figsize=(5.2, 2.9), layout="constrained")
        for index, (values, name) in enumerate(
            ((position, label), ([float(e.rotation_deg or 0) for e in known], "rotation, deg"))
        ):
            axes = figure.add_subplot(1, 2, index + 1)
            axes.plot(distances, values, "o-", color=_BLUE, markersize=3.5)
            axes.set(xscale="log", yscale="log", xlabel=f"distance, {unit}", title=name)
            _plain_ticks(axes, _nice(min(distances), max(distances)))
            ticks = _nice(min(map(float, values)), max(map(float, values)))
            axes.set_yticks(ticks, [f"{tick:.3g}" for tick in ticks])
            far = farthest(check)
            if far is not None:
                axes.axvline(far, color=_GREY, linestyle="--", linewidth=1)
    return figure


def _nice(low: float, high: float) -> list[float]:
    steps = [factor * 10.0**power for power in range(-6, 6) for factor in (1, 2, 5)]
    return [step for step in steps if 0.95 * low <= step <= 1.05 * high]


def _plain_ticks(axes: Any, ticks: list[float]) -> None:
    axes.set_xticks(ticks, [f"{tick:.3g}" for tick in ticks])
    axes.minorticks_off()


def _tinted(picture: Image, strength: Image, colour: tuple[int, int, int]) -> Image:
    pale = 255 - (255 - picture.astype(np.float32)) * (1 - _PALE)
    size = picture.shape[1], picture.shape[0]
    map_ = cv2.resize(np.asarray(strength, np.float32), size, interpolation=cv2.INTER_LINEAR)[:, :, None]
    return np.rint(pale + 0.85 * map_ * (np.array(colour, np.float32) - pale)).astype(np.uint8)


def _scaled(picture: Image, longer_px: float) -> Image:
    factor = longer_px / max(picture.shape[:2])
    size = tuple(max(round(side * factor), CELL) for side in picture.shape[1::-1])
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC))
