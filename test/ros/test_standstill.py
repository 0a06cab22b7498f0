# SPDX-License-Identifier: Apache-2.0
"""What is from before a standstill is told apart from what is fresh, whatever the clocks are."""

from __future__ import annotations

import pytest

from imgu_ros.ros.standstill import Standstill

SECOND = 10**9


class Machine:
    """Its clocks; a sleeping machine's monotonic clock sleeps too."""

    def __init__(self, sender_ahead_s: float = 0.0) -> None:
        self.elapsed_s, self.monotonic_s, self.wall_ns = 1000.0, 50.0, 1_700_000_000 * SECOND
        self.sender_ahead_ns = round(sender_ahead_s * SECOND)
        self.standstill = Standstill(lambda: self.elapsed_s, lambda: self.monotonic_s, lambda: self.wall_ns)
        self.standstill.begin()

    def passes(self, seconds: float, asleep: bool = False) -> None:
        self.elapsed_s += seconds
        self.monotonic_s += 0.0 if asleep else seconds
        self.wall_ns += round(seconds * SECOND)

    def comes(self, sent_ago_s: float = 0.002) -> bool:
        """Deliver a message; return whether it is old."""
        return self.standstill.is_old(self.wall_ns - round(sent_ago_s * SECOND) + self.sender_ahead_ns)

    def runs(self, seconds: float) -> None:
        for _ in range(round(seconds * 30)):
            self.passes(1 / 30)
            assert not self.comes()


@pytest.mark.parametrize("asleep", [False, True])
@pytest.mark.parametrize("sender_ahead_s", [0.0, -3600.0, 86_400.0])
def test_what_was_sent_before_the_end_is_old(asleep: bool, sender_ahead_s: float) -> None:
    machine = Machine(sender_ahead_s)
    machine.runs(2.0)
    received_s = machine.monotonic_s
    machine.passes(5.0, asleep)
    assert [machine.comes(ago_s) for ago_s in (4.9, 3.0, 0.3, 0.05)] == [True, True, True, False]
    assert machine.standstill.precedes(received_s)
    assert not machine.standstill.precedes(machine.monotonic_s + 1e-6)
    assert machine.standstill.news() == ""
    machine.runs(1.1)
    said = "suspended, or without processor time, for 5.0 s: 4 old frames dropped"
    assert machine.standstill.news() == said
    assert machine.standstill.news() == ""
    assert machine.standstill.lately() == said
    machine.runs(5.0)
    assert machine.standstill.lately() == ""


def test_a_slow_camera_is_no_standstill_while_a_timer_calls() -> None:
    machine = Machine()
    for _ in range(10):
        for _ in range(30):
            machine.passes(0.1)
            machine.standstill.news()
        assert not machine.comes(sent_ago_s=0.5), "a slow network"
    assert machine.standstill.news() == machine.standstill.lately() == ""


def test_what_comes_later_is_fresh_although_a_clock_was_set() -> None:
    machine = Machine()
    machine.runs(1.0)
    machine.passes(3.0)
    machine.standstill.news()
    machine.wall_ns += 3600 * SECOND
    machine.sender_ahead_ns = -7200 * SECOND
    assert machine.comes()
    for _ in range(25):
        machine.passes(0.1)
        machine.standstill.news()
    assert not machine.comes(), "not for ever"


def test_nobody_calls_while_nothing_is_subscribed() -> None:
    machine = Machine()
    machine.runs(1.0)
    machine.standstill.end()
    machine.passes(60.0)
    machine.standstill.begin()
    assert not machine.comes(sent_ago_s=30.0)
    assert not machine.standstill.precedes(machine.monotonic_s - 1.0)
    assert machine.standstill.news() == ""


def test_a_middleware_without_time_stamps_drops_what_was_received_before_alone() -> None:
    machine = Machine()
    received_s = machine.monotonic_s
    machine.passes(5.0)
    assert not machine.standstill.is_old(0)
    assert machine.standstill.precedes(received_s)


def test_a_node_that_waits_for_its_own_frame_stands_not_still() -> None:
    """`~/reset` waits for the end of a frame."""
    machine = Machine()
    machine.runs(1.0)
    received_s = machine.monotonic_s
    with machine.standstill.excused():
        machine.passes(2.0)
        assert not machine.standstill.precedes(received_s), "asked by the worker"
        machine.passes(2.0)
    assert not machine.comes(3.5)
    assert machine.standstill.lately() == ""
    machine.passes(2.0)
    assert machine.comes(1.9)
    machine.standstill.end()
    with machine.standstill.excused():
        machine.passes(9.0)
    machine.passes(9.0)
    assert machine.standstill.lately() == ""


@pytest.mark.parametrize("rate", [0.3, 0.5, 2.0])
def test_stamps_of_another_clock_make_no_message_old(rate: float) -> None:
    """A simulation or a bag at another rate: what comes after a standstill is fresh."""
    machine = Machine()
    stamp_ns = machine.wall_ns
    for count in range(200):
        machine.passes(4.0 if count == 120 else 1 / 30)
        stamp_ns += round(rate / 30 * SECOND)
        assert not machine.standstill.is_old(stamp_ns)
