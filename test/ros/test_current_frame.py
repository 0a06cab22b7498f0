# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from types import SimpleNamespace

import pytest

from imgu_ros.messages.header import Header
from imgu_ros.ros import current_frame as in_hand
from imgu_ros.ros.current_frame import CurrentFrame
from imgu_ros.shown_text import shown

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=12, nanosec=500_000_000), frame_id="/eye")


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"width": 8000, "height": 6000, "encoding": "bayer_rggb16"}, "(stamp 12.500 s, 8000 x 6000 bayer_rggb16)"),
        ({"width": 1, "height": 2, "encoding": "x" * 500}, f"(stamp 12.500 s, 1 x 2 {shown('x' * 500, 60)})"),
        ({"format": "jp\x1b[2Jeg"}, r"(stamp 12.500 s, jp\x1b[2Jeg)"),
        ({"format": "jpeg"}, "(stamp 12.500 s, jpeg)"),
        ({}, "(stamp 12.500 s)"),
    ],
)
def test_a_frame_of_more_than_a_second_is_told(monkeypatch: pytest.MonkeyPatch, fields: dict, said: str) -> None:
    now_s = 100.0
    monkeypatch.setattr(in_hand.time, "monotonic", lambda: now_s)
    held = CurrentFrame()
    assert held.long() is None
    held.begin(SimpleNamespace(header=HEADER, **fields))
    now_s = 100.9
    assert held.long() is None
    now_s = 103.24
    long = held.long()
    assert long is not None
    assert (long.header, long.text) == (
        Header(12_500_000_000, "eye"),
        f"one frame has held the worker for 3.2 s {said}",
    )
    held.end()
    assert held.long() is None
