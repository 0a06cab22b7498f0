from __future__ import annotations

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.ros.newest import NewestSlot


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@given(st.lists(st.sampled_from(["put", "take", "wait"]), max_size=60))
def test_every_item_is_taken_or_skipped_and_those_taken_are_in_order(actions: list[str]) -> None:
    """None is taken that has waited too long, unless there is none that is newer."""
    clock = Clock()
    slot: NewestSlot[int] = NewestSlot(0.02, clock)
    came_s: list[float] = []
    taken: list[int] = []
    for action in actions:
        if action == "wait":
            clock.now_s += 0.008
        elif action == "put":
            slot.put(len(came_s))
            came_s.append(clock.now_s)
        elif taken[-1:] != [len(came_s) - 1] and came_s:
            item = slot.take()
            assert item is not None
            assert clock.now_s - came_s[item] <= 0.02 or item == len(came_s) - 1
            taken.append(item)
    assert taken == sorted(set(taken))
    left = len(came_s) - len(taken) - slot.skipped
    assert 0 <= left <= 4


@pytest.mark.parametrize(("interval_s", "work_s"), [(1 / 120, 0.0075), (1 / 30, 0.1), (1 / 15, 0.01)])
def test_what_a_worker_gets(interval_s: float, work_s: float) -> None:
    """Fast enough, it gets every item, also when it is held up for a moment; too slow, it gets fresh ones."""
    clock = Clock()
    slot: NewestSlot[float] = NewestSlot(clock=clock)
    ages, busy_until_s, count = [], 0.0, 120
    for i in range(count):
        due_s = i * interval_s
        # The worker takes as much as it can before the next item comes.
        while busy_until_s <= due_s and i > len(ages) + slot.skipped:
            clock.now_s = max(busy_until_s, clock.now_s)
            came_s = slot.take()
            assert came_s is not None
            ages.append(clock.now_s - came_s)
            hold_up_s = 0.012 if len(ages) == 50 else 0.0
            busy_until_s = clock.now_s + work_s + hold_up_s
        clock.now_s = due_s
        slot.put(due_s)
    if work_s < interval_s:
        assert slot.skipped == 0
    else:
        assert slot.skipped > 0.5 * count
    assert max(ages) <= max(0.02, interval_s) + 1e-9


def test_a_skipped_item_is_counted_and_let_go() -> None:
    clock = Clock()
    slot: NewestSlot[str] = NewestSlot(0.02, clock)
    slot.put("old")
    clock.now_s = 1.0
    slot.put("new")
    assert slot.skipped == 1
    assert slot.take() == "new"


def test_close_ends_a_take_that_waits() -> None:
    slot: NewestSlot[int] = NewestSlot()
    got: list[int | None] = []
    thread = threading.Thread(target=lambda: got.append(slot.take()))
    thread.start()
    slot.close()
    thread.join(2)
    assert got == [None]
    slot.put(1)
    assert slot.take() is None


def test_what_is_cleared_is_not_skipped() -> None:
    slot: NewestSlot[int] = NewestSlot()
    slot.put(1)
    slot.clear()
    slot.put(2)
    assert slot.skipped == 0
    assert slot.take() == 2
