# SPDX-License-Identifier: Apache-2.0
"""Times rise, and are the stamps where these do."""

from __future__ import annotations

import pytest

from imgu_ros.camera_memory import FrameTimes


@pytest.mark.parametrize(
    ("stamps", "times"),
    [
        ([5, 7, 10, 11], [5, 7, 10, 11]),
        ([0, 0, 0], [0, 33_000_000, 66_000_000]),
        ([10, 20, 20, 30], [10, 20, 30, 40]),
        ([10, 20, 15, 25, 35], [10, 20, 30, 40, 50]),
        ([100, 130, 40, 70], [100, 130, 160, 190]),
    ],
)
def test_times(stamps: list[int], times: list[int]) -> None:
    clock = FrameTimes()
    assert [clock.of(stamp) for stamp in stamps] == times
