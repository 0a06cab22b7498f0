# SPDX-License-Identifier: Apache-2.0
"""The thread of a node that processes frames, one after the other; for the perception node and the stage nodes."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.status import image_words
from imgu_ros.ros.frame_queue import FrameQueue
from imgu_ros.ros.meters import LatencyMeter, RateMeter

#: The worker waits for no longer than this for a thread that wants to come between two frames.
_LONGEST_HOLD_S = 0.3
#: A frame that takes longer is reported.
_LONG_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class FrameMessages:
    """The messages of one frame.

    Attributes
    ----------
    messages : all of one stamp, by the names of the inputs that they came from
    camera_info : the camera_info message that belongs to them, or None
    received_s : when the last one came, monotonic
    frame_id : of the camera
    """

    messages: Mapping[str, Any]
    camera_info: Any | None
    received_s: float
    frame_id: str = ""

    @property
    def message(self) -> Any:
        """The one that came first."""
        return next(iter(self.messages.values()))


class FrameFigures:
    """Counts of frames. Thread-safe for one writer.

    Attributes
    ----------
    done : frames that were processed
    latency : from the delivery of a frame's messages to the end of publishing its results
    rejected : frames that could not be processed
    rejection : why the last frame could not be processed; empty when it could
    """

    def __init__(self) -> None:
        self.done = RateMeter()
        self.latency = LatencyMeter()
        self.rejected = 0
        self.rejection = ""

    def count_done(self, received_s: float) -> None:
        """Count a frame whose last message came at `received_s` (monotonic) and whose results are published now."""
        now = time.monotonic()
        self.done.tick(now)
        self.latency.add(now - received_s)

    def count_rejected(self, reason: str) -> None:
        """Note whether a frame could be processed: `reason` is empty when it could."""
        self.rejection = reason
        self.rejected += bool(reason)

    def values(self, now_s: float) -> Mapping[str, object]:
        """Return rate, number of frames and latencies as /diagnostics has them; `now_s` is monotonic."""
        names = ("latency_p50_ms", "latency_p95_ms", "latency_max_ms")
        return {
            "rate_hz": self.done.rate_hz(now_s),
            "frames": self.done.count,
            **dict(zip(names, self.latency.percentiles_ms(), strict=False)),
        }


@dataclass(frozen=True, slots=True)
class LongFrame:
    """A frame that has occupied the worker for long: its header, and a line about it."""

    header: Header
    text: str


class FrameWorker:
    """Takes frames from a queue and processes each, in a thread of its own. Methods may be called from any thread.

    Parameters
    ----------
    queue : where frames come from
    process : processes and publishes one frame, in the worker's thread; after an exception it goes on with the next
    failed : takes a line about such an exception

    Attributes
    ----------
    figures : counts of frames, kept by `process`
    """

    def __init__(
        self, queue: FrameQueue[FrameMessages], process: Callable[[FrameMessages], None], failed: Callable[[str], None]
    ) -> None:
        self.figures = FrameFigures()
        self._queue = queue
        self._process = process
        self._failed = failed
        self._lock = threading.RLock()
        self._go_on = threading.Event()
        self._go_on.set()
        self._closing = False
        self._current: tuple[float, Any] | None = None
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread.start()

    @property
    def is_closing(self) -> bool:
        """Whether nothing is to be published any more."""
        return self._closing

    def long_frame(self) -> LongFrame | None:
        """Return the frame that is processed when it takes more than a second so far; else None."""
        current = self._current
        if current is None:
            return None
        since_s, message = current
        held_s = time.monotonic() - since_s
        if held_s <= _LONG_S:
            return None
        header = decode_header(message)
        described = ", ".join(filter(None, [f"stamp {header.stamp_ns / 1e9:.3f} s", image_words(message)]))
        return LongFrame(header, f"one frame has held the worker for {held_s:.1f} s ({described})")

    @contextlib.contextmanager
    def between_frames(self) -> Iterator[None]:
        """Hold the worker between two frames."""
        with self._lock:
            yield

    @contextlib.contextmanager
    def soon_between_frames(self) -> Iterator[bool]:
        """Hold the worker between two frames if it is there, and give whether it is; it will be when called again soon.

        For a thread that must not wait until a long frame is done.
        """
        if not self._lock.acquire(blocking=False):
            self._go_on.clear()
            yield False
            return
        try:
            yield True
        finally:
            self._lock.release()
            self._go_on.set()

    def close(self, timeout_s: float = 1.0) -> bool:
        """End the thread; return whether it has ended in time. It publishes nothing any more in any case."""
        self._closing = True
        self._go_on.set()
        self._queue.close()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (frame := self._queue.take()) is not None:
            # Another thread may want to come between two frames: not for long.
            if not self._go_on.wait(_LONGEST_HOLD_S):
                self._go_on.set()
            try:
                with self._lock:
                    self._current = time.monotonic(), frame.message
                    self._process(frame)
            except Exception as error:
                # One bad frame must not end the node, whatever is wrong with it.
                if not self._closing:
                    self._failed(f"frame: {type(error).__name__}: {' '.join(str(error).split())}")
            finally:
                self._current = None
