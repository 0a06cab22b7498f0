# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import threading
from itertools import accumulate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.ros.frame_queue import FrameQueue


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


class World(threading.Condition):
    """Items come at their times while a worker, in the same thread, works or waits for the next."""

    def __init__(self, arrivals_s: list[float], patience_s: float = 0.25) -> None:
        super().__init__()
        self.clock = Clock()
        self.slot: FrameQueue[int] = FrameQueue(patience_s, self.clock)
        self.slot._condition = self
        self.arrivals_s = arrivals_s
        self.came = 0

    def wait(self, timeout: float | None = None) -> bool:
        """Let the next item come, or close."""
        if self.came < len(self.arrivals_s):
            self.work(self.arrivals_s[self.came] - self.clock.now_s)
        else:
            self.slot.close()
        return True

    def work(self, duration_s: float) -> None:
        """Let time pass, and come what comes."""
        until_s = self.clock.now_s + duration_s
        while self.came < len(self.arrivals_s) and self.arrivals_s[self.came] <= until_s:
            self.clock.now_s = self.arrivals_s[self.came]
            self.came += 1
            self.slot.put(self.came - 1)
        self.clock.now_s = until_s


@given(
    st.lists(st.floats(0, 0.05), min_size=1, max_size=60),
    st.lists(st.floats(0, 0.05), min_size=60, max_size=60),
)
def test_every_item_is_taken_or_skipped_and_those_taken_are_in_order(gaps_s: list[float], works_s: list[float]) -> None:
    """All but the newest gives way exactly when the worker has not waited for longer than the patience."""
    world = World(list(accumulate(gaps_s)), patience_s=0.03)
    taken: list[int] = []
    idle_s = 0.0
    for work_s in works_s:
        waits = world.came == len(taken) + world.slot.skipped
        if (item := world.slot.take()) is None:
            break
        now_s = world.clock.now_s
        idle_s = now_s if waits else idle_s
        if now_s - idle_s > 0.03:
            assert item == world.came - 1
        taken.append(item)
        world.work(work_s)
    assert taken == sorted(set(taken))
    assert taken[-1] == len(gaps_s) - 1
    assert len(taken) + world.slot.skipped == len(gaps_s)


@pytest.mark.parametrize(
    ("interval_s", "work_s", "hold_up_s"),
    [(1 / 120, 0.0075, 0.01), (1 / 60, 0.008, 0.1), (1 / 15, 0.01, 0.2), (1 / 30, 0.05, 0.0), (1 / 60, 0.5, 0.0)],
)
def test_what_a_worker_gets(interval_s: float, work_s: float, hold_up_s: float) -> None:
    """Fast enough, it gets every item, also when it is held up for a moment; too slow, it soon gets fresh ones."""
    world = World([i * interval_s for i in range(240)])
    ages_s = []
    while (item := world.slot.take()) is not None:
        ages_s.append(world.clock.now_s - world.arrivals_s[item])
        world.work(work_s + (hold_up_s if len(ages_s) == 50 else 0.0))
    assert len(ages_s) + world.slot.skipped == 240
    if work_s < interval_s:
        assert world.slot.skipped == 0
        assert max(ages_s) <= hold_up_s + work_s + 1e-9
    else:
        assert world.slot.skipped > 0.3 * 240
        assert max(ages_s[len(ages_s) // 2 :]) <= interval_s + 1e-9


def test_a_skipped_item_is_counted_and_let_go() -> None:
    clock = Clock()
    slot: FrameQueue[str] = FrameQueue(0.02, clock)
    slot.put("old")
    clock.now_s = 1.0
    slot.put("new")
    assert slot.skipped == 1
    assert slot.take() == "new"


def test_no_more_than_a_dozen_wait() -> None:
    slot: FrameQueue[int] = FrameQueue(clock=Clock())
    for item in range(20):
        slot.put(item)
    assert [slot.take() for _ in range(12)] == list(range(8, 20))
    assert slot.skipped == 8


def test_close_ends_a_take_that_waits() -> None:
    slot: FrameQueue[int] = FrameQueue()
    got: list[int | None] = []
    thread = threading.Thread(target=lambda: got.append(slot.take()))
    thread.start()
    slot.close()
    thread.join(2)
    assert got == [None]
    slot.put(1)
    assert slot.take() is None


def test_what_is_cleared_is_not_skipped() -> None:
    slot: FrameQueue[int] = FrameQueue()
    slot.put(1)
    slot.clear()
    slot.put(2)
    assert slot.skipped == 0
    assert slot.take() == 2


def test_a_sender_whose_items_take_long_costs_the_others_nothing() -> None:
    """A camera at 30 Hz whose frames take 4 ms, and strangers whose frames take 0.35 s, two a second."""
    camera = [(n / 30, "camera") for n in range(300)]
    strangers = [(n / 2 + 0.01 * (n % 3), f"stranger {n % 3}") for n in range(20)]
    events = sorted(camera + strangers)
    world = World([at_s for at_s, _ in events])
    world.slot._sender = lambda number: events[number][1]
    taken: list[str] = []
    ages_s = []
    while (number := world.slot.take()) is not None:
        taken.append(events[number][1])
        if taken[-1] == "camera":
            ages_s.append(world.clock.now_s - events[number][0])
        world.work(0.004 if taken[-1] == "camera" else 0.35)
    assert taken.count("camera") == 300, "none skipped"
    assert max(ages_s) < 0.4
    assert len(taken) + world.slot.skipped == len(events)
    assert len(taken) > 310, "the strangers get what is left"


def test_endless_senders_count_as_one_until_there_is_room() -> None:
    clock = Clock()
    slot: FrameQueue[int] = FrameQueue(clock=clock, sender=str)
    for item in range(100):
        slot.put(item)
    assert len(slot._senders) == 9
    assert slot.skipped == 88
    assert sorted(slot.take() for _ in range(12)) == [*range(8), *range(96, 100)]
    clock.now_s = 3.0
    slot.put(100)
    assert "100" in slot._senders, "another was silent"
    assert len(slot._senders) == 9


def test_endless_senders_cost_one_that_stays_nothing() -> None:
    """A camera at 30 Hz among 600 Hz of images with another frame_id each; every image takes 6 ms."""
    clock = Clock()
    slot: FrameQueue[str] = FrameQueue(clock=clock, sender=str)
    taken = 0
    for period in range(300):
        slot.put("camera")
        for number in range(20):
            slot.put(f"{period} {number}")
        while slot._is_waiting() and clock.now_s + 0.006 < (period + 1) / 30:
            taken += slot.take() == "camera"
            clock.now_s += 0.006
        clock.now_s = (period + 1) / 30
    assert taken == 300
