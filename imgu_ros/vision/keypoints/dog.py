# SPDX-License-Identifier: Apache-2.0
"""Difference-of-Gaussians extrema, SIFT's detector (IU 4.2.4; Lowe 2004, sections 3 to 5)."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, as_image
from imgu_ros.vision.keypoints.dog_centres import refined_centres
from imgu_ros.vision.keypoints.dominant import dominant_orientations
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import corners_from_opencv
from imgu_ros.vision.keypoints.spreading import spread

#: Blur of SIFT's first scale, px (Lowe 2004, section 3.3).
SIFT_SIGMA_PX = 1.6

#: OpenCV doubles the image first, aligning pixel areas, and halves the coordinates, as if centres had been aligned.
_SHIFT_PX = 0.25
#: Of extrema of every size most are small and weak: more of the strongest than other detectors keep are found again.
_STRONGEST_SHARE = 2 / 3
_REFINED_FROM_PX = 3.0
_SIGMA_PER_SIZE = 0.5  # OpenCV's size is the diameter 2 sigma


def detect_dog(image: Image, max_count: int) -> Corners:
    """Find extrema of the difference of Gaussians on one image, at every scale, with orientations.

    Extrema among 26 neighbours in space and scale, interpolated by a quadratic, without those of low contrast or on
    edges; a keypoint for every strong peak of the histogram of gradient directions; spread over the image.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : most keypoints, >= 1

    Returns
    -------
    Corners, strongest first; response is the contrast times the root of the scale, as the noise of a pixel counts less
    the larger the structure; scale is the blur of the lower of the two Gaussians whose difference is extremal. A
    Gaussian blob of sigma s, as the image shows it, answers at s^2 = 2^(1/3) scale^2 + 1/4.

    Raises
    ------
    ShapeError
        If `image` is not such an image or `max_count` is not positive.

    Notes
    -----
    Lowe, "Distinctive image features from scale-invariant keypoints", 2004, sections 3 to 5, in OpenCV's version.
    Scales are OpenCV's, and places of small structures. Larger ones are moved by `refined_centres`, as OpenCV's are off
    by 0.7 % of their scale (rms). Directions are `dominant_orientations`, as OpenCV's, about the nearest pixel, are
    wrong by 1 to 6 degrees (rms). Blobs of any size are found to 0.1 px, to 3 % in scale and to 1.2 degrees; of
    isolated ones about one in twelve is missed.
    OpenCV doubles the image first: peak memory on 1920x1080: 465 to 575 MB.
    """
    max_count = as_integer(max_count, "max_count")
    image = as_image(image, dtypes=(np.uint8,))
    if max_count < 1:
        raise ShapeError(f"max_count: {max_count}; need at least 1")
    found = corners_from_opencv(cv2.SIFT.create().detect(image, None), _SIGMA_PER_SIZE, with_angle=False)
    # OpenCV repeats a place for each of the directions that it sees there.
    _, first = np.unique(np.column_stack((found.xy, found.scale)), axis=0, return_index=True)
    size = (image.shape[1], image.shape[0])
    places = found.chosen(first)
    places = replace(places, xy=places.xy - _SHIFT_PX, response=places.response * np.sqrt(places.scale))
    # Only as many places as are wanted get directions, of which there may then be too many.
    places = places.chosen(spread(places.xy, places.response, size, max_count, _STRONGEST_SHARE))
    large = places.scale >= _REFINED_FROM_PX
    xy = places.xy.copy()
    xy[large] = refined_centres(image, xy[large], places.scale[large])
    places = replace(places, xy=xy)
    directions = dominant_orientations(image, places.xy, places.scale)
    corners = replace(places.chosen(directions.index), angle=directions.angle)
    return corners.chosen(spread(corners.xy, corners.response, size, max_count, _STRONGEST_SHARE))
