# SPDX-License-Identifier: Apache-2.0
"""FAST: corners by 9 to 12 contiguous of 16 ring pixels (IU 4.2.3; Rosten & Drummond 2006)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_integer, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Points, as_image
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.keypoints.opencv import positions
from imgu_ros.vision.keypoints.orientation import centroid_orientation
from imgu_ros.vision.keypoints.spreading import spread

ARCS = (9, 10, 11, 12)
THRESHOLD = 10

_RING_SIGMA_PX = 1.5  # half the ring's radius
_RING = np.array(
    [(0, -3), (1, -3), (2, -2), (3, -1), (3, 0), (3, 1), (2, 2), (1, 3),
     (0, 3), (-1, 3), (-2, 2), (-3, 1), (-3, 0), (-3, -1), (-2, -2), (-1, -3)]
)  # fmt: skip
_COMPASS = slice(0, 16, 4)
_EIGHT_NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)


@dataclass(frozen=True, slots=True)
class FastParameters:
    """Parameters of `detect_fast`: see there."""

    arc: int = 9
    threshold: int = THRESHOLD


def fast_detector(parameters: FastParameters) -> Callable[[Image, int], Corners]:
    """Return `detect_fast` with `parameters`."""
    require_type(parameters, FastParameters, "parameters")
    return partial(detect_fast, arc=parameters.arc, threshold=parameters.threshold)


def detect_fast(image: Image, max_count: int, arc: int = 9, threshold: int = THRESHOLD) -> Corners:
    """Detect FAST corners in one image, with non-maximum suppression, oriented by the intensity centroid.

    A pixel is a corner when `arc` contiguous of the 16 pixels on the ring of radius 3 are all brighter than it by
    more than `threshold`, or all darker. Its response is the largest threshold with which it still is one; a corner
    stays when no neighbour's response is as large. The survivors are spread over the image.

    Parameters
    ----------
    image : (H, W) uint8
    max_count : maximum number of corners, >= 1
    arc : 9 to 12. 9 repeats best (Rosten 2010); 12 is the original, which wants sharper corners.
    threshold : grey values, 1 to 254

    Returns
    -------
    Corners at whole pixels, strongest first; scale is half the ring's radius.

    Raises
    ------
    ShapeError
        If `image` is not such an image, or a number lies outside its range.

    Notes
    -----
    Rosten & Drummond, "Machine learning for high-speed corner detection", 2006; Rosten, Porter & Drummond 2010. OpenCV
    finds arcs of 9 alone. Every longer arc contains one, so that its corners are the candidates for the others: of
    those, the high-speed test on the four compass points rejects most before whole rings are looked at.
    Peak memory on 1920x1080: 20 MB.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.full((40, 40), 50, np.uint8)
    >>> image[20, 20] = 200
    >>> corners = detect_fast(image, 10, arc=12)
    >>> corners.xy.tolist(), corners.response.tolist()
    ([[20.0, 20.0]], [149.0])
    """
    max_count = as_integer(max_count, "max_count")
    arc = as_integer(arc, "arc")
    threshold = as_integer(threshold, "threshold")
    image = as_image(image, dtypes=(np.uint8,))
    if arc not in ARCS:
        raise ShapeError(f"arc: {arc}; need 9, 10, 11 or 12")
    if not 1 <= threshold <= 254:
        raise ShapeError(f"threshold: {threshold}; need 1 to 254")
    xy, response = _nine(image, threshold) if arc == ARCS[0] else _longer(image, threshold, arc)
    kept = spread(xy, response, (image.shape[1], image.shape[0]), max_count)
    xy = xy[kept]
    return Corners(xy, np.full(len(xy), _RING_SIGMA_PX), centroid_orientation(image, xy), response[kept])


def _nine(image: Image, threshold: int) -> tuple[Points, Floats]:
    """Return OpenCV's corners and their responses."""
    found = cv2.FastFeatureDetector.create(threshold, True).detect(image, None)
    return positions(found), np.fromiter(map(attrgetter("response"), found), np.float64, len(found))


def _longer(image: Image, threshold: int, arc: int) -> tuple[Points, Floats]:
    """Return the corners of an arc of 10 to 12 and their responses."""
    at = positions(cv2.FastFeatureDetector.create(threshold, False).detect(image, None)).astype(np.intp)
    values = image.astype(np.int16)
    center = values[at[:, 1], at[:, 0]]

    def lighter(ring: NDArray[np.intp]) -> NDArray[np.int16]:
        """How much lighter these pixels of the ring are, one row for each."""
        return np.stack([values[at[:, 1] + dy, at[:, 0] + dx] - center for dx, dy in ring])

    # The high-speed test: a quarter of the ring is a compass point, and an arc of 12 covers three, of 9 to 11 two.
    compass = lighter(_RING[_COMPASS])
    needed = arc // 4
    passed = (np.count_nonzero(compass > threshold, axis=0) >= needed) | (
        np.count_nonzero(compass < -threshold, axis=0) >= needed
    )
    at, center = at[passed], center[passed]
    ring = lighter(_RING)
    response = np.maximum(_least_along(ring, arc).max(axis=0), _least_along(-ring, arc).max(axis=0)) - 1
    corner = response >= threshold
    at, response = at[corner], response[corner]
    # A map of the responses, with a margin, so that every corner sees its eight neighbours.
    height, width = image.shape
    scores = np.zeros((height + 2, width + 2), np.uint8)
    scores[at[:, 1] + 1, at[:, 0] + 1] = response
    alone = scores > cv2.dilate(scores, _EIGHT_NEIGHBOURS)
    kept = alone[at[:, 1] + 1, at[:, 0] + 1]
    return at[kept].astype(np.float64), response[kept].astype(np.float64)


def _least_along(ring: NDArray[np.int16], arc: int) -> NDArray[np.int16]:
    """Return the least of every `arc` successive rows of 16, going round: (16, N)."""
    least = ring
    length = 1
    while length < arc:
        step = min(length, arc - length)
        least = np.minimum(least, np.roll(least, -step, axis=0))
        length += step
    return least
