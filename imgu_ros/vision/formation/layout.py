# SPDX-License-Identifier: Apache-2.0
"""What the numbers of a raw image mean: colour model, channel order, Bayer phase."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.types import Choice, Image
from imgu_ros.vision.formation.cfa import BayerPattern


class ColorModel(Choice):
    """How channels are to be read."""

    BAYER = "bayer"  #: (H, W), one colour a site
    MONO = "mono"  #: (H, W)
    RGB = "rgb"  #: (H, W, 3)
    BGR = "bgr"  #: (H, W, 3)
    RGBA = "rgba"  #: (H, W, 4)
    BGRA = "bgra"  #: (H, W, 4)
    ARGB = "argb"  #: (H, W, 4)
    UYVY = "uyvy"  #: (H, W, 2), 4:2:2, chroma first
    YUYV = "yuyv"  #: (H, W, 2), 4:2:2, luma first
    LUMA = "luma"  #: (H, W), the luma plane of a colour picture
    BANDS = "bands"  #: (H, W) or (H, W, N), no colour meaning (infrared, hyperspectral)


@dataclass(frozen=True, slots=True)
class PixelLayout:
    """Colour model, and the Bayer pattern where the model is Bayer."""

    color: ColorModel
    pattern: BayerPattern | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RawImage:
    """Pixels as the sensor gave them, with their meaning.

    Attributes
    ----------
    pixels : (H, W) or (H, W, C), native byte order, any row stride, read-only
    layout : what the channels mean
    remark : what is odd about the data that held them, for people; empty when nothing is
    """

    pixels: Image
    layout: PixelLayout
    remark: str = ""
