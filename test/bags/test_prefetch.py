# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from imgu_ros.bags.prefetch import Prefetch


def test_items_come_in_order_and_the_memory_is_bounded():
    made = 0

    def items() -> Iterator[bytes]:
        nonlocal made
        for index in range(50):
            made += 1
            yield bytes([index]) * 10

    prefetch = Prefetch(items(), len, limit_bytes=40)
    prefetch.wait_filled(2)
    time.sleep(0.05)
    # Four fill the limit, one more is in the thread's hand.
    assert made <= 5
    got = []
    for item in prefetch:
        got.append(item[0])
        assert made - len(got) <= 6
    assert got == list(range(50))


def test_an_error_comes_after_the_items_before_it():
    def items() -> Iterator[int]:
        yield 1
        raise OSError("gone")

    prefetch = Prefetch(items(), lambda _: 1)
    iterator = iter(prefetch)
    assert next(iterator) == 1
    with pytest.raises(OSError, match="gone"):
        next(iterator)


def test_close_ends_a_thread_that_is_full():
    prefetch = Prefetch(iter(range(1000)), lambda _: 1, limit_bytes=3)
    prefetch.wait_filled(2)
    prefetch.close()
    assert list(prefetch) == []
    assert not any(thread.name == "prefetch" and thread.is_alive() for thread in threading.enumerate())
