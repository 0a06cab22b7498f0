# SPDX-License-Identifier: Apache-2.0
"""A frame's grey picture at full resolution and halved, as far as somebody asks for it."""

from __future__ import annotations

import cv2

from imgu_ros.errors import ShapeError
from imgu_ros.image.development import Developed
from imgu_ros.types import Image
from imgu_ros.vision.matching.patch_atlas import PatchAtlas

#: A level whose shorter side is below this shows nothing that patches could be aligned with: they are 11 px wide by
#: default.
_SMALLEST_SIDE_PX = 8


class GreyPyramid:
    """The grey picture of a frame and its reductions, each made on the first call, then kept.

    Parameters
    ----------
    developed : the frame
    """

    def __init__(self, developed: Developed) -> None:
        self._developed = developed
        self._halved: list[Image] = []

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width at full resolution, px."""
        return self._developed.shape

    @property
    def is_linear(self) -> bool:
        """Whether the values go with the light; else they are those of sRGB."""
        return self._developed.is_linear

    @property
    def most_halvings(self) -> int:
        """How often the picture can be halved and still shows something."""
        return most_halvings(self.shape)

    def halved(self, times: int) -> Image:
        """Return the picture halved `times` times: each pixel is the mean of 2^times x 2^times, whole ones only.

        Raises
        ------
        ShapeError
            If nothing would be left of it.
        """
        if times < 0 or not min(self.shape) >> times:
            raise ShapeError(f"halved: {times} times, of {self.shape} px; need 0 to {self.most_halvings}")
        if times == 0:
            return self._developed.grey
        if not self._halved:
            self._halved.append(self._developed.halved())
        while len(self._halved) < times:
            last = self._halved[-1]
            height, width = last.shape[0] // 2, last.shape[1] // 2
            self._halved.append(
                cv2.resize(last[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
            )
        return self._halved[times - 1]

    def cut(self, sheet: PatchAtlas) -> Image:
        """Return squares of the picture at full resolution as a sheet; they must begin at even pixels."""
        return self._developed.cut(sheet)


def most_halvings(shape: tuple[int, int]) -> int:
    """Return how often a picture of `shape`, (height, width) px, can be halved and still shows something."""
    return max(0, (min(shape) // _SMALLEST_SIDE_PX).bit_length() - 1)
