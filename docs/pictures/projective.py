# SPDX-License-Identifier: Apache-2.0
"""A figure under each class of plane transformation, with what the class preserves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.projective import (
    affine,
    classify,
    cross_ratio,
    euclidean,
    projective,
    similarity,
    transform,
    transform_lines,
)
from imgu_ros.vision.projective.points_and_lines import LINE_AT_INFINITY

_VIEWS: tuple[tuple[str, Matrix3], ...] = (
    ("lines, cross ratio", projective([[0.65, 0.05], [-0.05, 0.65]], (0, 0), (0.08, -0.45))),
    ("also parallels, ratios of areas", affine([[0.9, 0.5], [-0.1, 0.8]], (0, 0))),
    ("also angles, ratios of lengths", similarity(0.7, 0.5, (0, 0))),
    ("also lengths, areas", euclidean(-0.35, (0.4, 0.2))),
)


def draw(path: Path) -> None:
    """Draw the page's picture."""
    figure = Figure(figsize=(10, 3.2), dpi=80, layout="constrained")
    for axes, (kept, H) in zip(figure.subplots(1, len(_VIEWS)), _VIEWS, strict=True):
        for line in _grid():
            axes.plot(*transform(H, line).T, color="0.75", linewidth=0.8)
        axes.fill(*transform(H, _letter()).T, color="#56b4e9", alpha=0.8)
        diagonal = np.array([[-1, -1], [-0.5, -0.5], [0.5, 0.5], [1, 1]])
        dots = transform(H, diagonal)
        axes.plot(*dots.T, "-", color="#d55e00", linewidth=1)
        axes.plot(*dots.T, "o", color="#d55e00", markersize=4)
        a, b, c = transform_lines(H, [LINE_AT_INFINITY])[0]
        if (a, b) != (0, 0):
            x = np.array([-2.0, 2.0])
            axes.plot(x, (-c - a * x) / b, "--", color="#cc79a7", linewidth=1.5)
            axes.text(0.03, 0.93, "vanishing line", transform=axes.transAxes, fontsize=8, color="#cc79a7", va="top")
        axes.set_title(f"{classify(H)}\nkeeps {kept}\n(A, B; C, D) = {cross_ratio(dots):.6f}", fontsize=9)
        axes.set_aspect("equal")
        axes.set_xlim(-1.75, 1.75)
        axes.set_ylim(1.5, -1.7)  # y points down, as in an image
        axes.set_xticks([])
        axes.set_yticks([])
    figure.savefig(path, metadata={"Software": None}, bbox_inches="tight")


def _grid() -> list[Points]:
    ends = np.linspace(-1, 1, 5)
    return [np.array(line) for x in ends for line in ([[x, -1], [x, 1]], [[-1, x], [1, x]])]


def _letter() -> Points:
    """An F: it has no symmetry."""
    corners = [(-2, -3), (2, -3), (2, -1.8), (-0.6, -1.8), (-0.6, -0.4), (1, -0.4), (1, 0.8), (-0.6, 0.8), (-0.6, 3)]
    return np.array([*corners, (-2, 3)]) / 4
