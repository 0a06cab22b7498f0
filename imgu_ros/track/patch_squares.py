# SPDX-License-Identifier: Apache-2.0
"""Which squares of a frame an alignment needs: where they are small, only they are developed."""

from __future__ import annotations

import math

import numpy as np

from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.matching.patch_atlas import LONGEST_PX, PatchAtlas

#: Margin around the patches of an atlas, px: for their motion, for interpolation, and for demosaicking. Measured:
#: benchmarks/thresholds.py, study tracking.
_SHEET_ROOM_PX = 4
#: Largest area of an atlas, as a share of the frame: a larger one saves nothing. Measured: benchmarks/thresholds.py,
#: study tracking.
_SHEET_SHARE = 0.4


def atlas_about(
    xy: Points, bounds: tuple[float, ...], image_from_bank: Matrix3, shape: tuple[int, int], window_px: float
) -> PatchAtlas | None:
    """Return the squares of an image about patches, centred at `xy` (N, 2) px; None when that saves little.

    `bounds` are left, top, right and bottom of the centres, px of the bank; `shape` is the image's.
    """
    (a, b, c), (d, e, f), (g, h, i) = image_from_bank.tolist()
    left, top, right, bottom = bounds
    # A homography enlarges most at a corner of the centres' bounding box.
    enlarged = 0.0
    for x, y in ((left, top), (right, top), (right, bottom), (left, bottom)):
        w = g * x + h * y + i
        if not w > 0:
            return None
        u, v = (a * x + b * y + c) / w, (d * x + e * y + f) / w
        enlarged = max(enlarged, (abs(a - u * g) + abs(b - u * h)) / w, (abs(d - v * g) + abs(e - v * h)) / w)
    half = enlarged * (window_px // 2) + _SHEET_ROOM_PX
    height, width = shape
    if not half < min(shape):
        return None
    side = 2 * math.ceil(half)
    if side > min(shape) - 2 or len(xy) * side > min(LONGEST_PX, _SHEET_SHARE * height * width / side):
        return None
    # Even pixels: a quad of the mosaic begins there.
    origins = (np.rint(xy).astype(np.intp) - side // 2) & -2
    np.minimum(origins, ((width - side) & -2, (height - side) & -2), out=origins)
    return PatchAtlas.unchecked(np.maximum(origins, 0, out=origins), side)
