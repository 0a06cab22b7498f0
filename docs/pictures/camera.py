# SPDX-License-Identifier: Apache-2.0
"""Draw what the chapter on cameras does: the board through three lenses, and the fold of a lens model."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imgu_ros.simulate.chessboard import draw_chessboard
from imgu_ros.vision.camera import (
    Chessboard,
    RigidTransform,
    distort,
    exp_so3,
    find_chessboard,
    fold_radius,
    make_camera,
)

BOARD = Chessboard(9, 6, 0.03)
LENSES = (
    ("plumb_bob", (-0.25, 0.01, 0.0, 0.0, 0.0)),
    ("rational_polynomial", (0.6, 0.1, 0.0, 0.0, 0.01, 0.2, 0.05, 0.01)),
    ("equidistant", (0.0, 0.0, 0.0, 0.0)),
)


def draw(path: Path) -> None:
    """Write the picture."""
    pose = RigidTransform(exp_so3([0.35, -0.3, 0.05]), np.array([-0.12, -0.075, 0.22]))
    with mpl.rc_context({"font.size": 8, "axes.titlesize": 8.5, "axes.titlelocation": "left"}):
        figure = Figure(figsize=(9, 2.4), layout="constrained")
        columns = figure.subplots(1, 4, width_ratios=[1, 1, 1, 1.25])
        for axes, (model, k) in zip(columns, LENSES, strict=False):
            camera = make_camera([[150, 0, 149.5], [0, 150, 109.5], [0, 0, 1]], k, model, 300, 220)
            picture = draw_chessboard(BOARD, camera, pose)
            axes.imshow(picture, cmap="gray", vmin=0, vmax=255)
            found = find_chessboard(picture, BOARD)
            if found is not None:
                axes.plot(*found.T, "+", color="#d55e00", markersize=5)
            axes.set_title(model)
            axes.set_axis_off()
        _curves(columns[3])
        figure.savefig(path, dpi=95)


def _curves(axes: Axes) -> None:
    theta = np.linspace(0, np.radians(75), 300)
    along_x = np.column_stack((np.tan(theta), np.zeros_like(theta)))
    for (model, k), color in zip(LENSES, ("#0072b2", "#e69f00", "#009e73"), strict=True):
        axes.plot(np.degrees(theta), distort(model, k, along_x)[0][:, 0], color=color, label=model)
        fold = fold_radius(model, k)
        if np.degrees(np.arctan(fold)) < 75:
            axes.plot(np.degrees(np.arctan(fold)), distort(model, k, [[fold, 0]])[0][0, 0], "o", color=color)
            axes.text(np.degrees(np.arctan(fold)), 0.35, "fold: no inverse beyond", ha="center", fontsize=7)
    axes.plot(np.degrees(theta), np.tan(theta), ":", color="#888888", label="no lens: tan")
    axes.set(ylim=(0, 1.8), xlabel="angle off the axis (deg)", ylabel="distorted radius / f", title="radial part")
    axes.legend(frameon=False, fontsize=7)


if __name__ == "__main__":
    draw(Path(sys.argv[1] if len(sys.argv) > 1 else "camera.png"))
