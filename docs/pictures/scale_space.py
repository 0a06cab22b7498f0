# SPDX-License-Identifier: Apache-2.0
"""The three Gaussian kernels where they differ, and a Laplacian pyramid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.processing import grey_from_rgb
from imgu_ros.vision.scale_space import (
    discrete_gaussian,
    laplacian_pyramid,
    sampled_gaussian,
    smooth,
    smooth_recursively,
)

_COLORS = {"sampled": "#d55e00", "discrete": "#0072b2", "recursive": "#009e73"}
_MARKERS = {"sampled": "s", "discrete": "o", "recursive": "x"}


def draw(path: Path) -> None:
    """Draw both to a PNG file."""
    figure = Figure(figsize=(7.6, 3.4), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subfigures(2, 1, height_ratios=(1.25, 1))
    _draw_variances(*above.subplots(1, 2))
    picture = grey_from_rgb(procedural_texture(160, 120, seed=6))
    parts = laplacian_pyramid(picture, 3)
    shown = [("picture", picture), ("sigma 3 px", smooth(picture, 3.0))]
    shown += [(f"band {k}", 128 + 2.0 * band) for k, band in enumerate(parts.bands)]
    for axes, (title, image) in zip(below.subplots(1, 6).ravel(), [*shown, ("base", parts.base)], strict=True):
        axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axes.set_title(title, fontsize=8)
        axes.set_axis_off()
    figure.savefig(path, pil_kwargs={"optimize": True})


def _draw_variances(kernels: Axes, variances: Axes) -> None:
    n = np.arange(-3, 4)
    sigmas = np.linspace(0.15, 1.2, 22)
    impulse = np.zeros((1, 41), np.float32)
    impulse[0, 20] = 1

    def weights(name: str, sigma: float) -> np.ndarray:
        if name == "recursive":
            return smooth_recursively(impulse, sigma)[0]
        return (sampled_gaussian if name == "sampled" else discrete_gaussian)(sigma, 20)

    for name, color in _COLORS.items():
        style = {"color": color, "marker": _MARKERS[name], "markersize": 4, "lw": 1, "label": name}
        kernels.plot(n, weights(name, 0.6)[17:24], **style)
        got = [float((weights(name, s) * np.arange(-20, 21) ** 2).sum()) / s**2 for s in sigmas]
        variances.plot(sigmas, got, **style)
    kernels.set_title("weights at sigma 0.6 px", fontsize=8)
    variances.set_title("variance / sigma$^2$ against sigma, px", fontsize=8)
    kernels.legend(fontsize=7, frameon=False)
    for axes in (kernels, variances):
        axes.tick_params(labelsize=7)
        axes.spines[["top", "right"]].set_visible(False)
