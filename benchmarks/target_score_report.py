# SPDX-License-Identifier: Apache-2.0
"""Page and plot of `target_scores.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

matplotlib.use("Agg")

#: Okabe & Ito 2008.
_BLUE, _ORANGE, _GREEN, _GREY = "#0072b2", "#d55e00", "#009e73", "#999999"


def markdown_page(figures: dict[str, Any], docstring: str) -> str:
    """Return the page with its tables."""
    s, machine = figures["summary"], figures["machine"]
    seeds = ", ".join(map(str, figures["seeds"]))
    title, _, rest = docstring.partition("\n")
    prose = "\n\n".join(part for part in rest.strip().split("\n\n") if "python benchmarks/" not in part)
    lines = [
        "<!-- SPDX-License-Identifier: Apache-2.0 -->",
        "# How far `imgu check` is right",
        "",
        title,
        "",
        prose,
        "",
        f"Seed {seeds}; {s['prints']} prints; OpenCV {machine['versions'].get('opencv', '')}.",
        "Made by `python benchmarks/target_scores.py`.",
        "",
        "![Score and share found; promised and measured](../benchmarks/figures/target_scores.png)",
        "",
        "| | targets | held within 30 % | promised / measured, 5 % | median | 95 % |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, title in (("smallest", "smallest size"), ("position", "position error"), ("rotation", "rotation error")):
        v = s[name]
        lines.append(
            f"| {title} | {v['targets']} | {v['held']} ({v['held'] / max(v['targets'], 1):.0%}) | {v['p5']:.2f} | "
            f"{v['p50']:.2f} | {v['p95']:.2f} |"
        )
    words = (
        f"Spearman's rank correlation of score and share found: {s['spearman']:.2f}. A smallest size was promised of "
        f"{s['promised_only']} prints that are never found so dependably, and denied of {s['measured_only']} that are. "
        f"SIFT's recipe needs targets {s['sift_times_as_large']:.1f} times as large, and finds {s['sift_never']} at no "
        "size dependably that the pipeline finds."
    )
    lines += [
        "",
        words,
        "",
        "| kind | score | found | promised px | measured px | SIFT px | position | rotation | reasons |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---|",
    ]
    for row in sorted(figures["rows"], key=lambda each: (each["score"], each["found"])):
        sizes = " | ".join(_px(row[name]) for name in ("promised_px", "measured_px", "sift_px"))
        errors = " | ".join(_ratio(row[name]) for name in ("position", "rotation"))
        reasons = ", ".join(row["reasons"]).replace("_", " ")
        lines.append(f"| {row['kind']} | {row['score']} | {row['found']:.0%} | {sizes} | {errors} | {reasons} |")
    return "\n".join(lines) + "\n"


def write_plot(path: Path, figures: dict[str, Any]) -> None:
    """Draw score against share, promised against measured sizes, and the ratios of errors."""
    rows = figures["rows"]
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
    left.plot([r["score"] for r in rows], [100 * r["found"] for r in rows], "o", color=_BLUE, label="pipeline")
    left.plot(
        [r["score"] for r in rows], [100 * r["sift_found"] for r in rows], ".", color=_GREY, label="SIFT's recipe"
    )
    left.set(
        xlabel="score of imgu check", ylabel="views found, %", title=f"Spearman {figures['summary']['spearman']:.2f}"
    )
    left.legend(frameon=False)
    both = [r for r in rows if r["promised_px"] and r["measured_px"]]
    middle.plot([r["measured_px"] for r in both], [r["promised_px"] for r in both], "o", color=_BLUE)
    ends = np.array((20, 250))
    middle.plot(ends, ends, color="#333333", linewidth=1)
    middle.fill_between(ends, ends / 1.3, ends * 1.3, color=_GREY, alpha=0.25, linewidth=0)
    middle.set(
        xscale="log", yscale="log", xlabel="measured smallest size, px", ylabel="promised, px", title="grey: 30 %"
    )
    for axis in (middle.xaxis, middle.yaxis):
        axis.set_ticks([25, 50, 100, 200], ["25", "50", "100", "200"])
        axis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    for index, (name, colour) in enumerate((("position", _ORANGE), ("rotation", _GREEN))):
        values = sorted(r[name] for r in rows if r[name])
        right.plot(values, (np.arange(len(values)) + 0.5) / len(values) * 100, color=colour, label=name)
        right.axvspan(1 / 1.3, 1.3, color=_GREY, alpha=0.12 if index else 0.13, linewidth=0)
    right.set(
        xscale="log", xlim=(0.4, 2.5), xlabel="measured error / promised", ylabel="targets, %", title="grey: 30 %"
    )
    right.set_xticks([0.5, 0.77, 1, 1.3, 2], ["0.5", "0.77", "1", "1.3", "2"])
    right.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    right.legend(frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


def _px(value: float | None) -> str:
    return "never" if value is None else f"{value:.0f}"


def _ratio(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
