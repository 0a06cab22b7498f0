# SPDX-License-Identifier: Apache-2.0
"""Draw what the chapter on estimation does: a line among outliers, robust losses, and the minimisers' ways down."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from imgu_ros.types import Floats
from imgu_ros.vision.estimation import (
    Linearisation,
    LineModel,
    Minimiser,
    cauchy,
    fit_line,
    huber,
    minimise,
    ransac,
    tukey,
)

COLOURS = ("#0072b2", "#d55e00", "#009e73")


class Decay:
    """y = a exp(-b x), through a few points."""

    def __init__(self) -> None:
        self.x = np.linspace(0, 4, 12)
        self.y = 3 * np.exp(-0.7 * self.x) + np.random.default_rng(0).normal(0, 0.1, 12)

    def linearise(self, estimate: Floats) -> Linearisation:
        """Return residuals and derivative."""
        e = np.exp(-estimate[1] * self.x)
        jacobian = np.stack((e, -estimate[0] * self.x * e), axis=1)
        return Linearisation((estimate[0] * e - self.y)[:, None], jacobian[:, None])

    def step(self, estimate: Floats, delta: Floats) -> Floats:
        """Return the moved estimate."""
        return estimate + delta


def draw(path: Path) -> None:
    """Write the picture."""
    with mpl.rc_context({"font.size": 8, "axes.titlesize": 8.5, "axes.titlelocation": "left"}):
        figure = Figure(figsize=(9, 2.6), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        rng = np.random.default_rng(2)
        along = rng.uniform(0, 10, 30)
        points = np.column_stack((7 - 0.1 * along + rng.normal(0, 0.12, 30), along))
        points = np.concatenate((points, rng.uniform(0, 10, (30, 2))))
        found = ransac(LineModel(points), 0.4, rng)
        left.plot(*points[~found.inliers].T, ".", color="#999999")
        left.plot(*points[found.inliers].T, ".", color=COLOURS[0])
        for line, style in ((found.hypothesis, "-"), (fit_line(points).line, "--")):
            normal, foot = line[:2], -line[2] * line[:2]
            ends = foot + np.array([[-30.0], [30.0]]) * [-normal[1], normal[0]]
            left.plot(*ends.T, style, color="black", linewidth=1)
        left.set(xlim=(0, 10), ylim=(0, 10), aspect="equal", title="RANSAC; dashed: all points")

        r = np.linspace(0, 4, 200)
        middle.plot(r, r**2, color="black", linewidth=1, label="square")
        for loss, colour in zip((huber, cauchy, tukey), COLOURS, strict=True):
            middle.plot(r, loss(1.5)(r**2)[1], color=colour, label=loss.__name__)
        middle.set(ylim=(0, 8), xlabel="residual", title="robust losses, scale 1.5")
        middle.legend(frameon=False)

        problem, start = Decay(), np.array([1.0, 0.1])
        best = (minimise(problem, start).linearisation.residuals ** 2).sum()
        for method, colour in zip(Minimiser, COLOURS, strict=True):
            costs = [
                (minimise(problem, start, method, max_iterations=k).linearisation.residuals ** 2).sum()
                for k in range(31)
            ]
            right.semilogy(
                np.maximum(np.array(costs) - best, 1e-12),
                color=colour,
                linestyle="--" if method is Minimiser.LEVENBERG_MARQUARDT else "-",
                label=method.replace("_", " "),
            )
        right.set(xlabel="steps", title="cost above the least")
        right.legend(frameon=False)
        figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw(Path(sys.argv[1] if len(sys.argv) > 1 else "estimation.png"))
