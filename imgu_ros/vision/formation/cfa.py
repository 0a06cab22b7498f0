# SPDX-License-Identifier: Apache-2.0
"""Bayer colour filter arrays: which colour a sensor site measures (IU 1.2.2; Bayer, US patent 3971065)."""

from __future__ import annotations

import numpy as np

from imgu_ros.arguments import as_integer, as_sequence, shown_value
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Image, as_image

_LONGEST_PX = 1 << 16


class BayerPattern(Choice):
    """The colours of the top-left 2x2 quad, in reading order, as ROS names them."""

    RGGB = "rggb"
    BGGR = "bggr"
    GRBG = "grbg"
    GBRG = "gbrg"

    def shifted(self, rows: int, columns: int) -> BayerPattern:
        """Return the pattern of the mosaic with that many rows and columns cropped from the top left."""
        quad = [self.value[0:2], self.value[2:4]]
        return BayerPattern("".join(quad[(r + rows) % 2][(c + columns) % 2] for r in (0, 1) for c in (0, 1)))


def mosaic(rgb: Image, pattern: BayerPattern) -> Image:
    """Sample an RGB image through a Bayer colour filter array.

    Parameters
    ----------
    rgb : (H, W, 3) uint8, uint16 or float32
    pattern : colours of the top-left quad

    Returns
    -------
    (H, W) of the same data type

    Raises
    ------
    ShapeError
        If `rgb` is not such an image or the pattern is unknown.
    """
    rgb = as_image(rgb, "rgb", channels=(3,))
    out = np.empty(rgb.shape[:2], rgb.dtype)
    for index, color in enumerate(BayerPattern(pattern).value):
        row, column = divmod(index, 2)
        out[row::2, column::2] = rgb[row::2, column::2, "rgb".index(color)]
    return out


def site_mask(shape: tuple[int, int], pattern: BayerPattern, color: str) -> Image:
    """Return the (H, W) bool mask of the sites that measure `color` ("r", "g" or "b").

    Raises
    ------
    ShapeError
        If the shape is negative, or the pattern or the colour is unknown.
    """
    if not isinstance(color, str) or color not in ("r", "g", "b"):
        raise ShapeError(f"color: {shown_value(color)}; need 'r', 'g' or 'b'")
    sides = [as_integer(side, "shape") for side in as_sequence(shape, "shape")]
    if len(sides) != 2 or not 0 <= min(sides) <= max(sides) <= _LONGEST_PX:
        raise ShapeError(f"shape: {sides}; need (height, width), up to {_LONGEST_PX} px")
    out = np.zeros(sides, bool)
    for index, site in enumerate(BayerPattern(pattern).value):
        row, column = divmod(index, 2)
        out[row::2, column::2] = site == color
    return out


def as_mosaic(raw: Image, name: str = "raw") -> Image:
    """Check a Bayer mosaic and return it, C-contiguous and in native byte order.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    name : of the argument, for the message

    Raises
    ------
    ShapeError
        If it is not such an image.
    """
    raw = as_image(raw, name, dtypes=(np.uint8, np.uint16), rescaled=False)
    if min(raw.shape) < 2:
        raise ShapeError(f"{name}: shape {raw.shape}; need at least one 2x2 quad")
    return raw
