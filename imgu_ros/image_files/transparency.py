# SPDX-License-Identifier: Apache-2.0
"""Pictures with transparency, composed on white, as they are printed on paper."""

from __future__ import annotations

import numpy as np

from imgu_ros.image_files.tags import ExtraSample, PictureTags
from imgu_ros.types import Image
from imgu_ros.vision.processing.points import full_scale


def compose(color: Image, alpha: Image, kind: ExtraSample = ExtraSample.STRAIGHT) -> None:
    """Put a picture on white, in place, in the file's own values as viewers compose (not in linear light).

    Parameters
    ----------
    color : (H, W) or (H, W, 3) uint8, uint16, or float32 of full scale 1; opaque pixels keep their values
    alpha : (H, W) of the same data type; 0: transparent, full scale: opaque
    kind : whether the colours were multiplied by alpha already
    """
    # Some rows at a time: in float64 the whole picture would take eight times its memory.
    for top in range(0, len(color), _STRIP_ROWS):
        rows = slice(top, top + _STRIP_ROWS)
        color[rows] = _composed(color[rows], alpha[rows], kind)


_STRIP_ROWS = 64


def _composed(color: Image, alpha: Image, kind: ExtraSample) -> Image:
    full = full_scale(color.dtype)
    dtype = np.float32 if color.dtype == np.uint8 else np.float64  # what products of two values need
    opacity = np.clip(np.asarray(alpha, dtype) / dtype(full), 0, 1)
    if color.ndim == 3:
        opacity = opacity[:, :, None]
    values = np.asarray(color, dtype)
    under = (1 - opacity) * dtype(full)
    if kind is ExtraSample.PREMULTIPLIED:
        out = np.minimum(values, dtype(full) * opacity) + under
    else:
        out = np.where(opacity == 0, under, values * opacity + under)  # whatever a transparent pixel holds, NaN too
    return np.asarray(out if color.dtype.kind == "f" else np.rint(out), color.dtype)


def split_alpha(pixels: Image, tags: PictureTags) -> tuple[Image, Image | None]:
    """Return the colours or greys of a decoded picture, and its alpha (H, W); None when it is opaque everywhere.

    Parameters
    ----------
    pixels : (H, W), (H, W, 3) RGB or (H, W, 4) RGBA, as a decoder gives them
    tags : of the file
    """
    full = full_scale(pixels.dtype)
    color, alpha = pixels, None
    if pixels.ndim == 2 and tags.clear_grey is not None:
        value, largest = tags.clear_grey
        clear = value * full // largest  # 1, 2 and 4 bits are decoded to 8
        alpha = np.full_like(pixels, full)
        alpha[pixels == clear] = 0
    elif pixels.ndim == 3 and pixels.shape[2] == 4:
        color = np.ascontiguousarray(pixels[:, :, 0] if tags.grey_with_alpha else pixels[:, :, :3])
        alpha = None if tags.extra is ExtraSample.OTHER else np.ascontiguousarray(pixels[:, :, 3])
    return color, alpha if alpha is not None and (alpha < full).any() else None
