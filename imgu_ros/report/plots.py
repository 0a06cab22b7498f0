# SPDX-License-Identifier: Apache-2.0
"""The report's figures, drawn by Matplotlib without a display."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from imgu_ros.files.plot_style import plot_style
from imgu_ros.messages.annotations import STATUS_COLORS
from imgu_ros.report.table import FrameTable
from imgu_ros.result import Stage, Status
from imgu_ros.types import Floats, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Okabe & Ito 2008.
_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
_TRUTH = "#222222"
_WIDTH = 10.0  # inches
_FEW = 400  # frames up to which single ones are marked

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
    "lines.linewidth": 1.3,
    "figure.facecolor": "white",
}


def plot_trajectory(table: FrameTable, target: int) -> Figure | None:
    """Draw the camera's way in the frame of one target: in 3-D, from above and from the side; None without poses."""
    rows = table.of_target(target)
    estimate = table.position[rows]
    truth = None if table.errors is None else table.errors.true_position[rows]
    if np.isnan(estimate).all():
        return None
    with plot_style(_STYLE):
        figure = Figure(figsize=(_WIDTH, 3.7))
        grid = figure.add_gridspec(
            1, 3, width_ratios=[1.25, 1, 1], left=0.0, right=0.985, bottom=0.14, top=0.91, wspace=0.33
        )
        space: Any = figure.add_subplot(grid[0], projection="3d")
        for points, style in _ways(estimate, truth):
            space.plot(points[:, 0], points[:, 2], points[:, 1], **style)
        space.scatter([0], [0], [0], marker="s", color="#999999", s=18)
        space.set(xlabel="x (m)", ylabel="z (m)", zlabel="y (m)")
        space.set_box_aspect(_box(estimate), zoom=0.86)
        space.tick_params(labelsize=7.5, pad=0)
        space.xaxis.labelpad = space.yaxis.labelpad = space.zaxis.labelpad = 2
        space.locator_params(nbins=4)
        space.set_title("  3-D (grey square: the target)")
        for column, (name, across) in enumerate((("from above", 0), ("from the side", 1)), 1):
            flat = figure.add_subplot(grid[column])
            for points, style in _ways(estimate, truth):
                flat.plot(points[:, across], points[:, 2], **style)
            flat.plot([0], [0], marker="s", color="#999999", linestyle="none")
            flat.set(xlabel=f"{'xy'[across]} (m)", ylabel="z, off the target (m)", title=name)
            flat.axis("equal")
            flat.margins(0.1)
        figure.axes[1].legend(loc="best", fontsize=8.5)
    return figure


def plot_errors(table: FrameTable) -> Figure | None:
    """Draw the errors against the truth over time, with what the covariance predicts; None without truth."""
    errors = table.errors
    if errors is None or np.isnan(errors.corner_px).all():
        return None
    panels: list[tuple[str, Floats, Floats | None]] = [("corner error (px)", errors.corner_px, None)]
    if not np.isnan(errors.rotation_deg).all():
        panels.append(("rotation error (deg)", errors.rotation_deg, np.rad2deg(table.sigma_r)))
        panels.append(("translation error (%)", errors.translation_percent, 100 * table.sigma_t / table.distance))
    return _over_time(table, panels)


def plot_precision(table: FrameTable) -> Figure | None:
    """Draw what the estimates say of themselves: residuals and predicted deviations over time; None when none found."""
    panels: list[tuple[str, Floats, Floats | None]] = [("residual of inliers, rms (px)", table.rms_px, None)]
    if not np.isnan(table.sigma_t).all():
        panels.append(("predicted 1σ, position (mm)", 1e3 * table.sigma_t, None))
        panels.append(("predicted 1σ, rotation (deg)", np.rad2deg(table.sigma_r), None))
    return None if np.isnan(table.rms_px).all() else _over_time(table, panels)


def plot_status(table: FrameTable) -> Figure:
    """Draw each target's status, and its matches and inliers, over time."""
    count = len(table.targets)
    x, x_name = _time_axis(table)
    with plot_style(_STYLE):
        figure = Figure(figsize=(_WIDTH, 2.7 + 0.32 * count), layout="constrained")
        grid = figure.add_gridspec(2, 1, height_ratios=[0.32 * count, 2.0])
        strip = figure.add_subplot(grid[0])
        colors = [_hex(status) for status in Status]
        colormap, norm = ListedColormap(colors), BoundaryNorm(np.arange(len(colors) + 1) - 0.5, len(colors))
        for index in range(count):
            rows = table.of_target(index)
            edges = _cell_edges(x[rows])
            values = table.status[rows][None, :]
            strip.pcolormesh(edges, [index - 0.42, index + 0.42], values, cmap=colormap, norm=norm, rasterized=True)
        strip.set_yticks(range(count), table.targets)
        strip.set_ylim(count - 0.5, -0.5)
        strip.grid(visible=False)
        strip.tick_params(labelbottom=False, bottom=False, left=False)
        for side in ("left", "bottom"):
            strip.spines[side].set_visible(False)
        present = [status for i, status in enumerate(Status) if (table.status == i).any()]
        handles = [Patch(color=_hex(s), label=s.value) for s in present]
        strip.legend(handles=handles, ncols=len(handles), loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2)
        lower = figure.add_subplot(grid[1], sharex=strip)
        for index, name in enumerate(table.targets):
            rows, color = table.of_target(index), _COLORS[index % len(_COLORS)]
            lower.plot(x[rows], table.n_matches[rows], color=color, alpha=0.35, linestyle=":", label="matches")
            label = "inliers" if count == 1 else f"inliers, {name}"
            lower.plot(x[rows], table.n_inliers[rows], color=color, **_marks(rows), label=label)
        lower.set(xlabel=x_name, ylabel="count")
        lower.set_ylim(bottom=0)
        _legend(lower)
    return figure


def plot_times(table: FrameTable) -> Figure | None:
    """Draw each stage's time, and the whole frame's over time; None when no frame ran."""
    rows = table.frame_rows
    stages = table.stage_ms[rows]
    total = table.total_ms[rows]
    if np.isnan(total).all():
        return None
    ran = [i for i in range(len(Stage)) if not np.isnan(stages[:, i]).all()]
    x, x_name = _time_axis(table)
    with plot_style(_STYLE):
        figure = Figure(figsize=(_WIDTH, 2.9))
        bars, line = figure.subplots(1, 2, width_ratios=[1, 1.25])
        _set_margins(figure, left=1.2)
        medians = [float(np.nanmedian(stages[:, i])) for i in ran]
        p95 = [float(np.nanpercentile(stages[:, i], 95)) for i in ran]
        bars.barh(range(len(ran)), medians, color=_COLORS[0], height=0.62, label="median")
        bars.plot(p95, range(len(ran)), "|", color=_COLORS[5], markersize=11, markeredgewidth=2, label="95 %")
        bars.set_yticks(range(len(ran)), [list(Stage)[i].value for i in ran])
        bars.invert_yaxis()
        bars.grid(visible=False, axis="y")
        bars.set(xlabel="ms", title="each stage, where it ran")
        _legend(bars)
        line.plot(x[rows], total, color=_COLORS[0], **_marks(rows))
        line.set(xlabel=x_name, ylabel="ms", title="the whole frame")
        line.set_ylim(bottom=0)
    return figure


def _over_time(table: FrameTable, panels: list[tuple[str, Floats, Floats | None]]) -> Figure:
    x, x_name = _time_axis(table)
    several = len(table.targets) > 1
    with plot_style(_STYLE):
        figure = Figure(figsize=(_WIDTH, 1.6 * len(panels) + 0.5))
        axes: list[Axes] = list(figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0])
        _set_margins(figure, left=0.8)
        for axis, (name, values, predicted) in zip(axes, panels, strict=True):
            for index, target in enumerate(table.targets):
                rows, color = table.of_target(index), _COLORS[index % len(_COLORS)]
                label = target if several else ("measured" if predicted is not None else None)
                axis.plot(x[rows], values[rows], color=color, label=label, **_marks(rows))
                if predicted is not None:
                    label = "predicted 1σ"
                    axis.plot(x[rows], predicted[rows], color=color, alpha=0.6, linestyle="--", label=label)
            axis.set_title(name)
            axis.set_ylim(bottom=0)
            _legend(axis)
        axes[-1].set_xlabel(x_name)
    return figure


def _set_margins(figure: Figure, left: float) -> None:
    """Leave room for titles and the names of axes, `left` in inches: finding it takes as long as drawing."""
    width, height = figure.get_size_inches()
    figure.subplots_adjust(
        left=left / width, right=1 - 0.15 / width, bottom=0.55 / height, top=1 - 0.3 / height, wspace=0.15, hspace=0.25
    )


def _ways(estimate: Floats, truth: Floats | None) -> list[tuple[Floats, dict[str, Any]]]:
    marks: dict[str, Any] = {"marker": ".", "markersize": 4} if len(estimate) <= _FEW else {}
    ways: list[tuple[Floats, dict[str, Any]]] = []
    if truth is not None:
        ways.append((truth, {"color": _TRUTH, "linewidth": 3.2, "alpha": 0.25, "label": "truth"}))
    return [*ways, (estimate, {"color": _COLORS[0], "label": "estimate", "linewidth": 1.0, **marks})]


def _box(points: Floats) -> tuple[float, float, float]:
    """Return the 3-D plot's sides (x, z, y): true proportions, but no side below a third of the longest."""
    known = np.vstack((points[~np.isnan(points).any(axis=1)], np.zeros(3)))
    extent = known.max(axis=0) - known.min(axis=0)
    sides = np.maximum(extent, extent.max() / 3)
    return (float(sides[0]), float(sides[2]), float(sides[1]))


def _time_axis(table: FrameTable) -> tuple[Floats, str]:
    """Return each row's place on the x axis: seconds, or the frame's number where stamps do not advance."""
    frames = table.stamp_ns[table.frame_rows]
    if len(frames) > 1 and (np.diff(frames) > 0).all():
        return table.seconds, "time (s)"
    order: Floats = np.empty(len(table))
    for index in range(len(table.targets)):
        rows = table.of_target(index)
        order[rows] = np.arange(int(rows.sum()))
    return order, "frame"


def _cell_edges(x: Floats) -> Floats:
    if len(x) == 1:
        return np.array([x[0] - 0.5, x[0] + 0.5])
    middles = (x[1:] + x[:-1]) / 2
    return np.concatenate(([x[0] - (middles[0] - x[0])], middles, [x[-1] + (x[-1] - middles[-1])]))


def _hex(status: Status) -> str:
    return "#{:02x}{:02x}{:02x}".format(*STATUS_COLORS[status])


def _marks(rows: Mask) -> dict[str, Any]:
    return {"marker": ".", "markersize": 4} if rows.sum() <= _FEW else {}


def _legend(axis: Axes) -> None:
    """Put the legend above the axes, on the right, each name once."""
    handles, labels = axis.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    if unique:
        place: Any = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.1}
        axis.legend(list(unique.values()), list(unique), ncols=6, fontsize=8.5, **place)
