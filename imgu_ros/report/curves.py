# SPDX-License-Identifier: Apache-2.0
"""The curves of a report: columns of the frame table over time, at most so many points, with their extremes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.report.table import FrameTable
from imgu_ros.result import Status
from imgu_ros.types import Floats, Indices

#: Curves are drawn for so many targets, those with the most poses.
MOST_TARGETS = 8
#: Numbers that the page may hold, of six characters each; and points of a curve, of which a screen shows half.
_MOST_NUMBERS, _MOST_POINTS = 150_000, 4000
#: Of several frames drawn as one the gravest status is shown.
_GRAVITY = (Status.REJECTED, Status.DEGENERATE, Status.LOST, Status.DETECTED, Status.TRACKED)


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One curve of a plot.

    Attributes
    ----------
    target : index into the targets that are drawn; None: of the whole frame
    label : of the curve, without the target
    values : (P,), NaN where there is nothing
    is_predicted : drawn dashed: what the estimate's own covariance says
    """

    target: int | None
    label: str
    values: Floats
    is_predicted: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """Curves of one quantity over time."""

    title: str
    unit: str
    note: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True, slots=True)
class StatusRun:
    """Points `first` to `last` of one target, with one status and one reason (indices)."""

    first: int
    last: int
    status: int
    reason: int


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """All curves of a report, over the same points.

    Attributes
    ----------
    targets : names of those that are drawn
    bin_frames : frames that are drawn as two points, with the smallest and the largest value of each curve, in the
        order in which they come; 1: every frame is a point
    x, x_name : (P,) places of the points, and what they are
    frame : (P,) number of a point's frame; of several frames, of the first or the middle one
    plots : curves over time
    runs : status over time, for each target
    reasons : why something is missing, for the runs
    paths : (P, 3) positions of the camera in each target's frame, m, NaN without a pose
    true_paths : the same by the truth; empty without truth
    """

    targets: tuple[str, ...]
    bin_frames: int
    x: Floats
    x_name: str
    frame: Indices
    plots: tuple[Plot, ...]
    runs: tuple[tuple[StatusRun, ...], ...]
    reasons: tuple[str, ...]
    paths: tuple[Floats, ...]
    true_paths: tuple[Floats, ...]


def curves_of(table: FrameTable) -> Curves:
    """Return what a report draws of a table; needs about 8 bytes for each number and frame."""
    drawn = _drawn_targets(table)
    frames = int(table.frame.max()) + 1 if len(table) else 0
    described = list(_described(table))
    # For each point: the curves and the position of each target, its place, its frame, and the time that it took.
    count = (sum(len(quantities) for *_, quantities in described) + 3) * max(len(drawn), 1) + 3
    bins = _Bins(frames, max(1, -(-2 * frames // max(2, min(_MOST_POINTS, _MOST_NUMBERS // count)))))
    if frames <= min(_MOST_POINTS, _MOST_NUMBERS // count):
        bins = _Bins(frames, 1)

    def over_frames(values: Floats, target: int) -> Floats:
        """Return a column of one target by frames, (frames,)."""
        rows = table.of_target(target)
        by_frame = np.full((frames, *values.shape[1:]), np.nan)
        by_frame[table.frame[rows]] = values[rows]
        return by_frame

    plots = []
    for title, unit, note, quantities in described:
        curves = [
            Curve(place, label, bins.extremes(over_frames(values, target)), is_predicted)
            for place, target in enumerate(drawn)
            for label, values, is_predicted in quantities
        ]
        known = tuple(curve for curve in curves if not np.isnan(curve.values).all())
        if known:
            plots.append(Plot(title, unit, note, known))
    if len(table) and not np.isnan(table.total_ms).all():
        of_frame = np.full(frames, np.nan)
        of_frame[table.frame] = table.total_ms
        total = Curve(None, "whole frame", bins.extremes(of_frame))
        plots.append(Plot("Time in the pipeline", "ms", "Of the whole frame, without reading and writing.", (total,)))
    seconds, x_name = _places(table, frames)
    errors = table.errors
    return Curves(
        targets=tuple(table.targets[target] for target in drawn),
        bin_frames=bins.width,
        x=seconds[bins.frame],
        x_name=x_name,
        frame=bins.frame,
        plots=tuple(plots),
        runs=tuple(_runs(table, target, bins) for target in drawn),
        reasons=table.reasons,
        paths=tuple(over_frames(table.position, target)[bins.frame] for target in drawn),
        true_paths=()
        if errors is None
        else tuple(over_frames(errors.true_position, target)[bins.frame] for target in drawn),
    )


_Quantity = tuple[str, Floats, bool]


def _described(table: FrameTable) -> Iterator[tuple[str, str, str, Sequence[_Quantity]]]:
    """Yield title, unit, note and the columns of each plot."""
    errors = table.errors
    has_poses = errors is not None and not np.isnan(errors.rotation_deg).all()
    if errors is not None:
        yield (
            "Corner error", "px", "Against the truth: mean distance of the outer corners.",
            [("measured", errors.corner_px, False)],
        )  # fmt: skip
    yield "Residual", "px rms", "Of the points that agree, per coordinate; no error.", [("", table.rms_px, False)]
    yield (
        "Points", "", "Inliers of the final fit, which agree; dashed: tentative matches.",
        [("inliers", table.n_inliers, False), ("tentative matches", table.n_matches, True)],
    )  # fmt: skip
    yield (
        "Confirmed share", "", "Of the target in view, what looks as it should.",
        [("", table.confirmed_share, False)],
    )  # fmt: skip
    yield "Distance", "m", "From the camera to the target's centre.", [("", table.distance, False)]
    yield (
        "Viewing angle", "°", "Between the line of sight to the target's centre and its normal: 0 is straight on.",
        [("", _viewing_angles_deg(table), False)],
    )  # fmt: skip
    said = "By the pose's own covariance, 1σ (root of the trace)"
    position: list[_Quantity] = [("predicted", 1e3 * table.sigma_t, True)]
    rotation: list[_Quantity] = [("predicted", np.rad2deg(table.sigma_r), True)]
    if errors is not None and has_poses:
        true_distance = np.linalg.norm(errors.true_position, axis=1)
        position.insert(0, ("measured", 10 * errors.translation_percent * true_distance, False))
        rotation.insert(0, ("measured", errors.rotation_deg, False))
        said = f"Against the truth. Dashed: {said[0].lower()}{said[1:]}"
    yield "Position error" if has_poses else "Position, 1σ", "mm", f"{said}.", position
    yield "Rotation error" if has_poses else "Rotation, 1σ", "°", f"{said}.", rotation
    if errors is not None and has_poses:
        yield (
            "NEES", "", "Squared error of the pose in units of its covariance: 95 % lie below 12.6 if it is right.",
            [("", errors.nees, False)],
        )  # fmt: skip


def _viewing_angles_deg(table: FrameTable) -> Floats:
    sideways = np.linalg.norm(table.position[:, :2], axis=1)
    angles: Floats = np.rad2deg(np.arctan2(sideways, table.position[:, 2]))
    return angles


def _drawn_targets(table: FrameTable) -> list[int]:
    """Return the indices of the targets with the most poses, in their order."""
    poses = [int((~np.isnan(table.distance[table.of_target(index)])).sum()) for index in range(len(table.targets))]
    return sorted(sorted(range(len(poses)), key=lambda index: -poses[index])[:MOST_TARGETS])


def _places(table: FrameTable, frames: int) -> tuple[Floats, str]:
    """Return each frame's place on the x axis: seconds, or its number where stamps do not advance."""
    stamps = np.zeros(frames, np.int64)
    stamps[table.frame] = table.stamp_ns
    if frames > 1 and (np.diff(stamps) > 0).all():
        return (stamps - stamps[0]) / 1e9, "time (s)"
    return np.arange(frames, dtype=np.float64), "frame"


def _runs(table: FrameTable, target: int, bins: _Bins) -> tuple[StatusRun, ...]:
    rows = table.of_target(target)
    gravity = np.array([_GRAVITY.index(status) for status in Status])
    status, reason = np.full(bins.frames, -1), np.zeros(bins.frames, np.intp)
    status[table.frame[rows]], reason[table.frame[rows]] = table.status[rows], table.reason[rows]
    # Without a row there is nothing to show, and that counts least.
    chosen = bins.gravest(np.where(status < 0, len(_GRAVITY), gravity[status]))
    status, reason = status[chosen], reason[chosen]
    if not len(status):
        return ()
    starts = np.flatnonzero(np.r_[True, (np.diff(status) != 0) | (np.diff(reason) != 0)])
    ends = np.r_[starts[1:], len(status)] - 1
    return tuple(
        StatusRun(int(first), int(last), int(status[first]), int(reason[first]))
        for first, last in zip(starts, ends, strict=True)
        if status[first] >= 0
    )


class _Bins:
    """Frames by the points that show them: one for each, or two for `width` of them."""

    def __init__(self, frames: int, width: int) -> None:
        self.frames, self.width = frames, width
        self._starts = np.arange(0, frames, width)
        middles = np.minimum(self._starts + width // 2, frames - 1)
        #: Number of each point's frame.
        self.frame = self._starts if width == 1 else np.column_stack((self._starts, middles)).ravel()

    def extremes(self, values: Floats) -> Floats:
        """Return the values of the points: each bin's smallest and largest, that first which comes first."""
        if self.width == 1:
            return values
        smallest = self._places(values, np.nanargmin, np.inf)
        largest = self._places(values, np.nanargmax, -np.inf)
        places = np.sort(np.column_stack((smallest, largest)), axis=1)
        return np.asarray(values[places].ravel())

    def gravest(self, gravity: Indices) -> Indices:
        """Return for each point the number of the frame with the smallest value in its bin."""
        if self.width == 1:
            return np.arange(self.frames)
        return np.repeat(self._places(gravity.astype(np.float64), np.nanargmin, np.inf), 2)

    def _places(self, values: Floats, find: Callable[..., Indices], nothing: float) -> Indices:
        """Return the number of the frame that `find` chooses in each bin."""
        padded = np.full(len(self._starts) * self.width, nothing)
        padded[: self.frames] = np.where(np.isnan(values), nothing, values)
        return self._starts + find(padded.reshape(-1, self.width), axis=1)
