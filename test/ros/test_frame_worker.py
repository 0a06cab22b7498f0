# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import pytest

from imgu_ros.messages.header import Header
from imgu_ros.ros import frame_worker
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.frame_worker import FrameFigures, FrameMessages, FrameWorker
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
def test_a_frame_of_more_than_a_second_is_reported(monkeypatch: pytest.MonkeyPatch, fields: dict, said: str) -> None:
    now_s = 100.0
    monkeypatch.setattr(frame_worker, "time", SimpleNamespace(monotonic=lambda: now_s))
    begun, free = threading.Event(), threading.Event()
    queue: FrameQueue[FrameMessages] = FrameQueue()
    worker = FrameWorker(queue, lambda _: (begun.set(), free.wait(20)), lambda _: None)
    try:
        assert worker.long_frame() is None
        queue.put(FrameMessages({"image_raw": SimpleNamespace(header=HEADER, **fields)}, None, 0.0))
        assert begun.wait(20)
        now_s = 100.9
        assert worker.long_frame() is None
        now_s = 103.24
        long = worker.long_frame()
        assert long is not None
        assert (long.header, long.text) == (
            Header(12_500_000_000, "eye"),
            f"one frame has held the worker for 3.2 s {said}",
        )
        with worker.soon_between_frames() as between:
            assert not between
        free.set()
    finally:
        free.set()
        assert worker.close(20)
    assert worker.long_frame() is None


def test_a_frame_that_cannot_be_processed_ends_nothing() -> None:
    queue: FrameQueue[FrameMessages] = FrameQueue()
    done, failures = threading.Event(), []

    def process(frame: FrameMessages) -> None:
        if frame.frame_id == "bad":
            raise ValueError("no\nnumber")
        done.set()

    worker = FrameWorker(queue, process, failures.append)
    for frame_id in ("bad", "good"):
        queue.put(FrameMessages({"image_raw": SimpleNamespace(header=HEADER)}, None, 0.0, frame_id))
    assert done.wait(20)
    assert failures == ["frame: ValueError: no number"]
    assert worker.close(20)


def test_figures() -> None:
    figures = FrameFigures()
    assert figures.values(0.0) == {"rate_hz": 0.0, "frames": 0}
    figures.count_rejected("too dark")
    assert (figures.rejected, figures.rejection) == (1, "too dark")
    figures.count_rejected("")
    assert (figures.rejected, figures.rejection) == (1, "")
    figures.count_done(time.monotonic() - 0.5)
    values = figures.values(time.monotonic())
    assert values["frames"] == 1
    assert 400 < float(str(values["latency_p50_ms"])) < 60_000
