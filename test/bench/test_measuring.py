# SPDX-License-Identifier: Apache-2.0
"""Samples and figures of methods whose answers are known."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from imgu_ros.bench.figures import figures, is_false
from imgu_ros.bench.measuring import FrameMeasurement, Measured, MeasurementPlan, Timing, measure, measure_in_turn
from imgu_ros.bench.methods import Answer, Answered
from imgu_ros.frame import Frame
from imgu_ros.simulate.conditions import PLAIN, condition_named
from imgu_ros.simulate.trials import Trial, known_targets, trial_batches, trial_frames
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3

TRIAL = Trial(PLAIN, 320, 180, frames=5)


class Oracle:
    """Knows the truth, and shifts it; sleeps; gives up on frames that it is told."""

    def __init__(self, name: str, trial: Trial, shift_px: float = 0.0, lost: tuple[int, ...] = ()) -> None:
        self.name = name
        self._truths = {s.frame.stamp_ns: s.truths for s in trial_frames(trial)}
        self._order = list(self._truths)
        self._shift, self._lost = shift_px, lost
        self.seen: list[int] = []
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def answer(self, frame: Frame) -> Answered:
        index = self._order.index(frame.stamp_ns)
        self.seen.append(index)
        time.sleep(0.002)
        if index in self._lost or not self._truths[frame.stamp_ns]:
            return Answered((Answer("poster", status="lost", reason=f"matches: {index}"),))
        truth = self._truths[frame.stamp_ns][-1]
        shift = np.array([[1, 0, self._shift], [0, 1, 0], [0, 0, 1.0]])
        assert truth.pose is not None
        pose = RigidTransform(exp_so3([0, 0, -0.01]) @ truth.pose.R, truth.pose.t * 1.02)
        covariance = np.diag([*np.square(truth.pose.t * 0.01), *[1e-4] * 3])
        return Answered((Answer("poster", shift @ truth.H, pose, covariance, "found"),), {"look": 1_000_000})


def test_errors_are_those_of_the_answers() -> None:
    targets = known_targets(TRIAL)
    right, off = Oracle("right", TRIAL), Oracle("off", TRIAL, 3.0, lost=(2,))
    measured = measure(MeasurementPlan([right, off], trial_batches(TRIAL, 2), targets, every={"off": 2}))
    assert right.seen == [0, 1, 2, 3, 4] and off.seen == [0, 2, 4]
    assert right.resets == off.resets == 1
    of = {name: [s for s in measured.samples if s.method == name] for name in ("right", "off")}
    assert [s.corner_px for s in of["right"]] == pytest.approx([0.0] * 5, abs=1e-9)
    assert [s.corner_px for s in of["off"]] == [pytest.approx(3.0), None, pytest.approx(3.0)]
    for sample in of["right"]:
        assert sample.rotation_deg == pytest.approx(math.degrees(0.01))
        assert sample.translation_percent == pytest.approx(2.0)
        # Two sigma of each of three positions, one sigma of one angle.
        assert sample.nees == pytest.approx(3 * 2**2 + 1)
    assert [s.reason for s in of["off"]] == ["", "matches: 2", ""]


def test_figures_of_a_run() -> None:
    targets = known_targets(TRIAL)
    measured = measure(MeasurementPlan([Oracle("off", TRIAL, 3.0, lost=(2,))], trial_batches(TRIAL, 2), targets))
    f = figures("plain", "sequence", "320x180", "off", [measured, measured])
    assert (f.frames, f.found, f.fine, f.false) == (10, 0.8, 0.0, 0)
    assert f.corner_p50_px == pytest.approx(3) and f.corner_p95_px == pytest.approx(3)
    assert 2 <= f.median_ms <= f.p95_ms
    assert f.stages_ms == {"look": 1.0}
    assert f.reasons == {"lost: matches: #": 2}
    assert f.poses == 1 and f.nees_below == 0
    none = figures("plain", "sequence", "320x180", "nobody", [measured])
    assert none.found is None and none.corner_p50_px is None and none.frames == 0


def test_either_copy_is_an_answer() -> None:
    trial = Trial(condition_named("two-copies"), 320, 180, frames=2)
    # The oracle tells the second of the two.
    measured = measure(MeasurementPlan([Oracle("second", trial)], trial_batches(trial), known_targets(trial)))
    assert [s.corner_px for s in measured.samples] == pytest.approx([0, 0], abs=1e-9)


def test_what_is_not_there_is_false() -> None:
    trial = Trial(condition_named("no-target"), 320, 180, frames=2)

    class Liar(Oracle):
        def answer(self, frame: Frame) -> Answered:
            return Answered((Answer("poster", np.eye(3), status="found"),))

    measured = measure(MeasurementPlan([Liar("liar", trial)], trial_batches(trial), known_targets(trial)))
    assert [is_false(s) for s in measured.samples] == [True, True]
    f = figures("no-target", "sequence", "320x180", "liar", [measured])
    assert (f.false, f.found, f.frames) == (2, None, 2)


@pytest.mark.parametrize(
    ("corner_px", "false"), [(0.5, False), (9.9, False), (10.1, True), (math.inf, True), (None, True)]
)
def test_far_off_is_false(corner_px: float | None, false: bool) -> None:
    assert is_false(FrameMeasurement("m", 0, "t", True, True, corner_px)) is false
    assert not is_false(FrameMeasurement("m", 0, "t", True, False))


def test_infinite_errors_stay_numbers() -> None:
    samples = [FrameMeasurement("m", i, "t", True, True, math.inf) for i in range(3)]
    f = figures("c", "single", "1x1", "m", [Measured(samples, [Timing("m", i, 1.0, 1.0, {}) for i in range(3)])])
    assert f.corner_p50_px == 1e9 and f.found == 0 and f.false == 3


def test_methods_take_turns() -> None:
    order: list[str] = []

    class Noted(Oracle):
        def answer(self, frame: Frame) -> Answered:
            order.append(self.name)
            return super().answer(frame)

    measure(MeasurementPlan([Noted(name, TRIAL) for name in "abc"], trial_batches(TRIAL), known_targets(TRIAL)))
    assert "".join(order) == "abcbcacababcbca"


def test_shows_take_turns_list_by_list() -> None:
    order: list[str] = []

    class Noted(Oracle):
        def answer(self, frame: Frame) -> Answered:
            order.append(self.name)
            return super().answer(frame)

    longer = Trial(PLAIN, 320, 180, frames=6)
    shows = [
        MeasurementPlan([Noted("a", TRIAL)], trial_batches(TRIAL, 2), known_targets(TRIAL)),
        MeasurementPlan(
            [Noted("b", longer), Noted("c", longer)], trial_batches(longer, 3), known_targets(longer), every={"c": 3}
        ),
    ]
    first, second = measure_in_turn(shows)
    assert "".join(order) == "aabcbbaacbbba"
    assert [t.frame for t in first.timings] == list(range(5))
    assert [t.frame for t in second.timings if t.method == "c"] == [0, 3]
