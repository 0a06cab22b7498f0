# SPDX-License-Identifier: Apache-2.0
"""Table, page and plot of benchmarks/foreign_frames.py."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from print_judging import FOUND_PX

matplotlib.use("Agg")

_COLUMNS: tuple[tuple[str, Callable[[Any], str]], ...] = (
    ("row", lambda f: f.title),
    ("method", lambda f: f.method),
    ("found", lambda f: f"{f.found}/{f.frames}"),
    ("wrong", lambda f: str(f.wrong)),
    ("corner p50 px", lambda f: _number(f.corner_p50_px, 3)),
    ("p90 px", lambda f: _number(f.corner_p90_px, 3)),
    ("poses", lambda f: str(f.poses) if f.poses else ""),
    ("NEES p50", lambda f: _number(f.nees_p50, 2)),
    ("inside", lambda f: "" if f.inside is None else f"{f.inside:.0%}"),
    ("ms", lambda f: _number(f.ms, 1)),
    ("cpu ms", lambda f: _number(f.cpu_ms, 1)),
)
#: Okabe & Ito 2008, in the order of the methods.
_COLOURS, _MARKS = ("#0072b2", "#d55e00", "#e69f00"), "ov^"


def table(figures: Sequence[Any], header: bool = True) -> str:
    """Return figures as lines of a Markdown table."""
    lines = []
    if header:
        lines.append("| " + " | ".join(name for name, _ in _COLUMNS) + " |")
        lines.append("|---|---|" + "---:|" * (len(_COLUMNS) - 2))
    for index, each in enumerate(figures):
        cells = [cell(each) for _, cell in _COLUMNS]
        if index and each.row == figures[index - 1].row:
            cells[0] = ""
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def markdown_page(document: dict[str, Any], figures: Sequence[Any], description: str) -> str:
    """Return a page: what was measured, the table, and how exact the truth was."""
    said = description.split("\n\n")
    versions = document["machine"]["versions"]
    rms = [take["truth_rms_px"] for take in document["takes"]]
    seeds = ", ".join(map(str, document["seeds"]))
    return "\n".join(
        [
            "<!-- SPDX-License-Identifier: Apache-2.0 -->",
            "# Frames of a foreign path tracer",
            "",
            *("\n\n".join(said[2:]).strip().splitlines()),
            "",
            f"Seeds {seeds}, {document['frames']} frames of each row and seed.",
            f"imgu_ros {versions['imgu_ros']}, OpenCV {versions['opencv']}.",
            f"Dots of the test print were {min(rms):.3f} to {max(rms):.3f} px rms from where the truth has them.",
            "Made by `python benchmarks/foreign_frames.py`.",
            "",
            table(figures),
            "",
        ]
    )


def write_plot(path: Path, figures: Sequence[Any], outcomes: Sequence[Any]) -> None:
    """Draw the corner error of every frame, and the share that is found, by row and method."""
    from matplotlib.figure import Figure

    rows = list(dict.fromkeys((f.row, f.title) for f in figures))
    methods = list(dict.fromkeys(f.method for f in figures))
    drawing = Figure(figsize=(10, 1.4 + 0.55 * len(rows)), layout="constrained")
    errors, shares = drawing.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    rng = np.random.default_rng(0)
    for number, method in enumerate(methods):
        offset = (number - (len(methods) - 1) / 2) * 0.26
        style: dict[str, Any] = {"color": _COLOURS[number % 3]}
        for at, (row, _) in enumerate(rows):
            of = [o.corner_px for o in outcomes if (o.row, o.method) == (row, method) and o.corner_px is not None]
            y = at + offset + rng.uniform(-0.07, 0.07, len(of))
            errors.plot(
                np.minimum(of, 1e3), y, _MARKS[number % 3], markersize=2.5, alpha=0.4, markeredgewidth=0, **style
            )
            (figure,) = [f for f in figures if (f.row, f.method) == (row, method)]
            if figure.corner_p50_px is not None:
                ends = (at + offset - 0.12, at + offset + 0.12)
                errors.plot([figure.corner_p50_px] * 2, ends, linewidth=2.5, **style)
            label = method if at == 0 else None
            shares.barh(at + offset, figure.found / figure.frames, 0.22, label=label, **style)
            shares.barh(at + offset, figure.wrong / figure.frames, 0.22, figure.found / figure.frames, color="#000000")
    errors.axvline(FOUND_PX, color="#999999", linewidth=0.8)
    errors.set(xscale="log", xlabel="corner error, px: frames and median", ylim=(len(rows) - 0.5, -0.5))
    errors.set_yticks(range(len(rows)), [title for _, title in rows])
    shares.set(xlabel="share found; black: wrong", xlim=(0, 1.02))
    drawing.legend(*shares.get_legend_handles_labels(), loc="outside lower center", ncols=len(methods), frameon=False)
    content = io.BytesIO()
    drawing.savefig(content, format="png", dpi=110)
    path.write_bytes(content.getvalue())


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
