# SPDX-License-Identifier: Apache-2.0
"""Runs a demosaicking recipe over a mosaic, strip by strip: any phase, size and depth, on all of OpenCV's threads."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from imgu_ros.arguments import require_type
from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern, as_mosaic
from imgu_ros.vision.formation.demosaicking.quads import Field, Missing, Quads

#: Bytes of a field in a strip: enough that calls cost little beside their work and threads seldom wait for one another,
#: few enough that the fields stay in a core's cache.
_FIELD_BYTES = 1 << 18
#: Quads that a thread of its own pays for.
_FEWEST_QUADS = 1 << 14


@dataclass(frozen=True, slots=True, eq=False)
class StripMethod:
    """A demosaicking method for the quads of a strip.

    Attributes
    ----------
    missing : finds the missing colours
    reach : quads on each side that a result depends on
    shift : largest shift of a view, quads
    scale : by which the results are too large, a power of two
    integer : whether sums of 8-bit data fit 16-bit integers all the way; other data are worked on in float32
    """

    missing: Callable[[Quads], Missing]
    reach: int
    shift: int
    scale: int
    integer: bool


def demosaic_in_strips(raw: Image, pattern: BayerPattern, recipe: StripMethod) -> Image:
    """Reconstruct colour by a recipe.

    The result does not depend on the number of threads (`cv2.setNumThreads`) or strips.

    Parameters
    ----------
    raw : (H, W) uint8 or uint16, H and W at least 2
    pattern : colours of the top-left quad
    recipe : the method

    Returns
    -------
    (H, W, 3) RGB of the same data type; measured values are kept.

    Raises
    ------
    ShapeError
        If `raw` is not such an image or the pattern is unknown.
    """
    require_type(recipe, StripMethod, "recipe")
    raw, pattern = as_mosaic(raw), BayerPattern(pattern)
    height, width = raw.shape
    rim = 2 * recipe.reach
    # Mirror images about the outermost rows and columns keep the Bayer phase; an odd number of them at the top or on
    # the left brings the first quad's first site to red. So recipes know one phase alone.
    row, column = divmod(pattern.value.index("r"), 2)
    bottom, right = rim + (height + row) % 2, rim + (width + column) % 2
    extended = cv2.copyMakeBorder(raw, rim + row, bottom, rim + column, right, cv2.BORDER_REFLECT_101)
    out = np.empty((height, width, 3), raw.dtype)
    rows, columns = extended.shape[0] // 2 - rim, extended.shape[1] // 2 - rim
    whole = (2 * rows, 2 * columns) == raw.shape
    threads = max(1, min(cv2.getNumThreads(), rows * columns // _FEWEST_QUADS))
    quads = min(_FIELD_BYTES // _dtype(recipe, raw).itemsize, rows * columns // threads + 1)
    count = -(-rows // max(2 * rim, quads // (columns + rim)))

    def work(index: int) -> None:
        first, last = rows * index // count, rows * (index + 1) // count
        strip = extended[2 * first : 2 * (last + rim)]
        if whole:
            _develop(strip, recipe, out[2 * first : 2 * last])
            return
        # The first or the last row or column of quads is cut by the picture's edge.
        colors = np.empty((2 * (last - first), 2 * columns, 3), raw.dtype)
        _develop(strip, recipe, colors)
        begin, end = max(0, 2 * first - row), min(height, 2 * last - row)
        skipped = begin + row - 2 * first
        out[begin:end] = colors[skipped : skipped + end - begin, column : column + width]

    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(work, range(count)))
    else:
        for index in range(count):
            work(index)
    return out


def _develop(strip: Image, recipe: StripMethod, out: Image) -> None:
    """Write the colours of a strip that starts at a red site, without its rim, to `out`."""
    height, width = strip.shape[0] // 2, strip.shape[1] // 2
    dtype = _dtype(recipe, strip)
    fields = []
    for row in (0, 1):
        for plane in cv2.split(strip[row::2].reshape(height, width, 2)):
            fields.append(Field(height, width, recipe.shift, dtype))
            np.copyto(fields[-1].at(), plane.reshape(-1))
    red, green_by_red, green_by_blue, blue = fields
    top = float(np.iinfo(strip.dtype).max)
    q = Quads(red, green_by_red, green_by_blue, blue, height, width, recipe.shift, dtype, top)
    found = recipe.missing(q)
    upper = (red, found.red_by_red), (found.green_at_red, green_by_red), (found.blue_at_red, found.blue_by_red)
    lower = (found.red_by_blue, found.red_at_blue), (green_by_blue, found.green_at_blue), (found.blue_by_blue, blue)
    row_of = _row_of_integers if dtype.kind == "i" else _row
    for first, pairs in enumerate((upper, lower)):
        rows = [row_of(even, odd, fields, recipe, out.dtype) for even, odd in pairs]
        cv2.merge(rows, dst=out[first::2])


def _dtype(recipe: StripMethod, raw: Image) -> np.dtype[Any]:
    """Return what fields hold."""
    # Pairs of 16-bit integers are made rows of bytes in the order of little-endian machines.
    integer = recipe.integer and raw.dtype == np.uint8 and sys.byteorder == "little"
    return np.dtype(np.int16 if integer else np.float32)


def _row_of_integers(
    even: Field, odd: Field, measured: Sequence[Field], recipe: StripMethod, dtype: np.dtype[np.generic]
) -> Image:
    """Return the 8-bit rows of two fields of integers: the even values become low bytes, the odd ones high bytes."""
    for field in (even, odd):
        if field not in measured:
            values = field.at()
            values += np.int16(recipe.scale // 2)
            values >>= recipe.scale.bit_length() - 1
            np.clip(values, 0, 255, out=values)
    both = odd.at()
    both <<= 8
    both |= even.at()
    return odd.inside(recipe.reach).view(np.uint8)


def _row(even: Field, odd: Field, measured: Sequence[Field], recipe: StripMethod, dtype: np.dtype[np.generic]) -> Image:
    """Return the rows of two fields of real numbers."""
    depth = cv2.CV_8U if dtype == np.uint8 else cv2.CV_16U
    planes: list[Image] = []
    for field in (even, odd):
        inside, factor = field.inside(recipe.reach), 1.0 if field in measured else 1 / recipe.scale
        # Scales, rounds and saturates in one pass.
        planes.append(cv2.addWeighted(inside, factor, inside, 0.0, 0.0, dtype=depth))
    return cv2.merge(planes).reshape(len(planes[0]), -1)
