# SPDX-License-Identifier: Apache-2.0
"""SIFT and RootSIFT: 4x4 histograms of 8 gradient directions (IU 5.2.1; Lowe 2004, section 6; Arandjelovic 2012)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_image
from imgu_ros.vision.descriptors.described import Described, checked_corners
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import opencv_keypoints

_SMALLEST_SCALE_PX = 0.5
_SMALLEST_DIAGONAL_PX = 5.0


def describe_sift(image: Image, corners: Corners) -> Described:
    """Describe corners of one image by 128 numbers each, 0 to 255, of Euclidean norm about 512.

    Parameters
    ----------
    image : (H, W) uint8
    corners : with scale (the histograms are 3 sigma wide; at least 0.5 px) and angle

    Raises
    ------
    ShapeError
        If a corner's scale is below half a pixel. On an image too small for any window nothing is described.

    Examples
    --------
    A step has one gradient direction: after clipping few of the 128 bins hold all.

    >>> import numpy as np
    >>> image = np.repeat(np.array([[40, 200]], np.uint8), 40, axis=1).repeat(80, axis=0)
    >>> one = np.ones(1)
    >>> row = describe_sift(image, Corners(np.array([[39.5, 40.0]]), 2 * one, 0 * one, one)).descriptors
    >>> row.shape, int((row > 100).sum())
    ((1, 128), 8)
    """
    image = as_image(image, dtypes=(np.uint8,))
    corners = checked_corners(corners)
    # OpenCV 4.6 writes outside its memory where the window's radius, 10.6 sigma or the diagonal, is below 5 px.
    if len(corners.xy) and corners.scale.min() < _SMALLEST_SCALE_PX:
        raise ShapeError(f"corners.scale: {corners.scale.min():g}; need at least {_SMALLEST_SCALE_PX} px for SIFT")
    if not len(corners.xy) or np.hypot(*image.shape) < _SMALLEST_DIAGONAL_PX:
        return Described(np.zeros(0, np.intp), np.zeros((0, 128), np.float32))
    keypoints = opencv_keypoints(corners.xy, 2 * corners.scale, corners.angle, corners.response)
    found, descriptors = cv2.SIFT.create().compute(image, keypoints)
    order = np.array([k.class_id for k in found], np.intp)
    return Described(order, np.asarray(descriptors, np.float32).reshape(-1, 128))


def describe_rootsift(image: Image, corners: Corners) -> Described:
    """Describe as `describe_sift`, then take the square root of each L1-normalised row: unit Euclidean norm.

    Euclidean distances between such rows are Hellinger distances between the histograms. `image` and `corners` are
    those of `describe_sift`.
    """
    described = describe_sift(image, corners)
    total = described.descriptors.sum(axis=1, keepdims=True)
    return Described(described.index, np.sqrt(described.descriptors / np.where(total > 0, total, 1.0)))
