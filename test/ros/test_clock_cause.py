# SPDX-License-Identifier: Apache-2.0
"""Stamps that are not of the clock that the node follows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.ros.causes import CauseKind, other_clock
from imgu_ros.ros.meters import LatencyMeter


def node(use_sim_time: bool) -> Any:
    return SimpleNamespace(get_parameter=lambda _: SimpleNamespace(value=use_sim_time))


def ages(*seconds: float) -> LatencyMeter:
    meter = LatencyMeter()
    for age_s in seconds:
        meter.add(age_s)
    return meter


@pytest.mark.parametrize(("age_s", "said"), [(-1.7e9, "1700000000 s ahead of /clock"), (500.0, "500 s behind /clock")])
def test_stamps_of_another_clock(age_s: float, said: str) -> None:
    (cause,) = other_clock(node(use_sim_time=True), ages(age_s, age_s, 0.01))
    assert cause.kind is CauseKind.STAMPS
    assert said in cause.text and "use_sim_time" in cause.text
    # A recording that is played without a clock is as old as it is.
    assert not list(other_clock(node(use_sim_time=False), ages(age_s)))


def test_usual_ages_are_not_told() -> None:
    assert not list(other_clock(node(use_sim_time=True), ages(0.01, 0.3, 2.0)))
    assert not list(other_clock(node(use_sim_time=True), ages()))
