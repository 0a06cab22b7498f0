# SPDX-License-Identifier: Apache-2.0
"""How threads share the processors while frames are read, worked on and written at once."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

import cv2

#: Python's own 5 ms are longer than a frame's time.
_INTERVAL_S = 0.0005
#: Not what was set when a block began: blocks of several threads overlap, and the last one to end must not keep it.
_USUAL_S = sys.getswitchinterval()


@contextlib.contextmanager
def quick_thread_switches() -> Iterator[None]:
    """Let threads take turns at short intervals inside the block.

    A thread that comes back from a function of OpenCV, or a callback that brings a frame, waits that long for one that
    runs Python.
    """
    sys.setswitchinterval(min(_USUAL_S, _INTERVAL_S))
    try:
        yield
    finally:
        sys.setswitchinterval(_USUAL_S)


@contextlib.contextmanager
def one_processor_left_over() -> Iterator[None]:
    """Let OpenCV use a processor less inside the block: its threads, while they wait for work, keep others from it."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(max(1, before - 1))
    try:
        yield
    finally:
        cv2.setNumThreads(before)
