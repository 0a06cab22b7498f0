# SPDX-License-Identifier: Apache-2.0
"""Oriented BRIEF: 256 intensity comparisons in a rotated, smoothed patch (IU 5.4.1, 5.5; Rublee 2011)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.types import Image, as_image
from imgu_ros.vision.descriptors.described import Described, checked_corners
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import opencv_keypoints
from imgu_ros.vision.keypoints.orb import PATCH_PX


def describe_orb(image: Image, corners: Corners) -> Described:
    """Describe corners of one image by 32 bytes each, rotated by their angles.

    Parameters
    ----------
    image : (H, W) uint8
    corners : those nearer to the border than half a patch are left out

    Raises
    ------
    ShapeError
        If the image or a corner is not of that kind.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(0).integers(0, 256, (60, 60), np.uint8)
    >>> one, xy = np.ones(2), np.array([[30.0, 30.0], [5.0, 30.0]])
    >>> describe_orb(image, Corners(xy, one, 0 * one, one)).index.tolist()
    [0]
    """
    image = as_image(image, dtypes=(np.uint8,))
    corners = checked_corners(corners)
    height, width = image.shape
    margin = PATCH_PX // 2 + 1
    x, y = corners.xy[:, 0], corners.xy[:, 1]
    # OpenCV drops what rounds to the first pixel behind the margin, and describes nothing by None.
    right, lower = width - margin, height - margin
    inside = np.flatnonzero((x >= margin) & (y >= margin) & (np.rint(x) < right) & (np.rint(y) < lower))
    if not len(inside):
        return Described(inside, np.zeros((0, 32), np.uint8))
    keypoints = opencv_keypoints(
        corners.xy[inside], np.full(len(inside), float(PATCH_PX)), corners.angle[inside], corners.response[inside]
    )
    computer = cv2.ORB.create(nlevels=1, patchSize=PATCH_PX, edgeThreshold=margin)
    found, descriptors = computer.compute(image, keypoints)
    # class_id says which row describes which corner.
    order = np.array([k.class_id for k in found], np.intp)
    return Described(inside[order], np.asarray(descriptors, np.uint8).reshape(-1, 32))
