"""FAST: a corner has 9 contiguous of 16 ring pixels brighter or darker than the centre (notes 4.2.3; Rosten 2006)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.types import Image, as_image
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import corners_from_opencv
from imgu_ros.vision.keypoints.orientation import centroid_orientation

_THRESHOLD = 10
_SURPLUS = 3
_RING_SIGMA = 1.5 / 7  # the ring's radius is 3 px; OpenCV gives it the size 7


def detect_fast(image: Image, max_count: int) -> Corners:
    """Find FAST-9 corners on one picture, with non-maximum suppression, oriented by the intensity centroid.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : wanted number; up to three times as many are returned, for spreading to choose from
    """
    image = as_image(image, dtypes=(np.uint8,))
    found = cv2.FastFeatureDetector.create(_THRESHOLD, True).detect(image, None)
    strongest = sorted(found, key=lambda k: -k.response)[: _SURPLUS * max_count]
    corners = corners_from_opencv(strongest, _RING_SIGMA, with_angle=False)
    angle = centroid_orientation(image, corners.xy)
    return Corners(corners.xy, corners.scale, angle, corners.response)
