# SPDX-License-Identifier: Apache-2.0
"""Work behind another thread: in order, bounded, finished in any case, and its errors not lost."""

from __future__ import annotations

import threading
import time

import pytest

from imgu_ros.replay.background_worker import BackgroundWorker


def alive() -> bool:
    return any(thread.name == "background" for thread in threading.enumerate())


def test_everything_is_done_in_order_and_few_wait():
    done: list[int] = []
    waiting: list[int] = []

    def work(item: int) -> None:
        time.sleep(0.001)
        done.append(item)

    with BackgroundWorker(work, limit=3) as behind:
        for item in range(50):
            behind.put(item)
            waiting.append(item + 1 - len(done))
    assert done == list(range(50))
    # Three wait, one is in the thread's hand.
    assert max(waiting) <= 4
    assert not alive()


def test_an_error_is_raised_where_items_are_put_and_nothing_is_done_after_it():
    done: list[int] = []

    def work(item: int) -> None:
        if item == 3:
            raise OSError(28, "no room")
        done.append(item)

    with pytest.raises(OSError, match="no room"), BackgroundWorker(work) as behind:
        for item in range(1000):
            behind.put(item)
    assert done == [0, 1, 2]
    assert not alive()


def test_the_last_items_error_is_not_lost():
    def work(item: int) -> None:
        time.sleep(0.01)
        raise ValueError(item)

    with pytest.raises(ValueError, match="1"), BackgroundWorker(work) as behind:
        behind.put(1)


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_after_an_interrupt_what_was_put_is_finished(error: type[BaseException]):
    done: list[int] = []

    def work(item: int) -> None:
        time.sleep(0.005)
        done.append(item)

    with pytest.raises(error), BackgroundWorker(work) as behind:
        for item in range(4):
            behind.put(item)
        raise error
    assert done == [0, 1, 2, 3]
    assert not alive()


def test_the_error_under_way_is_the_one_that_is_reported():
    def work(item: int) -> None:
        raise OSError("second")

    with pytest.raises(KeyboardInterrupt), BackgroundWorker(work) as behind:
        behind.put(1)
        raise KeyboardInterrupt


@pytest.mark.parametrize("is_full", [True, False])
def test_work_that_hangs_is_given_up_where_items_are_put_and_at_the_end(is_full: bool):
    hangs = threading.Event()
    with pytest.raises(TimeoutError), BackgroundWorker(lambda _: hangs.wait(), 2, 0.2) as worker:
        for _ in range(5 if is_full else 1):
            worker.put(None)
    hangs.set()


def test_slow_work_is_finished_when_each_item_is_within_the_patience():
    done: list[int] = []

    def work(item: int) -> None:
        time.sleep(0.15)
        done.append(item)

    with BackgroundWorker(work, 5, 0.6) as worker:
        for item in range(5):
            worker.put(item)
    assert done == list(range(5))
