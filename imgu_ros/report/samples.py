# SPDX-License-Identifier: Apache-2.0
"""Annotated frames, spread over a replay of unknown length, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import FileError
from imgu_ros.report.overlay import draw_result
from imgu_ros.result import Result
from imgu_ros.types import Image

#: Frames that are spread evenly, at least; at most twice as many but one. Misses: the first frames without a find.
_KEPT, _MISSES = 48, 8
_LONGEST_SIDE, _QUALITY = 640, 75
#: All pictures of a report together, bytes: as text in its page they take a third more.
_MOST_BYTES = 2_400_000


@dataclass(frozen=True, slots=True, eq=False)
class AnnotatedFrame:
    """One annotated frame.

    Attributes
    ----------
    index : the frame's number in the replay, from 0
    stamp_ns : its stamp
    caption : what became of the targets
    jpeg : the picture, at most 640 px long
    """

    index: int
    stamp_ns: int
    caption: str
    jpeg: bytes


class SampleChoice:
    """Which frames are kept while they pass by: evenly spread ones, and some in which nothing was found any more.

    Every `stride`-th frame is kept; when twice as many as wanted are held, every other one is dropped and the stride
    doubles. So n frames cost O(log n) drawings, and less than a hundred when their number was known.

    Parameters
    ----------
    expected : number of frames that will come, as far as that is known; which ones are kept depends on nothing but
        this and how many there are

    Attributes
    ----------
    even, misses : numbers of the frames that are kept, from 0
    """

    def __init__(self, expected: int = 0) -> None:
        self.even: list[int] = []
        self.misses: list[int] = []
        self._stride = max(1, -(-expected // (2 * _KEPT - 1)))
        self._is_missing = False
        self._frames = 0

    def is_due(self, result: Result) -> bool:
        """Look at the next frame, and return whether it is to be kept."""
        index, self._frames = self._frames, self._frames + 1
        was_missing, self._is_missing = (
            self._is_missing,
            not any(target.status.found for target in result),
        )
        is_miss = self._is_missing and not was_missing and len(self.misses) < _MISSES
        is_even = index % self._stride == 0
        if is_miss:
            self.misses.append(index)
        if is_even:
            self.even.append(index)
        if len(self.even) == 2 * _KEPT:
            self._stride *= 2
            self.even = [kept for kept in self.even if kept % self._stride == 0]
        return is_miss or is_even


class Samples:
    """Draws the frames that a `SampleChoice` of `expected` frames keeps."""

    def __init__(self, expected: int = 0) -> None:
        self._choice = SampleChoice(expected)
        self._kept: dict[int, AnnotatedFrame] = {}

    def offer(self, index: int, result: Result) -> None:
        """Look at frame number `index`, the next one, and draw it when it is to be kept."""
        if self._choice.is_due(result):
            self._kept[index] = _sample(index, result)
            wanted = {*self._choice.even, *self._choice.misses}
            self._kept = {number: sample for number, sample in self._kept.items() if number in wanted}

    def chosen(self) -> tuple[AnnotatedFrame, ...]:
        """Return the kept samples in order of time, fewer of the even ones where their pictures are large."""
        even, misses = self._choice.even, self._choice.misses
        for count in range(len(even), 0, -1):
            places = np.linspace(0, len(even) - 1, count)
            chosen = sorted({*(even[round(place)] for place in places), *misses})
            if count == 1 or sum(len(self._kept[index].jpeg) for index in chosen) <= _MOST_BYTES:
                return tuple(self._kept[index] for index in chosen)
        return tuple(self._kept[index] for index in misses)


def _sample(index: int, result: Result) -> AnnotatedFrame:
    caption = ", ".join(f"{t.name}: {t.status.value}" for t in result)
    return AnnotatedFrame(index, result.frame.stamp_ns, caption, jpeg_of(draw_result(result), _LONGEST_SIDE, _QUALITY))


def jpeg_of(picture: Image, longest_side: int, quality: int) -> bytes:
    """Return a picture, (H, W, 3) RGB uint8, as JPEG, reduced to at most `longest_side` px.

    Raises
    ------
    FileError
        If it cannot be encoded.
    """
    longest = max(picture.shape[:2])
    if longest > longest_side:
        scale = longest_side / longest
        height, width = picture.shape[:2]
        # A line camera's picture must not shrink to nothing.
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise FileError(f"picture: {picture.shape} cannot be encoded as JPEG; need a picture")
    return data.tobytes()
