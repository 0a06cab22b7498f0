# SPDX-License-Identifier: Apache-2.0
"""Chessboards and grids of dots as board files, beside the same prints as ordinary pictures, on the same frames.

    python benchmarks/patterns.py --seeds 31 32 33 --json benchmarks/figures/patterns.json

Frames of 640x480 of `print_views.py`, raw and linear, with clutter. detection: 24 views by themselves of each print, of
which half show it wholly, a quarter a part of it, and a quarter behind a hand; tracking: 24 frames of one path. A print
is right when one of its poses puts the corners within 1 px (rms) of the truth; wrong: one went out as the only pose,
or all were given, and none is within 3 px. other: views with a board of one more row and column; none may go out.
empty: views without a print.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from print_canvas import BLACK, Canvas
from print_drawing import Print
from print_views import RAW_PARAMETERS, View, empty_views, mapped, views

from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer
from imgu_ros.reference.dot_layout import DotLayout
from imgu_ros.reference.marker_layout import MarkerLayout, PlacedSquares
from imgu_ros.reference.pattern import pattern_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_references

Floats = NDArray[np.floating]
Layout = MarkerLayout | DotLayout

WIDTH_M, VIEWS = 0.2, 24
_RIGHT_PX, _WRONG_PX = 1.0, 3.0
_SEEN = ("whole", "whole", "part", "hand")


def drawn(kind: str, columns: int, rows: int) -> tuple[Print, Layout]:
    """Return a print with a margin of white, and what a board file says of it."""
    if kind == "chessboard":
        step = 760 / (columns + 1)
        canvas = Canvas(760, round(step * (rows + 1)))
        for row in range(rows):
            for column in range(columns):
                if (row + column) % 2 == 0:
                    canvas.rectangle((column + 0.5) * step, (row + 0.5) * step, step, step, BLACK)
        layout: Layout = MarkerLayout((), PlacedSquares(columns, rows, WIDTH_M / 760 * step, first_is_black=True))
    else:
        across = 2 if kind == "shifted dots" else 1
        step = 760 / (across * columns + 1)
        canvas = Canvas(760, round(step * (rows + 1)))
        for row in range(rows):
            for column in range(columns):
                x = 760 / 2 + step * (across * (column - (columns - 1) / 2) + (across - 1) * (row % 2 - 0.5))
                canvas.ellipse(x, (row + 1) * step, 0.3 * step, 0.3 * step, BLACK)
        metres = WIDTH_M / 760 * step
        layout = DotLayout(columns, rows, metres, 0.6 * metres, is_shifted=across == 2)
    return Print(f"{kind} {columns}x{rows}", kind, kind, canvas.pixels(), WIDTH_M), layout


def judged(found: object, view: View, print_from_template: Floats, outline: Floats) -> str:
    """Return what became of a print in a view."""
    if found.homography is None:  # type: ignore[attr-defined]
        return "lost"
    corners = mapped(view.H @ print_from_template, outline)
    turns = (np.eye(3), *found.alike)  # type: ignore[attr-defined]
    errors = [
        float(np.sqrt(((mapped(found.homography.H @ S, outline) - corners) ** 2).sum(axis=1).mean()))  # type: ignore[attr-defined]
        for S in turns
    ]
    if min(errors) > _WRONG_PX:
        return "WRONG"
    return "ambiguous" if found.pose is None else "metric" if errors[0] < _RIGHT_PX else "off"  # type: ignore[attr-defined]


def measured(kind: str, seed: int, counts: dict[str, Counter[str]]) -> None:
    """Add a print of a kind."""
    rng = np.random.default_rng([seed, len(kind)])
    columns, rows = (int(rng.integers(4, 6)), int(rng.integers(7, 12))) if kind == "shifted dots" else (
        int(rng.integers(7, 11)), int(rng.integers(5, 9)))  # fmt: skip
    shown, layout = drawn(kind, columns, rows)
    other, _ = drawn(kind, columns + 1, rows + 1)
    height, width = shown.pixels.shape[:2]
    scale = WIDTH_M / width
    to_metres = np.array([[scale, 0, -scale * (width - 1) / 2], [0, -scale, scale * (height - 1) / 2], [0, 0, 1]])
    images = {"board": pattern_image("board", layout), "picture": TargetImage("picture", shown.pixels, WIDTH_M)}
    for route, image in images.items():
        for mode in ("tracking", "detection"):
            parameters = parameters_from({**RAW_PARAMETERS, "tracking.enabled": mode == "tracking"})
            localizer = Localizer(parameters, make_references([image], parameters))
            plane = localizer.references[0].plane
            print_from_template = np.linalg.inv(to_metres) @ plane.metres_from_template
            for index, view in enumerate(views(shown, seed, VIEWS, mode)):
                name = mode if mode == "tracking" else _SEEN[index % 4]
                found = localizer.process(view.frame).first
                counts[f"{route} {name}"][judged(found, view, print_from_template, plane.outline)] += 1
        for name, frames in (("other", views(other, seed, 8, "detection")), ("empty", empty_views(seed, 8))):
            for view in frames:
                counts[f"{route} {name}"]["found" if localizer.process(view.frame).first.status.found else "lost"] += 1


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[31], help="of prints, paths, light and noise")
    parser.add_argument("--json", type=Path, help="write the figures")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    document: dict[str, object] = {"seeds": arguments.seeds}
    for kind in ("chessboard", "dots", "shifted dots"):
        counts: dict[str, Counter[str]] = {}
        for route in ("board", "picture"):
            counts |= {f"{route} {name}": Counter() for name in ("tracking", "whole", "part", "hand", "other", "empty")}
        for seed in arguments.seeds:
            measured(kind, seed, counts)
        document[kind] = {name: dict(each) for name, each in counts.items()}
        for name, each in counts.items():
            print(f"{kind:14}{name:18}", dict(each), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
