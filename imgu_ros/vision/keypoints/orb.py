"""ORB corners: FAST ranked by Harris, oriented by the intensity centroid (notes 5.5; Rublee 2011)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.types import Image, as_image
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import corners_from_opencv

#: Side of the patch that ORB describes, px of the level.
PATCH_PX = 31
#: Structure scale of a FAST corner (a ring of radius 3 px) as a share of the patch.
SIGMA_PER_SIZE = 1.5 / PATCH_PX

_FAST_THRESHOLD = 10
_SURPLUS = 2


def detect_orb(image: Image, max_count: int) -> Corners:
    """Find oriented FAST corners on one picture, at least PATCH_PX / 2 from its border.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : wanted number; up to twice as many are returned, for spreading to choose from
    """
    image = as_image(image, dtypes=(np.uint8,))
    if min(image.shape) <= PATCH_PX:
        return corners_from_opencv([], SIGMA_PER_SIZE, with_angle=True)
    detector = cv2.ORB.create(
        nfeatures=_SURPLUS * max_count,
        nlevels=1,
        patchSize=PATCH_PX,
        edgeThreshold=PATCH_PX // 2 + 1,
        fastThreshold=_FAST_THRESHOLD,
    )
    return corners_from_opencv(detector.detect(image, None), SIGMA_PER_SIZE, with_angle=True)
