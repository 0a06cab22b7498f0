# SPDX-License-Identifier: Apache-2.0
"""The picture of a calibration: residuals over the image, by their distance from the centre, and by view."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from imgu_ros.errors import FileError
from imgu_ros.file_access.atomic_files import write_whole
from imgu_ros.files.plot_style import plot_style
from imgu_ros.files.vector_figure import VECTOR_SUFFIXES, save_figure
from imgu_ros.types import Floats, Points
from imgu_ros.vision.camera.calibration import Calibration

SUFFIXES = (".png", *VECTOR_SUFFIXES)
_BLUE, _ORANGE, _RED = "#0072b2", "#e69f00", "#d55e00"
_BINS = 12
#: How long the RMS residual is drawn, as a share of the picture's diagonal.
_LENGTH = 0.02
_STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
}


def draw_calibration(path: Path, calibration: Calibration, corners: Sequence[Points]) -> None:
    """Draw the residuals of a calibration.

    Left: every corner with its residual, enlarged; a pattern in them is distortion that the model does not follow.
    Right: the radial and tangential part by the distance from the principal point, all residuals as a histogram beside
    the normal distribution that the covariance assumes, and each view's RMS.

    Parameters
    ----------
    path : .png, .svg, .pdf, .eps or .ps
    calibration : what to draw
    corners : of every view that went into `calibrate`, (N, 2) px

    Raises
    ------
    FileError
        If the suffix is another, or the file cannot be written.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise FileError(f"{path}: suffix {path.suffix!r}; need one of {', '.join(SUFFIXES)}")
    with plot_style(_STYLE):
        figure = Figure(figsize=(11, 5.6), layout="constrained")
        grid = figure.add_gridspec(3, 2, width_ratios=[1.5, 1])
        _draw_vectors(figure.add_subplot(grid[:, 0]), calibration, corners)
        _draw_radial(figure.add_subplot(grid[0, 1]), calibration, corners)
        _draw_histogram(figure.add_subplot(grid[1, 1]), calibration)
        _draw_views(figure.add_subplot(grid[2, 1]), calibration)
        if path.suffix.lower() in VECTOR_SUFFIXES:
            save_figure(figure, path)
            return
        content = io.BytesIO()
        figure.savefig(content, format=path.suffix[1:].lower(), dpi=110)
        write_whole(path, content.getvalue())


def _draw_vectors(axes: Any, calibration: Calibration, corners: Sequence[Points]) -> None:
    camera = calibration.camera
    gain = _LENGTH * float(np.hypot(camera.width, camera.height)) / max(calibration.rms_px, 1e-9)
    for views, color in ((calibration.views, _BLUE), (calibration.outliers, _RED)):
        for view in views:
            seen, off = corners[view.index], -view.residuals
            # An outlier's vectors would cover everything.
            shown = gain if color == _BLUE else min(gain, _LENGTH * camera.width / max(view.rms_px, 1e-9))
            axes.quiver(
                *seen.T, *(shown * off).T, angles="xy", scale_units="xy", scale=1, width=0.0016, color=color, alpha=0.75
            )
    axes.plot(*camera.K[:2, 2], "+", color=_ORANGE, markersize=12, markeredgewidth=2)
    axes.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), xlabel="x (px)", ylabel="y (px)")
    axes.set_aspect("equal")
    outliers = f", refused views red ({len(calibration.outliers)})" if calibration.outliers else ""
    axes.set_title(
        f"residuals x {gain:.0f} over the image: {calibration.rms_px:.3f} px rms a coordinate, {camera.model}{outliers}"
    )


def _draw_radial(axes: Any, calibration: Calibration, corners: Sequence[Points]) -> None:
    seen = np.concatenate([corners[view.index] for view in calibration.views]) - calibration.camera.K[:2, 2]
    residuals = -np.concatenate([view.residuals for view in calibration.views])
    radius = np.maximum(np.hypot(*seen.T), 1e-9)
    outward = seen / radius[:, None]
    parts: dict[str, tuple[Floats, str]] = {
        "radial": ((residuals * outward).sum(axis=1), _BLUE),
        "tangential": (residuals[:, 1] * outward[:, 0] - residuals[:, 0] * outward[:, 1], _ORANGE),
    }
    edges = np.linspace(0, radius.max() * (1 + 1e-9), _BINS + 1)
    bins = np.digitize(radius, edges) - 1
    filled = [k for k in range(_BINS) if np.count_nonzero(bins == k) > 1]
    middles = (edges[:-1] + edges[1:])[filled] / 2
    for name, (values, color) in parts.items():
        means = [float(values[bins == k].mean()) for k in filled]
        errors = [float(values[bins == k].std(ddof=1)) / np.sqrt(np.count_nonzero(bins == k)) for k in filled]
        axes.errorbar(middles, means, errors, color=color, marker=".", linewidth=1, capsize=2, label=name)
    axes.axhline(0, color="#888888", linewidth=0.8)
    axes.set(
        xlabel="distance from the principal point (px)", ylabel="mean (px)", title="measured - projected, by radius"
    )
    axes.legend(ncols=2, fontsize=8)


def _draw_histogram(axes: Any, calibration: Calibration) -> None:
    values = np.concatenate([view.residuals for view in calibration.views]).ravel()
    sigma = max(calibration.rms_px, 1e-12)
    reach = min(6 * sigma, max(float(np.abs(values).max()), 3 * sigma))
    axes.hist(np.clip(values, -reach, reach), bins=41, range=(-reach, reach), density=True, color=_BLUE, alpha=0.6)
    x = np.linspace(-reach, reach, 200)
    axes.plot(x, np.exp(-(x**2) / (2 * sigma**2)) / (sigma * np.sqrt(2 * np.pi)), color=_RED, linewidth=1.2)
    axes.set_yticks([])
    axes.set(xlabel="residual (px)", title="all coordinates, and the normal distribution of their rms")


def _draw_views(axes: Any, calibration: Calibration) -> None:
    for views, color in ((calibration.views, _BLUE), (calibration.outliers, _RED)):
        axes.bar([view.index for view in views], [view.rms_px for view in views], color=color, width=0.8)
    if calibration.outliers:
        axes.set_ylim(0, 4 * calibration.rms_px)
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set(xlabel="view", ylabel="rms (px)", title="each view")
