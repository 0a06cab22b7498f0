# SPDX-License-Identifier: Apache-2.0
"""Figures of `printed_targets.py`: sums by class and kind, tables, and a plot."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from print_drawing import DRAWINGS, SIBLING
from print_judging import FLIPPED_DEG, FOUND_PX, NEES_95, RECIPES
from print_views import MODES

matplotlib.use("Agg")

GROUPS = (*DRAWINGS, SIBLING)
_IN_VIEW = {"empty": "no print", "another": "another print", "sibling": "its sibling"}
#: Okabe & Ito 2008.
_COLOURS = {"right": "#009e73", "wrong": "#d55e00", "SIFT": "#000000", "ORB": "#0072b2"}


def summary(outcomes: Sequence[Any], siblings: Sequence[Any], negatives: Sequence[Any]) -> dict[str, Any]:
    """Return the figures by class and by kind, the siblings', the negatives', and every wrong homography."""
    rows = []
    for mode in MODES:
        of_mode = [o for o in outcomes if o.mode == mode]
        for group in GROUPS:
            of_group = [o for o in of_mode if o.group == group]
            if of_group:
                rows.append({"class": group, "kind": "", "mode": mode} | figures_of(of_group))
            for kind in dict.fromkeys(o.kind for o in of_group):
                rows.append(
                    {"class": group, "kind": kind, "mode": mode} | figures_of([o for o in of_group if o.kind == kind])
                )
        if of_mode:
            rows.append({"class": "all", "kind": "", "mode": mode} | figures_of(of_mode))
    return {
        "rows": rows,
        "siblings": [
            {"kind": kind, "mode": mode} | _sibling_figures(of)
            for kind in dict.fromkeys(s.kind for s in siblings)
            for mode in MODES
            if (of := [s for s in siblings if s.kind == kind and s.mode == mode])
        ],
        "negatives": [
            _negative_figures(sort, [n for n in negatives if n.sort == sort])
            for sort in dict.fromkeys(n.sort for n in negatives)
        ],
        "wrong": [_wrong(o) for o in outcomes if o.corner_px is not None and o.corner_px > FOUND_PX],
    }


def figures_of(outcomes: Sequence[Any]) -> dict[str, Any]:
    """Return the figures of some views; see `printed_targets.py`."""
    published = [o for o in outcomes if o.nees is not None]
    right = [o for o in published if o.corner_px <= FOUND_PX]
    wrong = [o for o in published if o.corner_px > FOUND_PX]
    others = [o for o in outcomes if o.nees is None and o.corner_px is not None]
    withheld = Counter(_kind_of_reason(o.reason) for o in outcomes if o.nees is None)
    figures: dict[str, Any] = {
        "frames": len(outcomes),
        "published": len(published),
        "right": len(right),
        "wrong": len(wrong),
        "copies": sum(o.copy for o in wrong),
        "flipped": sum(o.rotation_deg > FLIPPED_DEG for o in right),
        "unpublished_right": sum(o.corner_px <= FOUND_PX for o in others),
        "unpublished_wrong": sum(o.corner_px > FOUND_PX for o in others),
        "withheld": dict(withheld.most_common()),
        "corner_p50_px": _median([o.corner_px for o in right]),
        "nees_p50": _median([o.nees for o in right]),
        "inside_95": float(np.mean([o.nees < NEES_95 for o in right])) if right else None,
    }
    for name in RECIPES:
        errors = [o.recipes_px[name] for o in outcomes if o.recipes_px.get(name) is not None]
        figures[name] = {"right": sum(e <= FOUND_PX for e in errors), "wrong": sum(e > FOUND_PX for e in errors)}
    return figures


def _kind_of_reason(reason: str) -> str:
    return reason.partition(" (")[0].partition(", need")[0].partition(": ")[0] or "none"


def _median(values: Iterable[float]) -> float | None:
    values = list(values)
    return float(np.median(values)) if values else None


def _sibling_figures(of: Sequence[Any]) -> dict[str, Any]:
    return {"frames": len(of)} | {
        name: sum(getattr(s, name) for s in of) for name in ("own", "right", "other", "same_place")
    }


def _negative_figures(sort: str, of: Sequence[Any]) -> dict[str, Any]:
    return {
        "sort": sort,
        "frames": sum(n.frames for n in of),
        "poses": sum(n.poses for n in of),
        "homographies": sum(n.homographies for n in of),
        "kinds": {kind: poses for kind in dict.fromkeys(n.kind for n in of) if (poses := _poses(of, kind))},
    }


def _poses(of: Sequence[Any], kind: str) -> int:
    return sum(n.poses for n in of if n.kind == kind)


def _wrong(o: Any) -> dict[str, Any]:
    """Return what is known of a wrong homography."""
    return {
        "kind": o.kind, "seed": o.seed, "mode": o.mode, "index": o.index, "status": o.status,
        "pose": o.pose_status, "corner_px": round(o.corner_px, 1) if np.isfinite(o.corner_px) else None,
        "origin": o.origin, "copy": o.copy, "points": o.points,
        "rms_px": None if o.rms_px is None else round(o.rms_px, 3),
        "confirmed_share": None if o.confirmed_share is None else round(o.confirmed_share, 3),
        "visible": round(o.visible, 2), "tilt_deg": round(o.tilt_deg, 1),
    }  # fmt: skip


# Tables

_COLUMNS: tuple[tuple[str, Callable[[dict[str, Any]], str]], ...] = (
    ("frames", lambda r: str(r["frames"])),
    ("published", lambda r: str(r["published"])),
    ("right", lambda r: str(r["right"])),
    ("wrong", lambda r: str(r["wrong"])),
    ("copies", lambda r: str(r["copies"])),
    ("flipped", lambda r: str(r["flipped"])),
    ("unpublished right / wrong", lambda r: f"{r['unpublished_right']} / {r['unpublished_wrong']}"),
    ("p50 px", lambda r: _number(r["corner_p50_px"])),
    ("NEES p50", lambda r: _number(r["nees_p50"])),
    ("inside", lambda r: "" if r["inside_95"] is None else f"{r['inside_95']:.0%}"),
    *((name, lambda r, n=name: f"{r[n]['right']} / {r[n]['wrong']}") for name in RECIPES),
)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def markdown_page(figures: dict[str, Any], description: str) -> str:
    """Return the page with the tables: classes, then kinds, the worst first."""
    said = description.split("\n\n")
    lines = ["<!-- SPDX-License-Identifier: Apache-2.0 -->", "# Kinds of prints", "", said[2], "", said[3].strip(), ""]
    versions = figures["machine"]["versions"]
    lines += [
        f"Seed {', '.join(map(str, figures['seeds']))}; imgu_ros {versions['imgu_ros']}, OpenCV {versions['opencv']}.",
        "Made by `python benchmarks/printed_targets.py`.",
        "",
        "![Shares of right and wrong poses by kind](../benchmarks/figures/printed_targets.png)",
        "",
    ]
    classes = [row for row in figures["rows"] if not row["kind"]]
    lines += _table(("class", "mode"), [((row["class"], row["mode"]), row) for row in classes])
    for mode in MODES:
        kinds = [row for row in figures["rows"] if row["kind"] and row["mode"] == mode]
        kinds.sort(key=lambda row: (-row["wrong"], row["right"] - row["frames"]))
        lines += ["", f"## {mode.capitalize()}, worst first", ""]
        lines += _table(("kind",), [((row["kind"],), row) for row in kinds], reasons=True)
    if figures["siblings"]:
        lines += ["", "## Siblings", ""]
        lines += [
            "| kind | mode | frames | own pose | right | sibling's pose | both at one place |",
            "|---|---|" + "---:|" * 5,
        ]
        for s in figures["siblings"]:
            counts = " | ".join(str(s[name]) for name in ("frames", "own", "right", "other", "same_place"))
            lines.append(f"| {s['kind']} | {s['mode']} | {counts} |")
    if figures["negatives"]:
        lines += [
            "",
            "## Negatives",
            "",
            "| in view | frames | poses | homographies | targets |",
            "|---|---:|---:|---:|---|",
        ]
        for n in figures["negatives"]:
            kinds_of = ", ".join(f"{kind} {count}" for kind, count in n["kinds"].items())
            lines.append(f"| {_IN_VIEW[n['sort']]} | {n['frames']} | {n['poses']} | {n['homographies']} | {kinds_of} |")
    return "\n".join(lines) + "\n"


def _table(
    heads: tuple[str, ...], rows: Sequence[tuple[tuple[str, ...], dict[str, Any]]], reasons: bool = False
) -> list[str]:
    last = ("most withheld",) if reasons else ()
    lines = ["| " + " | ".join((*heads, *(name for name, _ in _COLUMNS), *last)) + " |"]
    lines.append("|" + "---|" * len(heads) + "---:|" * len(_COLUMNS) + "---|" * len(last))
    for names, row in rows:
        cells = [*names, *(cell(row) for _, cell in _COLUMNS)]
        if reasons:
            most = next(iter(row["withheld"].items()), None)
            cells.append("" if most is None else f"{most[0]} ({most[1]})")
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def write_plot(path: Path, figures: dict[str, Any]) -> None:
    """Draw shares of right and wrong poses of each kind, beside those of the recipes."""
    from matplotlib.figure import Figure

    kinds = [(row["class"], row["kind"]) for row in figures["rows"] if row["kind"] and row["mode"] == MODES[0]]
    figure = Figure(figsize=(11, 1.5 + 0.2 * len(kinds)), layout="constrained")
    for axes, mode in zip(figure.subplots(1, len(MODES), sharey=True), MODES, strict=True):
        rows = {row["kind"]: row for row in figures["rows"] if row["mode"] == mode and row["kind"]}
        of = [rows[kind] for _, kind in kinds]
        y = np.arange(len(kinds))
        right, wrong = (np.array([row[name] / row["frames"] for row in of]) for name in ("right", "wrong"))
        axes.barh(y, right, color=_COLOURS["right"], label="right pose")
        axes.barh(y, wrong, left=right, color=_COLOURS["wrong"], label="wrong pose")
        for name, mark in zip(RECIPES, "|x", strict=True):
            share = [row[name]["right"] / row["frames"] for row in of]
            axes.plot(share, y, mark, color=_COLOURS[name], markersize=6, label=f"{name} right")
        axes.set_yticks(y, [kind for _, kind in kinds], fontsize=7)
        axes.set_ylim(len(kinds) - 0.4, -0.6)
        axes.set_xlim(0, 1.02)
        axes.set_xlabel("share of views")
        axes.set_title(mode)
        for at in (i for i in range(1, len(kinds)) if kinds[i][0] != kinds[i - 1][0]):
            axes.axhline(at - 0.5, color="#999999", linewidth=0.8)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=110)
    path.write_bytes(content.getvalue())
