# SPDX-License-Identifier: Apache-2.0
"""Figures as one picture: accuracy over time, and what is found under each condition."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from imgu_ros.bench.figures import Figures
from imgu_ros.bench.recipes import DETECTION, ORB, SIFT, TITLES, TRACKING
from imgu_ros.bench.suites import SEQUENCE, SINGLE
from imgu_ros.file_access.atomic_files import write_whole
from imgu_ros.files.plot_style import plot_style
from imgu_ros.simulate.conditions import PLAIN

#: Okabe & Ito 2008.
_COLORS = {TRACKING: "#0072b2", DETECTION: "#56b4e9", ORB: "#e69f00", SIFT: "#d55e00"}
_MARKS = {TRACKING: "o", DETECTION: "s", ORB: "^", SIFT: "v"}
_STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "axes.axisbelow": True,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "legend.frameon": False,
}


def write_plot(path: Path, rows: Sequence[Figures]) -> bool:
    """Draw the figures into a file; return whether there was something to draw.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    plain = [r for r in rows if r.condition == PLAIN.name and r.kind == SEQUENCE and r.corner_p50_px]
    robust = [(kind, size) for kind in (SEQUENCE, SINGLE) for size in _sizes(rows, kind)]
    if not plain and not robust:
        return False
    conditions = list(dict.fromkeys(r.condition for r in rows if r.kind in (SEQUENCE, SINGLE)))
    with plot_style(_STYLE):
        panels = (1 if plain else 0) + len(robust)
        figure = Figure(figsize=(10, 3.4 * bool(plain) + 3.2 * len(robust)), layout="constrained")
        axes = list(figure.subplots(panels, 1, squeeze=False)[:, 0])
        if plain:
            _time_and_accuracy(axes.pop(0), plain)
        for kind, size in robust:
            _found(axes.pop(0), rows, kind, size, conditions)
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=110)
    write_whole(path, content.getvalue())
    return True


def _sizes(rows: Sequence[Figures], kind: str) -> list[str]:
    """Return the sizes of a kind of frames that were measured under several conditions."""
    sizes = dict.fromkeys(r.size for r in rows if r.kind == kind)
    return [s for s in sizes if len({r.condition for r in rows if r.kind == kind and r.size == s}) > 1]


def _time_and_accuracy(axis: Any, rows: Sequence[Figures]) -> None:
    for method in dict.fromkeys(r.method for r in rows):
        of_method = [r for r in rows if r.method == method]
        style = {"color": _COLORS.get(method), "marker": _MARKS.get(method, "o"), "label": TITLES.get(method, method)}
        axis.plot([r.median_ms for r in of_method], [r.corner_p50_px for r in of_method], **style, linewidth=0.8)
        for r in of_method:
            axis.annotate(f" {r.size}", (r.median_ms, r.corner_p50_px), fontsize=7, va="bottom")
    axis.set(
        xscale="log", yscale="log", xlabel="ms a frame, median", ylabel="corner error, median px",
        title="time and accuracy on smooth sequences (left and low is better)",
    )  # fmt: skip
    axis.legend(fontsize=8)


def _found(axis: Any, rows: Sequence[Figures], kind: str, size: str, conditions: Sequence[str]) -> None:
    chosen = [r for r in rows if r.kind == kind and r.size == size and r.fine is not None]
    methods = list(dict.fromkeys(r.method for r in chosen))
    places = [c for c in conditions if any(r.condition == c for r in chosen)]
    for number, method in enumerate(methods):
        for what, alpha in (("found", 0.35), ("fine", 1.0)):
            by = {r.condition: getattr(r, what) for r in chosen if r.method == method}
            x = [i + 0.8 * (number + 0.5) / len(methods) - 0.4 for i, c in enumerate(places) if c in by]
            heights = [100 * by[c] for c in places if c in by]
            label = TITLES.get(method, method) if what == "fine" else None
            axis.bar(x, heights, 0.8 / len(methods), color=_COLORS.get(method), alpha=alpha, label=label)
    axis.set_xticks(range(len(places)), places, rotation=60, ha="right", fontsize=7.5)
    axis.set(ylabel="% of targets", ylim=(0, 104))
    axis.set_title(f"{kind}, {size}: found within 1 px (pale: within 10 px)")
    axis.grid(visible=False, axis="x")
    axis.legend(fontsize=8, ncols=len(methods), loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.1)
