# SPDX-License-Identifier: Apache-2.0
"""Keypoint detection on a pyramid, with any detector, spread over image and scales."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_flag, as_integer, shown_value
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Indices
from imgu_ros.vision.keypoints.dog import SIFT_SIGMA_PX
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.methods import DETECTORS, DetectorMethod, method_named
from imgu_ros.vision.scale_space.pyramid import Pyramid


def detect(
    pyramid: Pyramid,
    detector: DetectorMethod | str = "orb",
    max_count: int = 1000,
    even_scales: bool = False,
    parameters: Any = None,
) -> Keypoints:
    """Detect keypoints on every level of a pyramid.

    Each level gets a share of `max_count` in proportion to its area, or the same share with `even_scales` (for an
    image that will be searched for at any scale); within a level half are the strongest and the others are taken cell
    by cell, so that one busy corner of the image does not get them all.

    Parameters
    ----------
    pyramid : of a (H, W) uint8 image
    detector : fast, harris, moravec, dog, mser, orb, or the row of another one (see `imgu_ros.vision.methods`). `dog`
        and `mser` find every scale on level 0 by themselves.
    max_count : largest number of keypoints, >= 1
    even_scales : the same share for every level
    parameters : the detector's own, such as `FastParameters(arc=12)`; None: its defaults

    Returns
    -------
    Keypoints in full-resolution coordinates, by level, strongest first within a level; possibly none.

    Raises
    ------
    ShapeError
        If the pyramid is neither uint8 nor float32 in [0, 1], the detector is unknown, max_count is not positive, or
        one of the detector's parameters is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.scale_space import build_pyramid
    >>> image = np.kron(np.random.default_rng(0).integers(0, 256, (12, 16)), np.ones((20, 20))).astype(np.uint8)
    >>> keypoints = detect(build_pyramid(image), "harris", max_count=100)
    >>> len(keypoints), int(keypoints.octave.max())
    (100, 2)
    """
    row = detector if isinstance(detector, DetectorMethod) else method_named(DETECTORS, detector, "detector")
    shares = level_shares(pyramid, max_count, even_scales, row.finds_every_scale)
    function = row.made(parameters)
    found = []
    for index, (level, share) in enumerate(zip(pyramid.levels, shares.tolist(), strict=True)):
        if share == 0:
            continue
        corners = function(level.image, share)
        scale = corners.scale * level.scale
        octave = _octaves(pyramid, scale) if row.finds_every_scale else np.full(len(scale), index, np.int32)
        found.append(Keypoints(level.to_full(corners.xy), scale, corners.angle, corners.response, octave))
    return Keypoints(
        xy=np.concatenate([f.xy for f in found]),
        scale=np.concatenate([f.scale for f in found]),
        angle=np.concatenate([f.angle for f in found]),
        response=np.concatenate([f.response for f in found]),
        octave=np.concatenate([f.octave for f in found]),
    )


def level_shares(pyramid: Pyramid, max_count: int, even_scales: bool = False, first_alone: bool = False) -> Indices:
    """Return how many keypoints each level of a pyramid may have, (L,); their sum is `max_count`.

    Parameters
    ----------
    pyramid : of a (H, W) uint8 image
    max_count : >= 1
    even_scales : the same share for every level; False: in proportion to the area
    first_alone : all of them for level 0

    Raises
    ------
    ShapeError
        If the pyramid is neither uint8 nor float32 in [0, 1], or max_count is not positive.
    """
    even_scales, first_alone = as_flag(even_scales, "even_scales"), as_flag(first_alone, "first_alone")
    if not isinstance(pyramid, Pyramid):
        raise ShapeError(f"pyramid: {shown_value(pyramid)}; need a Pyramid, which build_pyramid makes of an image")
    max_count = as_integer(max_count, "max_count")
    if max_count < 1:
        raise ShapeError(f"max_count: {max_count}; need at least 1")
    if pyramid.levels[0].image.dtype not in (np.uint8, np.float32):
        raise ShapeError(f"pyramid: data type {pyramid.levels[0].image.dtype}; need uint8, or float32 in [0, 1]")
    areas = np.array([1 if even_scales else level.image.size for level in pyramid.levels], np.float64)
    if first_alone:
        areas[1:] = 0
    shares = np.floor(max_count * areas / areas.sum()).astype(np.intp)
    shares[0] += max_count - shares.sum()
    return shares


def _octaves(pyramid: Pyramid, scale: Floats) -> NDArray[np.int32]:
    """Return the coarsest level on which a structure of each scale is still as large as SIFT's first one."""
    steps = np.array([level.scale for level in pyramid.levels])
    return np.maximum(0, np.searchsorted(steps * SIFT_SIGMA_PX, scale * (1 + 1e-9)) - 1).astype(np.int32)
