# SPDX-License-Identifier: Apache-2.0
"""Figures as tables for people: ours beside the recipes, absolute and as ratios."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from imgu_ros.bench.figures import Figures
from imgu_ros.bench.memory import PeakMemory
from imgu_ros.bench.recipes import ORB, SIFT, TITLES
from imgu_ros.bench.suites import ABSENT, SEQUENCE, Growth, Row
from imgu_ros.simulate.conditions import PLAIN

_HEAD = (
    "method", "ms", "p95 ms", "cpu ms", "ORB / it (ms / cpu / px)",
    "SIFT / it (ms / cpu / px)", "corner p50 px", "p95 px", "found", "<= 1 px", "false",
    "rotation deg", "position %", "NEES p50",
)  # fmt: skip


def tables(rows: Sequence[Row], markdown: bool = False) -> str:
    """Return every row in tables, one for each kind of frames, size and condition group.

    Parameters
    ----------
    rows : as `run_suite` yields them
    markdown : pipes instead of aligned columns
    """
    parts = []
    measured = [row for row in rows if isinstance(row, Figures)]
    for group in _groups(measured):
        parts.append(_titled(group.title, _table([(group.first, *_HEAD), *_lines(group)], markdown), markdown))
    stages = [row for row in measured if row.condition == PLAIN.name and row.stages_ms]
    if stages:
        parts.append(
            _titled("Time of each stage, ms (median, where it ran)", _table(_stage_lines(stages), markdown), markdown)
        )
    peaks = [row for row in rows if isinstance(row, PeakMemory)]
    if peaks:
        lines: list[tuple[str, ...]] = [("size", "method", "peak MB", "imports MB")]
        lines += [(p.size, TITLES.get(p.method, p.method), f"{p.peak_mb:.0f}", f"{p.imports_mb:.0f}") for p in peaks]
        parts.append(_titled("Peak memory of a process with one method", _table(lines, markdown), markdown))
    growths = [row for row in rows if isinstance(row, Growth)]
    if growths:
        lines = [("size", "frames", "early MB", "late MB", "growth MB")]
        lines += [
            (g.size, str(g.frames), f"{g.early_mb:.1f}", f"{g.late_mb:.1f}", f"{g.late_mb - g.early_mb:+.1f}")
            for g in growths
        ]
        parts.append(_titled("Memory over a long sequence (tracking)", _table(lines, markdown), markdown))
    return "\n\n".join(parts)


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """One table: its title, the head of its first column, and the rows with what stands there."""

    title: str
    first: str
    rows: list[tuple[str, Figures]]


def _groups(rows: Sequence[Figures]) -> list[_Group]:
    """Return the rows of each table: one table for all sizes under one condition, else one for each size."""
    words = {SEQUENCE: "smooth sequences", ABSENT: "frames without a target"}
    groups = []
    for kind in dict.fromkeys(row.kind for row in rows):
        of_kind = [row for row in rows if row.kind == kind]
        name = words.get(kind, "single, unrelated frames")
        conditions = list(dict.fromkeys(row.condition for row in of_kind))
        if len(conditions) == 1:
            groups.append(_Group(f"{name}, {conditions[0]}", "size", [(row.size, row) for row in of_kind]))
            continue
        for size in dict.fromkeys(row.size for row in of_kind):
            chosen = [(row.condition, row) for row in of_kind if row.size == size]
            groups.append(_Group(f"{name}, {size}", "condition", chosen))
    return groups


def _lines(group: _Group) -> list[tuple[str, ...]]:
    lines: list[tuple[str, ...]] = []
    previous = ""
    for label, row in group.rows:
        beside = {r.method: r for other, r in group.rows if other == label}
        lines.append((label if label != previous else "", *_cells(row, beside)))
        previous = label
    return lines


def _cells(row: Figures, beside: dict[str, Figures]) -> tuple[str, ...]:
    return (
        TITLES.get(row.method, row.method),
        _number(row.median_ms, 1),
        _number(row.p95_ms, 1),
        _number(row.cpu_ms, 1),
        _quotient(beside.get(ORB), row),
        _quotient(beside.get(SIFT), row),
        _number(row.corner_p50_px, 3),
        _number(row.corner_p95_px, 3),
        _percent(row.found),
        _percent(row.fine),
        str(row.false),
        _number(row.rotation_p50_deg, 4),
        _number(row.translation_p50_percent, 4),
        _number(row.nees_p50, 2),
    )


def _stage_lines(rows: Sequence[Figures]) -> list[tuple[str, ...]]:
    stages = list(dict.fromkeys(stage for row in rows for stage in row.stages_ms))
    lines: list[tuple[str, ...]] = [("size", "frames", "method", *stages)]
    for row in rows:
        times = (_number(row.stages_ms.get(stage), 2) for stage in stages)
        lines.append((row.size, row.kind, TITLES.get(row.method, row.method), *times))
    return lines


def _quotient(recipe: Figures | None, row: Figures) -> str:
    """Return how many times a recipe's time, its processor time and its corner error are this row's."""
    if recipe is None or row.method in (ORB, SIFT):
        return ""
    pairs = (
        (recipe.median_ms, row.median_ms, ".1f"),
        (recipe.cpu_ms, row.cpu_ms, ".1f"),
        (recipe.corner_p50_px, row.corner_p50_px, ".0f"),
    )
    return " / ".join(f"{theirs / ours:{digits}}" if theirs and ours else "-" for theirs, ours, digits in pairs)


def _table(lines: Sequence[Sequence[str]], markdown: bool) -> str:
    if markdown:
        head, *body = (f"| {' | '.join(line)} |" for line in lines)
        return "\n".join((head, "|" + "---|" * len(lines[0]), *body))
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    text = [2 if i < 2 else 0 for i in range(len(widths))]
    return "\n".join(
        "  ".join(
            cell.ljust(w) if left else cell.rjust(w) for cell, w, left in zip(line, widths, text, strict=True)
        ).rstrip()
        for line in lines
    )


def _titled(title: str, table: str, markdown: bool) -> str:
    return f"{title}\n\n{table}" if markdown else f"{title}\n{table}"


def _number(value: float | None, digits: int) -> str:
    if value is None:
        return "-"
    return ">1e4" if value > 1e4 else f"{value:.{digits}f}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}%"
