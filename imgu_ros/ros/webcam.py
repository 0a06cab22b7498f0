# SPDX-License-Identifier: Apache-2.0
"""A webcam of this machine, by OpenCV and Video4Linux."""

from __future__ import annotations

import glob
import time

import cv2
import numpy as np

from imgu_ros.errors import BagError
from imgu_ros.types import Image

#: Reads that may fail in a row: OpenCV waits up to 10 s in each.
_MOST_FAILURES = 3
#: A capture time of the driver that is further than so many s before the read is on another clock.
_OLDEST_S = 1.0


class Webcam:
    """Captures frames.

    Parameters
    ----------
    source : its number, or its `/dev` file
    size : width, height to ask for, px; None: as it likes
    rate_hz : frames a second to ask for; 0: as it likes

    Raises
    ------
    BagError
        If there is no such webcam, or it cannot be opened.
    """

    def __init__(self, source: str, size: tuple[int, int] | None = None, rate_hz: float = 0.0) -> None:
        self._source = source
        self._capture = cv2.VideoCapture(int(source) if source.isdecimal() else source, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            there = ", ".join(sorted(glob.glob("/dev/video*"))) or "none"
            raise BagError(
                f"camera {source}: cannot be opened; need a webcam that no other program uses (there are: {there}), a "
                "video, or pictures"
            )
        # A frame that waits in the driver is old when it comes.
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if size is not None:
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        if rate_hz:
            self._capture.set(cv2.CAP_PROP_FPS, rate_hz)

    def read(self) -> tuple[int, Image]:
        """Wait for the next frame, and return when it was captured, ns on the clock of the wall, and (H, W, 3) BGR.

        Raises
        ------
        BagError
            If no frame comes any more.
        """
        for _ in range(_MOST_FAILURES):
            is_there, pixels = self._capture.read()
            if is_there and pixels is not None:
                return self._captured_ns(), np.ascontiguousarray(pixels)
        raise BagError(f"camera {self._source}: gives no frame any more; need one that is plugged in")

    def close(self) -> None:
        """Give the webcam back; closing twice does nothing."""
        self._capture.release()

    def _captured_ns(self) -> int:
        """Return the driver's time of capture, which Video4Linux gives on the monotonic clock, else now."""
        now_ns = time.time_ns()
        since_s = time.monotonic() - self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
        return now_ns - round(since_s * 1e9) if 0 <= since_s < _OLDEST_S else now_ns
