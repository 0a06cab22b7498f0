# SPDX-License-Identifier: Apache-2.0
"""Threads take turns quickly and leave a processor over inside blocks, and nothing of it stays behind."""

from __future__ import annotations

import sys

import cv2

from imgu_ros.threads import one_processor_left_over, quick_thread_switches


def test_overlapping_blocks_leave_the_usual_interval_behind() -> None:
    usual = sys.getswitchinterval()
    first, second = quick_thread_switches(), quick_thread_switches()
    first.__enter__()
    assert 0 < sys.getswitchinterval() < usual
    second.__enter__()
    first.__exit__(None, None, None)
    second.__exit__(None, None, None)
    assert sys.getswitchinterval() == usual


def test_opencv_has_a_thread_less_but_one_at_least() -> None:
    before = cv2.getNumThreads()
    try:
        for threads, inside in ((1, 1), (2, 1), (4, 3)):
            cv2.setNumThreads(threads)
            with one_processor_left_over():
                assert cv2.getNumThreads() == inside
            assert cv2.getNumThreads() == threads
    finally:
        cv2.setNumThreads(before)
