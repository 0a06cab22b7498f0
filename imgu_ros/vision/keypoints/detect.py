# SPDX-License-Identifier: Apache-2.0
"""Keypoint detection on a pyramid, with any detector, spread over image and scales."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_flag, as_integer, shown_value
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Floats, Image
from imgu_ros.vision.keypoints.dog import SIFT_SIGMA_PX, detect_dog
from imgu_ros.vision.keypoints.fast import detect_fast
from imgu_ros.vision.keypoints.harris import detect_harris
from imgu_ros.vision.keypoints.keypoints import Corners, Keypoints
from imgu_ros.vision.keypoints.moravec import detect_moravec
from imgu_ros.vision.keypoints.mser import detect_mser
from imgu_ros.vision.keypoints.orb import detect_orb
from imgu_ros.vision.scale_space.pyramid import Pyramid


class Detector(Choice):
    """Keypoint detectors."""

    FAST = "fast"
    HARRIS = "harris"
    MORAVEC = "moravec"
    DOG = "dog"
    MSER = "mser"
    ORB = "orb"


def detect(
    pyramid: Pyramid,
    detector: Detector | str = Detector.ORB,
    max_count: int = 1000,
    even_scales: bool = False,
    fast_arc: int = 9,
) -> Keypoints:
    """Find keypoints on every level of a pyramid.

    Each level gets a share of `max_count` in proportion to its area, or the same share with `even_scales` (for a
    picture that will be looked for at any scale); within a level half are the strongest and the others are taken cell
    by cell, so that one busy corner of the picture does not get them all.

    Parameters
    ----------
    pyramid : of a (H, W) uint8 image
    detector : fast, harris, moravec, dog, mser or orb. `dog` and `mser` find every scale on level 0 by themselves.
    max_count : most keypoints, >= 1
    even_scales : the same share for every level
    fast_arc : contiguous pixels of the ring that make a corner, 9 to 12; for fast

    Returns
    -------
    Keypoints in full-resolution coordinates, by level, strongest first within a level; possibly none.

    Raises
    ------
    ShapeError
        If the pyramid is neither uint8 nor float32 in [0, 1], the detector is unknown, max_count is not positive, or
        fast_arc not 9 to 12.

    Examples
    --------
    >>> import numpy as np
    >>> from imgu_ros.vision.scale_space import build_pyramid
    >>> image = np.kron(np.random.default_rng(0).integers(0, 256, (12, 16)), np.ones((20, 20))).astype(np.uint8)
    >>> keypoints = detect(build_pyramid(image), "harris", max_count=100)
    >>> len(keypoints), int(keypoints.octave.max())
    (100, 2)
    """
    even_scales = as_flag(even_scales, "even_scales")
    if not isinstance(pyramid, Pyramid):
        raise ShapeError(f"pyramid: {shown_value(pyramid)}; need a Pyramid, which build_pyramid makes of an image")
    max_count = as_integer(max_count, "max_count")
    if max_count < 1:
        raise ShapeError(f"max_count: {max_count}; need at least 1")
    if pyramid.levels[0].image.dtype not in (np.uint8, np.float32):
        raise ShapeError(f"pyramid: data type {pyramid.levels[0].image.dtype}; need uint8, or float32 in [0, 1]")
    detector = Detector(detector)
    function = _DETECTORS[detector]
    if detector is Detector.FAST:
        function = partial(detect_fast, arc=fast_arc)
    levels = pyramid.levels[:1] if detector in OF_EVERY_SCALE else pyramid.levels
    areas = np.array([1 if even_scales else level.image.size for level in levels], np.float64)
    shares = np.floor(max_count * areas / areas.sum()).astype(int)
    shares[0] += max_count - shares.sum()
    found = []
    for index, (level, share) in enumerate(zip(levels, shares, strict=True)):
        if share == 0:
            continue
        corners = function(level.image, int(share))
        scale = corners.scale * level.scale
        octave = _octaves(pyramid, scale) if detector in OF_EVERY_SCALE else np.full(len(scale), index, np.int32)
        found.append(Keypoints(level.to_full(corners.xy), scale, corners.angle, corners.response, octave))
    return Keypoints(
        xy=np.concatenate([f.xy for f in found]),
        scale=np.concatenate([f.scale for f in found]),
        angle=np.concatenate([f.angle for f in found]),
        response=np.concatenate([f.response for f in found]),
        octave=np.concatenate([f.octave for f in found]),
    )


def _octaves(pyramid: Pyramid, scale: Floats) -> NDArray[np.int32]:
    """Return the coarsest level on which a structure of each scale is still as large as SIFT's first one."""
    steps = np.array([level.scale for level in pyramid.levels])
    return np.maximum(0, np.searchsorted(steps * SIFT_SIGMA_PX, scale * (1 + 1e-9)) - 1).astype(np.int32)


_DETECTORS: dict[Detector, Callable[[Image, int], Corners]] = {
    Detector.FAST: detect_fast,
    Detector.HARRIS: detect_harris,
    Detector.MORAVEC: detect_moravec,
    Detector.DOG: detect_dog,
    Detector.MSER: detect_mser,
    Detector.ORB: detect_orb,
}

#: These look for structures of every size on one picture.
OF_EVERY_SCALE = frozenset({Detector.DOG, Detector.MSER})
