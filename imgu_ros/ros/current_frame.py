# SPDX-License-Identifier: Apache-2.0
"""The frame that a worker has in hand, and whether it takes too long."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.status import image_words

#: A frame that holds the worker for longer is told of.
_LONG_S = 1.0


@dataclass(frozen=True, slots=True)
class LongFrame:
    """A frame that has held the worker for long: its header, and a line about it."""

    header: Header
    text: str


class CurrentFrame:
    """Which message a worker works on. Begun and ended in the worker's thread, asked from any."""

    def __init__(self) -> None:
        self._held: tuple[float, Any] | None = None

    def begin(self, message: Any) -> None:
        """Begin to work on a message with a header."""
        self._held = time.monotonic(), message

    def end(self) -> None:
        """Be done with it."""
        self._held = None

    def long(self) -> LongFrame | None:
        """Return what is in hand for more than a second; None when nothing is."""
        held = self._held
        if held is None:
            return None
        since_s, message = held
        held_s = time.monotonic() - since_s
        if held_s <= _LONG_S:
            return None
        header = decode_header(message)
        what = ", ".join(filter(None, [f"stamp {header.stamp_ns / 1e9:.3f} s", image_words(message)]))
        return LongFrame(header, f"one frame has held the worker for {held_s:.1f} s ({what})")
