"""Difference-of-Gaussians extrema, SIFT's detector (notes 4.2.4; Lowe 2004, sections 3 to 5)."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from imgu_ros.types import Image, as_image
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import corners_from_opencv

#: Blur of SIFT's first scale, px (Lowe 2004, section 3.3).
SIFT_SIGMA_PX = 1.6

#: OpenCV doubles the picture first, aligning pixel areas, and halves the coordinates, as if centres had been aligned.
_SHIFT_PX = 0.25
_SURPLUS = 2
_SIGMA_PER_SIZE = 0.5  # OpenCV's size is the diameter 2 sigma


def detect_dog(image: Image, max_count: int) -> Corners:
    """Find extrema of the difference of Gaussians on one picture, at every scale, with orientations.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : wanted number; up to twice as many are returned, for spreading to choose from

    Notes
    -----
    OpenCV doubles the picture first; on 1920x1080 it takes about 575 MB.
    """
    image = as_image(image, dtypes=(np.uint8,))
    found = cv2.SIFT.create(nfeatures=_SURPLUS * max_count).detect(image, None)
    corners = corners_from_opencv(found, _SIGMA_PER_SIZE, with_angle=True)
    return replace(corners, xy=corners.xy - _SHIFT_PX)
