"""A handful of annotated frames, spread over a replay of unknown length, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import FileError
from imgu_ros.perception.result import Result
from imgu_ros.report.overlay import draw_result
from imgu_ros.types import Image

_KEPT = 6
_MISSES = 3
_LONGEST_SIDE = 960
_QUALITY = 85


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One annotated frame.

    Attributes
    ----------
    index : the frame's number in the replay, from 0
    stamp_ns : its stamp
    caption : what became of the targets
    jpeg : the picture, at most 960 px long
    """

    index: int
    stamp_ns: int
    caption: str
    jpeg: bytes


class Samples:
    """Collects samples while frames pass by: about six, evenly spread, and three in which nothing was found any more.

    Every `stride`-th frame is kept; when twice as many as wanted are held, every other one is dropped and the stride
    doubles. So n frames cost O(log n) drawings, and eleven when their number was known.

    Parameters
    ----------
    expected : number of frames that will be offered, as far as that is known; which ones are kept depends on nothing
        but this and how many there are
    """

    def __init__(self, expected: int = 0) -> None:
        self._stride = max(1, (expected - 1) // (2 * _KEPT - 2))
        self._even: list[Sample] = []
        self._misses: list[Sample] = []
        self._is_missing = False

    def offer(self, index: int, result: Result) -> None:
        """Look at frame number `index`, and draw it when it is to be kept."""
        was_missing, self._is_missing = self._is_missing, not any(target.status.found for target in result.targets)
        is_miss = self._is_missing and not was_missing and len(self._misses) < _MISSES
        if index % self._stride and not is_miss:
            return
        sample = _sample(index, result)
        if is_miss:
            self._misses.append(sample)
        if index % self._stride == 0:
            self._even.append(sample)
        if len(self._even) == 2 * _KEPT:
            self._stride *= 2
            self._even = [kept for kept in self._even if kept.index % self._stride == 0]

    def chosen(self) -> tuple[Sample, ...]:
        """Return the kept samples in order of time."""
        places = np.linspace(0, len(self._even) - 1, min(_KEPT, len(self._even)))
        even = [self._even[round(place)] for place in places]
        kept = {sample.index: sample for sample in (*even, *self._misses)}
        return tuple(kept[index] for index in sorted(kept))


def _sample(index: int, result: Result) -> Sample:
    caption = ", ".join(f"{t.name}: {t.status.value}" for t in result.targets)
    return Sample(index, result.frame.stamp_ns, caption, _jpeg(draw_result(result)))


def _jpeg(picture: Image) -> bytes:
    longest = max(picture.shape[:2])
    if longest > _LONGEST_SIDE:
        scale = _LONGEST_SIDE / longest
        height, width = picture.shape[:2]
        # A line camera's picture must not shrink to nothing.
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not done:
        raise FileError(f"sample frame: {picture.shape} cannot be encoded as JPEG; need a picture")
    return data.tobytes()
