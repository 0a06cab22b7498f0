# SPDX-License-Identifier: Apache-2.0
"""The camera's path before a target as drawings (SVG): from above and from the side."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imgu_ros.types import Floats

#: Of a drawing, and its margin for the names of axes, units of the drawing.
_WIDTH, _HEIGHT, _MARGIN = 520.0, 380.0, 46.0
_TICKS = 5
#: Farther away no camera is: such a number is none.
_FARTHEST_M = 1e6


@dataclass(frozen=True, slots=True)
class PathView:
    """A drawing, to be filled into the page.

    Attributes
    ----------
    target, across : indices: of the target, and of the coordinate that goes to the right (0: x, 1: y); z goes up
    name : of the view
    width, height : of the drawing
    scale, left, bottom : a point is at left + scale * (x or y), bottom - scale * z
    target_x, target_y : where the target's centre is
    estimate, truth : SVG path data; no truth: empty
    ticks_x, ticks_y : places and numbers
    label_x : of the axis
    """

    target: int
    across: int
    name: str
    width: float
    height: float
    scale: float
    left: float
    bottom: float
    target_x: float
    target_y: float
    estimate: str
    truth: str
    ticks_x: tuple[tuple[float, str], ...]
    ticks_y: tuple[tuple[float, str], ...]
    label_x: str


def path_views(target: int, path: Floats, truth: Floats | None) -> Iterator[PathView]:
    """Yield two drawings of a path; none without a pose.

    Parameters
    ----------
    target : index, which the drawings carry
    path, truth : (P, 3) positions of the camera in the target's frame, m; NaN where there is none
    """
    path = np.where(np.abs(path) < _FARTHEST_M, path, np.nan)
    known = path[~np.isnan(path).any(axis=1)]
    if not len(known):
        return
    for across, name in ((0, "from above"), (1, "from the side")):
        points = np.vstack((known[:, [across, 2]], np.zeros(2)))
        low, high = points.min(axis=0), points.max(axis=0)
        room = np.array([_WIDTH - 1.5 * _MARGIN, _HEIGHT - 1.5 * _MARGIN])
        scale = float((room / np.maximum(high - low, 1e-3)).min())
        left = _MARGIN + (room[0] - scale * (high[0] - low[0])) / 2 - scale * low[0]
        bottom = _HEIGHT - _MARGIN - (room[1] - scale * (high[1] - low[1])) / 2 + scale * low[1]
        leftmost, right = (_MARGIN - left) / scale, (_WIDTH - left) / scale
        lowest, top = (bottom - _HEIGHT + _MARGIN) / scale, bottom / scale
        yield PathView(
            target, across, name, _WIDTH, _HEIGHT, scale, left, bottom, left, bottom,
            _data(path, across, scale, left, bottom),
            "" if truth is None else _data(truth, across, scale, left, bottom),
            tuple((round(left + scale * value, 1), text) for value, text in _ticks(leftmost, right)),
            tuple((round(bottom - scale * value, 1), text) for value, text in _ticks(lowest, top)),
            f"{'xy'[across]} (m)",
        )  # fmt: skip


def _data(path: Floats, across: int, scale: float, left: float, bottom: float) -> str:
    """Return the path data of an SVG; a gap where there is no pose."""
    parts = []
    pen = "M"
    for x, z in path[:, [across, 2]].tolist():
        if math.isnan(x) or math.isnan(z):
            pen = "M"
            continue
        parts.append(f"{pen}{left + scale * x:.1f} {bottom - scale * z:.1f}")
        # A single point is seen as a dot: round ends of a line without length.
        if pen == "M":
            parts.append("h0")
        pen = "L"
    return "".join(parts)


def _ticks(low: float, high: float) -> Iterator[tuple[float, str]]:
    """Yield round numbers from low to high, about `_TICKS`."""
    rough = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = power * next(factor for factor in (1, 2, 5, 10) if factor * power >= rough)
    for count in range(math.ceil(low / step), math.floor(high / step) + 1):
        yield count * step, f"{round(count * step, 9):g}"
