# SPDX-License-Identifier: Apache-2.0
"""What the pixels of an image file are: grey, colour, or a mosaic, as `--pattern` or `raw.encoding` says."""

from __future__ import annotations

from pathlib import Path

from imgu_ros.errors import FileError, ParameterError
from imgu_ros.messages.encodings import encoding_named
from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout


def picture_layout(path: Path, pixels: Image, pattern: str | None, encoding: str) -> PixelLayout:
    """Return what an image file's pixels are.

    Parameters
    ----------
    path : of the file, for messages
    pixels : (H, W) or (H, W, 3) RGB
    pattern : `--pattern`; None: not given
    encoding : `raw.encoding`; empty: not given

    Raises
    ------
    FileError
        If the pixels cannot be that.
    ParameterError
        If pattern and encoding differ.
    """
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if encoding:
        wanted = encoding_named(encoding)
        packed = wanted.planar_rows or wanted.layout.color in (ColorModel.UYVY, ColorModel.YUYV)
        if packed or (wanted.channels, wanted.dtype) != (channels, pixels.dtype):
            raise FileError(
                f"{path}: {channels} channel{'s' * (channels > 1)} of {pixels.dtype}; need {wanted.channels} of "
                f"{wanted.dtype} for raw.encoding {wanted.name}"
            )
        said = wanted.layout.pattern
        if pattern and (said is None or said != pattern):
            raise ParameterError(f"--pattern: {pattern} with raw.encoding {wanted.name}; need one of them, or the same")
        return wanted.layout
    if pattern:
        if channels != 1:
            raise FileError(f"{path}: {channels} channels; need one for --pattern")
        return PixelLayout(ColorModel.BAYER, BayerPattern(pattern))
    return PixelLayout(ColorModel.MONO if channels == 1 else ColorModel.RGB)
