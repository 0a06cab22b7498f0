"""How soon Python threads give way to each other."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

#: Python's own 5 ms are longer than a frame's time.
_INTERVAL_S = 0.0005


@contextlib.contextmanager
def quick_thread_switches() -> Iterator[None]:
    """Let threads take turns at short intervals inside the block.

    A thread that comes back from a function of OpenCV waits that long for one that runs Python.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _INTERVAL_S))
    try:
        yield
    finally:
        sys.setswitchinterval(before)
