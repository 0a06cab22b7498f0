"""Keypoint detection on a pyramid, with any detector, spread over image and scales."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Floats, Image
from imgu_ros.vision.keypoints.dog import SIFT_SIGMA_PX, detect_dog
from imgu_ros.vision.keypoints.fast import detect_fast
from imgu_ros.vision.keypoints.harris import detect_harris
from imgu_ros.vision.keypoints.keypoints import Corners, Keypoints
from imgu_ros.vision.keypoints.orb import detect_orb
from imgu_ros.vision.keypoints.spreading import spread
from imgu_ros.vision.scale_space.pyramid import Pyramid


class Detector(Choice):
    """Keypoint detectors."""

    FAST = "fast"
    HARRIS = "harris"
    DOG = "dog"
    ORB = "orb"


def detect(
    pyramid: Pyramid, detector: Detector | str = Detector.ORB, max_count: int = 1000, even_scales: bool = False
) -> Keypoints:
    """Find keypoints on every level of a pyramid.

    Each level gets a share of `max_count` in proportion to its area, or the same share with `even_scales` (for a
    picture that will be looked for at any scale); within a level the strongest are taken cell
    by cell, so that one busy corner of the picture does not get them all.

    Parameters
    ----------
    pyramid : of a (H, W) uint8 image
    detector : fast, harris, dog or orb. `dog` builds its own scale space from level 0.
    max_count : most keypoints, >= 1
    even_scales : the same share for every level

    Returns
    -------
    Keypoints in full-resolution coordinates, by level, strongest first within a level; possibly none.

    Raises
    ------
    ShapeError
        If the pyramid is not uint8, the detector is unknown or max_count is not positive.
    """
    if max_count < 1:
        raise ShapeError(f"max_count: {max_count}; need at least 1")
    if pyramid.levels[0].image.dtype != np.uint8:
        raise ShapeError(f"pyramid: data type {pyramid.levels[0].image.dtype}; need uint8")
    detector = Detector(detector)
    function = _DETECTORS[detector]
    levels = pyramid.levels[:1] if detector is Detector.DOG else pyramid.levels
    areas = np.array([1 if even_scales else level.image.size for level in levels], np.float64)
    shares = np.floor(max_count * areas / areas.sum()).astype(int)
    shares[0] += max_count - shares.sum()
    found = []
    for index, (level, share) in enumerate(zip(levels, shares, strict=True)):
        if share == 0:
            continue
        corners = function(level.image, int(share))
        kept = spread(corners.xy, corners.response, (level.image.shape[1], level.image.shape[0]), int(share))
        found.append(
            Keypoints(
                xy=level.to_full(corners.xy[kept]),
                scale=corners.scale[kept] * level.scale,
                angle=corners.angle[kept],
                response=corners.response[kept],
                octave=_octaves(pyramid, corners.scale[kept] * level.scale)
                if detector is Detector.DOG
                else np.full(len(kept), index, np.int32),
            )
        )
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
    Detector.DOG: detect_dog,
    Detector.ORB: detect_orb,
}
