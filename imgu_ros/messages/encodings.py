# SPDX-License-Identifier: Apache-2.0
"""Names of image encodings, as in sensor_msgs/image_encodings.hpp, and their pixel layouts."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from imgu_ros.errors import EncodingError, nearest_name
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout


@dataclass(frozen=True, slots=True)
class Encoding:
    """Meaning of an encoding's name.

    Attributes
    ----------
    name : as in the message
    dtype : data type of one channel, native byte order
    channels : channels of a pixel, >= 1
    layout : what the channels mean
    planar_rows : of YUV in planes, luma first: rows of luma's length that all planes fill, for each row of the
        picture; 0: not in planes
    """

    name: str
    dtype: np.dtype[Any]
    channels: int
    layout: PixelLayout
    planar_rows: float = 0.0

    @property
    def pixel_bytes(self) -> int:
        """Bytes of one pixel."""
        return self.dtype.itemsize * self.channels


def encoding_named(name: str) -> Encoding:
    """Return the encoding called `name`, in whatever case.

    The generic ones are `8U 8S 16U 16S 32S 32F 64F` with `C` and any number of channels; without, one channel. Of YUV
    in planes (`nv12 nv21 nv16 nv61 nv24 nv42 yuv420 i420 yv12 ...`) the luma is read.

    Raises
    ------
    EncodingError
        If the pipeline cannot read it; the message names the nearest known one, when there is one.
    """
    # The name comes from outside: of an endless one nothing but the start is looked at, kept or shown.
    return _encoding_named(name[:_LONGEST_NAME])


@lru_cache(maxsize=256)
def _encoding_named(name: str) -> Encoding:
    folded = name.strip().lower()
    if folded in _NAMED:
        return _NAMED[folded]
    generic = _GENERIC.fullmatch(folded.upper())
    if generic:
        channels = int(generic["channels"] or 1)
        layout = PixelLayout(ColorModel.BANDS)
        return Encoding(generic[0], np.dtype(_DEPTHS[generic["depth"]]), channels, layout)
    known = [*_NAMED, *(f"{depth}C{n}" for depth in _DEPTHS for n in (1, 2, 3, 4))]
    start = name[:40]
    near = nearest_name(start, known)
    hint = f"nearest known: {near!r}" if near else "need a name such as mono8, rgb8, bayer_rggb8, yuyv, nv12 or 8UC1"
    raise EncodingError(f"encoding: {start!r} is unknown; {hint}")


def encoding_names() -> tuple[str, ...]:
    """Return the names of encodings that are known, of the generic ones the usual."""
    return (*_NAMED, *(f"{depth}C{n}" for depth in _DEPTHS for n in (1, 3)))


def is_image_encoding(name: str) -> bool:
    """Whether the pipeline can read images of this encoding."""
    try:
        encoding_named(name)
    except EncodingError:
        return False
    return True


def encoding_for(dtype: Any, channels: int) -> str:
    """Return the usual name for grey (1 channel) or RGB (3 channels) pixels of a data type.

    Raises
    ------
    EncodingError
        If there is none.
    """
    names = {
        ("u1", 1): "mono8",
        ("u2", 1): "mono16",
        ("u1", 3): "rgb8",
        ("u2", 3): "rgb16",
        ("f4", 1): "32FC1",
        ("f4", 3): "32FC3",
    }
    found = names.get((np.dtype(dtype).str[1:], channels))
    if found is None:
        raise EncodingError(f"pixels: {np.dtype(dtype)} x {channels}; need uint8, uint16 or float32, 1 or 3 channels")
    return found


_LONGEST_NAME = 80
#: At most four digits: no one has more bands, and Python refuses to convert an endless number.
_GENERIC = re.compile(r"(?P<depth>8U|8S|16U|16S|32S|32F|64F)(C(?P<channels>[1-9][0-9]{0,3}))?")
_DEPTHS = {"8U": "u1", "8S": "i1", "16U": "u2", "16S": "i2", "32S": "i4", "32F": "f4", "64F": "f8"}


def _named() -> dict[str, Encoding]:
    table: dict[str, Encoding] = {}

    def add(name: str, bits: int, channels: int, color: ColorModel, pattern: BayerPattern | None = None) -> None:
        table[name] = Encoding(name, np.dtype(f"u{bits // 8}"), channels, PixelLayout(color, pattern))

    for bits in (8, 16):
        add(f"mono{bits}", bits, 1, ColorModel.MONO)
        add(f"rgb{bits}", bits, 3, ColorModel.RGB)
        add(f"bgr{bits}", bits, 3, ColorModel.BGR)
        add(f"rgba{bits}", bits, 4, ColorModel.RGBA)
        add(f"bgra{bits}", bits, 4, ColorModel.BGRA)
        # Not among ROS's names: alpha first, as some graphics libraries have it.
        add(f"argb{bits}", bits, 4, ColorModel.ARGB)
        for pattern in BayerPattern:
            add(f"bayer_{pattern}{bits}", bits, 1, ColorModel.BAYER, pattern)
    for name, color in (
        ("uyvy", ColorModel.UYVY),
        ("yuv422", ColorModel.UYVY),
        ("yuyv", ColorModel.YUYV),
        ("yuv422_yuy2", ColorModel.YUYV),
        ("yuy2", ColorModel.YUYV),
    ):
        add(name, 8, 2, color)
    # YUV in planes, 4:2:0, 4:2:2 and 4:4:4: the names of sensor_msgs, of V4L2 and of GStreamer.
    for rows, names in (
        (1.5, ("nv12", "nv21", "yuv420", "yuv420p", "i420", "iyuv", "yu12", "yv12")),
        (2.0, ("nv16", "nv61", "yuv422p", "i422")),
        (3.0, ("nv24", "nv42", "yuv444p", "i444")),
    ):
        for name in names:
            table[name] = Encoding(name, np.dtype(np.uint8), 1, PixelLayout(ColorModel.LUMA), rows)
    return table


_NAMED = _named()
