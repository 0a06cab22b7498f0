# SPDX-License-Identifier: Apache-2.0
"""The frames of a bag, developed: what may be done with each before the chain has done with the one before it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from imgu_ros.bags.reading import Bag
from imgu_ros.config.parameters import Parameters
from imgu_ros.frame import Frame
from imgu_ros.image.frame_development import Development, develop_frame
from imgu_ros.replay.frame_source import FrameSource


@dataclass(frozen=True, slots=True, eq=False)
class ReadFrame:
    """A recorded frame, ready for the chain.

    Attributes
    ----------
    time_ns : when it was recorded
    frame : decoded; with an image of no pixels when it could not be
    reason : why it could not be decoded; empty when it was
    development : of the frame; None when it could not be decoded
    warnings : what bag and source had said when it was read
    """

    time_ns: int
    frame: Frame
    reason: str
    development: Development | None
    warnings: tuple[str, ...]


def read_ahead(bag: Bag, source: FrameSource, parameters: Parameters) -> Iterator[ReadFrame]:
    """Yield the source's frames; for another thread, which alone then uses `bag` and `source`."""
    for recorded in source.frames():
        development = None if recorded.reason else develop_frame(recorded.frame, parameters)
        warnings = (*bag.warnings, *source.warnings)
        yield ReadFrame(recorded.time_ns, recorded.frame, recorded.reason, development, warnings)


def size_of(read: ReadFrame) -> int:
    """Return about how many bytes a frame keeps: its raw pixels, and as many of grey."""
    return 2 * read.frame.image.pixels.nbytes
