# SPDX-License-Identifier: Apache-2.0
"""ORB corners: FAST ranked by Harris, oriented by the intensity centroid (IU 5.5; Rublee 2011)."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_image
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import corners_from_opencv
from imgu_ros.vision.keypoints.spreading import spread

#: Side of the patch that ORB describes, px of the level.
PATCH_PX = 31
#: Structure scale of a FAST corner (a ring of radius 3 px) as a share of the patch.
SIGMA_PER_SIZE = 1.5 / PATCH_PX

#: Grey values: the second where the first gives too few corners.
_FAST_THRESHOLDS = (20, 10)
_SURPLUS = 2


def detect_orb(image: Image, max_count: int) -> Corners:
    """Detect oriented FAST corners in one image, at least PATCH_PX / 2 from its border.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : maximum number of corners, >= 1; spread over the image, out of the strongest 2 `max_count`

    Returns
    -------
    Corners, strongest first; scale is that of a FAST corner.

    Raises
    ------
    ShapeError
        If `image` is not such an image or `max_count` is not positive.

    Notes
    -----
    Rublee, Rabaud, Konolige & Bradski, "ORB: an efficient alternative to SIFT or SURF", 2011.
    Peak memory on 1920x1080: 10 MB.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(0).integers(0, 256, (120, 160), np.uint8)
    >>> corners = detect_orb(image, 50)
    >>> len(corners.xy), bool((corners.response[:-1] >= corners.response[1:]).all())
    (50, True)
    """
    max_count = as_integer(max_count, "max_count")
    image = as_image(image, dtypes=(np.uint8,))
    if max_count < 1:
        raise ShapeError(f"max_count: {max_count}; need at least 1")
    if min(image.shape) <= PATCH_PX:
        return corners_from_opencv([], SIGMA_PER_SIZE, with_angle=True)
    wanted = _SURPLUS * max_count
    for threshold in _FAST_THRESHOLDS:
        detector = cv2.ORB.create(
            nfeatures=wanted,
            nlevels=1,
            patchSize=PATCH_PX,
            edgeThreshold=PATCH_PX // 2 + 1,
            fastThreshold=threshold,
        )
        found = detector.detect(image, None)
        if len(found) >= wanted:
            break
    corners = corners_from_opencv(found, SIGMA_PER_SIZE, with_angle=True)
    return corners.chosen(spread(corners.xy, corners.response, (image.shape[1], image.shape[0]), max_count))
