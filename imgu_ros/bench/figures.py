# SPDX-License-Identifier: Apache-2.0
"""From samples to figures: medians, percentiles, shares."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imgu_ros.bench.measuring import FrameMeasurement, Measured
from imgu_ros.simulate.truth import NEES_95

#: A homography further off than this is no find.
FOUND_PX = 10.0
FINE_PX = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Figures:
    """One method under one condition.

    Attributes
    ----------
    condition, kind, size : what was shown: `sequence` or `single` frames of WIDTHxHEIGHT
    method : who answered
    frames : how many targets in frames there were to find (or frames, where none is)
    median_ms, p95_ms, cpu_ms : time for a frame; cpu_ms: median of all cores together
    corner_p50_px, corner_p95_px : of all answers where the target is in view; None without answers
    found : share of the targets in view that were answered with a corner error of at most 10 px; None when none was
    fine : share with at most 1 px
    false : answers more than 10 px off, or of a target that is not there
    rotation_p50_deg, translation_p50_percent : median errors of the pose; None without poses
    poses : share of the found ones that have a pose
    nees_p50, nees_below : median of the normalised squared error of the pose, and share below the 95 % point
    stages_ms : median time of each stage, over the frames where it ran
    reasons : how often, and why, a target in view was not answered; most frequent first
    """

    condition: str
    kind: str
    size: str
    method: str
    frames: int
    median_ms: float
    p95_ms: float
    cpu_ms: float
    corner_p50_px: float | None
    corner_p95_px: float | None
    found: float | None
    fine: float | None
    false: int
    rotation_p50_deg: float | None
    translation_p50_percent: float | None
    poses: float | None
    nees_p50: float | None
    nees_below: float | None
    stages_ms: dict[str, float] = field(default_factory=dict)
    reasons: dict[str, int] = field(default_factory=dict)


def figures(condition: str, kind: str, size: str, method: str, runs: Sequence[Measured]) -> Figures:
    """Return one method's figures over some runs under the same condition."""
    samples = [s for run in runs for s in run.samples if s.method == method]
    timings = [t for run in runs for t in run.timings if t.method == method]
    present = [s for s in samples if s.present]
    errors = [s.corner_px for s in present if s.corner_px is not None]
    good = [s for s in present if s.corner_px is not None and s.corner_px <= FOUND_PX]
    nees = [s.nees for s in good if s.nees is not None]
    times = [t.ms for t in timings]
    stages: dict[str, list[float]] = {}
    for timing in timings:
        for stage, ms in timing.stages_ms.items():
            stages.setdefault(stage, []).append(ms)
    missing = Counter(_kind_of_reason(s) for s in present if not s.answered)
    return Figures(
        condition,
        kind,
        size,
        method,
        len(present) or len(samples),
        _quantile(times, 0.5) or 0.0,
        _quantile(times, 0.95) or 0.0,
        _quantile([t.cpu_ms for t in timings], 0.5) or 0.0,
        _quantile(errors, 0.5),
        _quantile(errors, 0.95),
        len(good) / len(present) if present else None,
        sum(s.corner_px is not None and s.corner_px <= FINE_PX for s in present) / len(present) if present else None,
        sum(is_false(s) for s in samples),
        _quantile([s.rotation_deg for s in good if s.rotation_deg is not None], 0.5),
        _quantile([s.translation_percent for s in good if s.translation_percent is not None], 0.5),
        sum(s.rotation_deg is not None for s in good) / len(good) if good else None,
        _quantile(nees, 0.5),
        sum(n < NEES_95 for n in nees) / len(nees) if nees else None,
        {stage: float(np.median(ms)) for stage, ms in stages.items()},
        dict(missing.most_common(5)),
    )


def is_false(sample: FrameMeasurement) -> bool:
    """Whether a method said that it found a target that is elsewhere, or not there."""
    if not sample.answered:
        return False
    return not sample.present or sample.corner_px is None or sample.corner_px > FOUND_PX


def _kind_of_reason(sample: FrameMeasurement) -> str:
    """Return a reason without its numbers: what frames have in common."""
    words = f"{sample.status}: {sample.reason}".split()
    return " ".join("#" if any(c.isdigit() for c in word) else word for word in words)


def _quantile(values: Sequence[float], share: float) -> float | None:
    """Return a quantile; an infinite one is as large as the largest number that JSON can hold for people: 1e9."""
    if not values:
        return None
    return float(np.quantile(np.minimum(values, 1e9), share))
