"""Oriented BRIEF: 256 intensity comparisons in a rotated, smoothed patch (notes 5.4.1, 5.5; Rublee 2011)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.types import Image
from imgu_ros.vision.descriptors.described import Described
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import opencv_keypoints
from imgu_ros.vision.keypoints.orb import PATCH_PX


def describe_orb(image: Image, corners: Corners) -> Described:
    """Describe corners of one picture by 32 bytes each, rotated by their angles.

    Parameters
    ----------
    image : (H, W) uint8
    corners : those nearer to the border than half a patch are left out
    """
    height, width = image.shape
    margin = PATCH_PX // 2 + 1
    x, y = corners.xy[:, 0], corners.xy[:, 1]
    inside = np.flatnonzero((x >= margin) & (y >= margin) & (x < width - margin) & (y < height - margin))
    if not len(inside):
        return Described(inside, np.zeros((0, 32), np.uint8))
    keypoints = opencv_keypoints(
        corners.xy[inside], np.full(len(inside), float(PATCH_PX)), corners.angle[inside], corners.response[inside]
    )
    computer = cv2.ORB.create(nlevels=1, patchSize=PATCH_PX, edgeThreshold=margin)
    found, descriptors = computer.compute(image, keypoints)
    # OpenCV may drop keypoints of its own; class_id says which were kept.
    order = np.array([k.class_id for k in found], np.intp)
    return Described(inside[order], np.asarray(descriptors, np.uint8).reshape(-1, 32))
