# SPDX-License-Identifier: Apache-2.0
"""BRIEF: 256 intensity comparisons at random places of a smoothed, upright patch (IU 5.4.1; Calonder 2010)."""

from __future__ import annotations

import operator

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_image
from imgu_ros.vision.descriptors.described import Described, checked_corners
from imgu_ros.vision.keypoints.keypoints import Corners

#: Side of the patch, px of the level.
PATCH_PX = 31
#: Of a descriptor.
BITS = 256
#: Comparing single pixels compares their noise (Calonder 2010, section 3.1).
_SMOOTHING_PX = 2.0
_SMOOTHING_KERNEL = (9, 9)
#: Descriptors of different seeds cannot be compared.
_SEED = 0
_MOST_PAIRS = 2**16


def describe_brief(image: Image, corners: Corners, seed: int = _SEED) -> Described:
    """Describe corners of one image by 32 bytes each; their angles and scales are not used.

    Bit k is set where the smoothed image is darker at the first place of pair k than at the second.

    Parameters
    ----------
    image : (H, W) uint8
    corners : rounded to the nearest pixel; those nearer to the border than half a patch are left out
    seed : of the places, see `brief_pairs`; descriptors compare only with those of the same seed

    Raises
    ------
    ShapeError
        If the image or a corner is not of that kind.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(0).integers(0, 256, (60, 60), np.uint8)
    >>> one = np.ones(1)
    >>> described = describe_brief(image, Corners(np.array([[30.0, 30.0]]), one, 0 * one, one))
    >>> described.descriptors.shape
    (1, 32)
    """
    seed = as_integer(seed, "seed")
    image = as_image(image, dtypes=(np.uint8,))
    corners = checked_corners(corners)
    pairs = brief_pairs(seed)
    height, width = image.shape
    margin = PATCH_PX // 2
    columns, rows = np.rint(corners.xy).astype(np.intp).T
    inside = np.flatnonzero(
        (columns >= margin) & (rows >= margin) & (columns < width - margin) & (rows < height - margin)
    )
    smoothed = cv2.GaussianBlur(image, _SMOOTHING_KERNEL, _SMOOTHING_PX).ravel()
    at = rows[inside] * width + columns[inside]
    first, second = (smoothed[at[:, None] + (pairs[:, k, 1] * width + pairs[:, k, 0])] for k in (0, 1))
    return Described(inside, np.packbits(first < second, axis=1))


def brief_pairs(seed: int = _SEED, count: int = BITS) -> NDArray[np.intp]:
    """Return places to compare: pairs of different pixels of the patch, both normally distributed about its centre.

    Standard deviation a fifth of the patch's side along x and along y, cut off at its edges (Calonder 2010, section
    3.2, arrangement G II, the one that did best there).

    Returns
    -------
    (count, 2, 2) offsets from the centre, px: pair, end, (x, y).

    Raises
    ------
    ShapeError
        If `seed` is no integer >= 0, or count not from 1 to 65536.

    Examples
    --------
    >>> brief_pairs(seed=1).shape
    (256, 2, 2)
    """
    seed = as_integer(seed, "seed")
    count = as_integer(count, "count")
    try:
        seed, count = operator.index(seed), operator.index(count)
    except TypeError:
        raise ShapeError(f"seed, count: {seed!r}, {count!r}; need integers") from None
    if seed < 0 or not 1 <= count <= _MOST_PAIRS:
        raise ShapeError(f"seed, count: {seed}, {count}; need at least 0, and 1 to {_MOST_PAIRS}")
    rng = np.random.default_rng(seed)
    pairs = np.zeros((0, 2, 2), np.intp)
    while len(pairs) < count:
        drawn = np.rint(rng.normal(0.0, PATCH_PX / 5, (2 * count, 2, 2))).astype(np.intp)
        usable = (np.abs(drawn) <= PATCH_PX // 2).all(axis=(1, 2)) & (drawn[:, 0] != drawn[:, 1]).any(axis=1)
        pairs = np.concatenate([pairs, drawn[usable]])
    return pairs[:count]
