from __future__ import annotations

import threading

from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.ros.newest import NewestSlot


@given(st.lists(st.sampled_from(["put", "take"]), max_size=40))
def test_a_take_gives_the_newest_and_every_item_is_taken_or_skipped(actions):
    slot: NewestSlot[int] = NewestSlot()
    put = taken = 0
    waiting: int | None = None
    for action in actions:
        if action == "put":
            put += 1
            assert slot.put(put) == (waiting is not None)
            waiting = put
        elif waiting is not None:
            assert slot.take() == waiting
            taken += 1
            waiting = None
    assert put == taken + slot.skipped + (waiting is not None)


def test_close_ends_a_take_that_waits():
    slot: NewestSlot[int] = NewestSlot()
    got: list[int | None] = []
    thread = threading.Thread(target=lambda: got.append(slot.take()))
    thread.start()
    slot.close()
    thread.join(2)
    assert got == [None]
    slot.put(1)
    assert slot.take() is None


def test_what_is_cleared_is_not_skipped():
    slot: NewestSlot[int] = NewestSlot()
    slot.put(1)
    slot.clear()
    slot.put(2)
    assert slot.skipped == 0
    assert slot.take() == 2
