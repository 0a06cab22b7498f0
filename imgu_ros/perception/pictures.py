"""A frame's grey picture at full resolution and halved, as often as somebody asks for."""

from __future__ import annotations

import cv2

from imgu_ros.types import Image

_SMALLEST_SIDE_PX = 8


class Pictures:
    """The grey picture of a frame and its reductions, each made on the first call, then kept.

    Parameters
    ----------
    grey : (H, W) uint8, full resolution
    """

    def __init__(self, grey: Image) -> None:
        self._levels = [grey]

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width at full resolution, px."""
        height, width = self._levels[0].shape
        return height, width

    @property
    def most_halvings(self) -> int:
        """How often the picture can be halved."""
        return max(0, (min(self.shape) // _SMALLEST_SIDE_PX).bit_length() - 1)

    def halved(self, times: int) -> Image:
        """Return the picture halved `times` times: each pixel is the mean of 2^times x 2^times, whole ones only."""
        while len(self._levels) <= times:
            last = self._levels[-1]
            height, width = last.shape[0] // 2, last.shape[1] // 2
            self._levels.append(
                cv2.resize(last[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
            )
        return self._levels[times]
