# SPDX-License-Identifier: Apache-2.0
"""Markers of one family in an image, by OpenCV's aruco module."""

from __future__ import annotations

import math
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from imgu_ros.arguments import as_integer, as_sequence, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Points, as_image
from imgu_ros.vision.markers.dictionaries import (
    has_new_interface,
    is_turned,
    marker_dictionary,
    require_marker_family,
)

#: An image is enlarged to about this length of its longer side, in a first pass and in further ones. Up to OpenCV 4.6
#: small markers are found as they are, and fewer in enlarged images.
_SIDES_PX, _OLD_SIDES_PX = (1280, 1920, 2560, 640), (640, 1280, 1920, 2560)
#: Sides of the windows of the adaptive threshold, px: about as wide as a marker's cells and wider.
_WINDOWS = (5, 29, 12)
#: Smallest perimeter of a marker, px, as it is seen.
_LEAST_PERIMETER_PX = 28.0
#: Sides of a contour may deviate from straight ones by this share of its perimeter.
_STRAIGHTNESS = 0.03
#: Outlines nearer to each other than this share of their perimeter are one: those of a line's two sides.
_APART = 0.01
#: Two markers of one id whose centres are nearer than this share of their side are one.
_SAME_PLACE = 0.5
#: An image is enlarged at most so often.
_MOST_ZOOM = 16
#: Share of the correctable cells that are corrected: what is found is compared with the image afterwards.
_CORRECTED = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class FoundMarker:
    """A marker in an image.

    Attributes
    ----------
    number : its id
    corners : (4, 2) px, outer corners of the black square: top left, top right, bottom right, bottom left, upright as
        `marker_cells` has it
    """

    number: int
    corners: Points

    @property
    def area(self) -> float:
        """Area of the black square, px."""
        return abs(float(cv2.contourArea(self.corners.astype(np.float32))))


def zooms_for(shape: tuple[int, int]) -> tuple[int, ...]:
    """Return by how much an image is to be enlarged to find its markers: the likeliest first.

    Parameters
    ----------
    shape : height and width, px

    Raises
    ------
    ShapeError
        If it is no pair of whole numbers above 0.
    """
    sides = [as_integer(side, "shape") for side in as_sequence(shape, "shape")]
    if len(sides) != 2:
        raise ShapeError(f"shape: {len(sides)} numbers; need height and width")
    height, width = sides
    if min(height, width) < 1:
        raise ShapeError(f"shape: {height} x {width}; need at least 1 x 1 px")
    wanted = _SIDES_PX if has_new_interface() else _OLD_SIDES_PX
    return tuple(dict.fromkeys(min(max(round(side / max(height, width)), 1), _MOST_ZOOM) for side in wanted))


class MarkerFinder:
    """Finds markers of one family.

    Parameters
    ----------
    family : a key of `MARKER_FAMILIES`

    Raises
    ------
    ShapeError
        If markers of the family cannot be found.
    """

    def __init__(self, family: str) -> None:
        require_marker_family(family)
        self.family = family
        self._dictionary = marker_dictionary(family)

    def find(self, image: Image, zoom: int = 1, only: AbstractSet[int] | None = None) -> list[FoundMarker]:
        """Return the markers in an image, in the order of their ids and places.

        Parameters
        ----------
        image : (H, W) uint8
        zoom : the image is enlarged so often before: smaller markers are found
        only : ids that are wanted, a set; None: all

        Raises
        ------
        ShapeError
            If the image is no such array, or `zoom` is not 1 to 16.
        """
        image, zoom = as_image(image, "image", dtypes=(np.uint8,)), as_integer(zoom, "zoom")
        if not 1 <= zoom <= _MOST_ZOOM:
            raise ShapeError(f"zoom: {zoom}; need 1 to {_MOST_ZOOM}")
        if only is not None:
            require_type(only, AbstractSet, "only")
        if zoom > 1:
            image = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
        corners, numbers = _detected(image, self._dictionary, zoom)
        found = []
        for quad, number in zip(corners, numbers, strict=True):
            if only is None or number in only:
                at = (np.asarray(quad, np.float64).reshape(4, 2) + 0.5) / zoom - 0.5
                found.append(FoundMarker(number, np.roll(at, 2, axis=0) if is_turned(self.family) else at))
        return distinct_markers(found)


def distinct_markers(found: Sequence[FoundMarker]) -> list[FoundMarker]:
    """Return markers without those at the place of a larger one with the same id, in the order of ids and places.

    Parameters
    ----------
    found : markers, some of them several times

    Raises
    ------
    ShapeError
        If they are something else.

    Examples
    --------
    The two sides of a line:

    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> twice = [FoundMarker(7, 80 * square + 10), FoundMarker(7, 100 * square), FoundMarker(8, 100 * square)]
    >>> [(marker.number, round(marker.area)) for marker in distinct_markers(twice)]
    [(7, 10000), (8, 10000)]
    """
    kept: list[FoundMarker] = []
    for each in as_sequence(found, "found"):
        require_type(each, FoundMarker, "found")
    for each in sorted(found, key=lambda each: (-each.area, each.number, *each.corners[0].tolist())):
        centre = each.corners.mean(axis=0)
        if not any(
            other.number == each.number
            and np.hypot(*(other.corners.mean(axis=0) - centre)) < _SAME_PLACE * math.sqrt(other.area)
            for other in kept
        ):
            kept.append(each)
    return sorted(kept, key=lambda each: (each.number, *each.corners[0].tolist()))


def _detected(image: Image, dictionary: Any, zoom: int) -> tuple[list[Any], list[int]]:
    """Return corners and ids, by whichever interface the aruco module has."""
    aruco: Any = cv2.aruco
    is_new = has_new_interface()
    parameters = aruco.DetectorParameters() if is_new else aruco.DetectorParameters_create()
    low, high, step = _WINDOWS
    parameters.adaptiveThreshWinSizeMin = low
    parameters.adaptiveThreshWinSizeMax = high
    parameters.adaptiveThreshWinSizeStep = step
    parameters.minMarkerPerimeterRate = zoom * _LEAST_PERIMETER_PX / max(image.shape)
    parameters.polygonalApproxAccuracyRate = _STRAIGHTNESS
    parameters.errorCorrectionRate = _CORRECTED
    parameters.minDistanceToBorder = 1
    if not is_new:
        # The outline of the paper is near that of a marker, and must not hide it, as it does up to OpenCV 4.6.
        parameters.minMarkerDistanceRate = _APART
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_CONTOUR
    if is_new:
        corners, numbers, _ = aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    else:
        corners, numbers, _ = aruco.detectMarkers(image, dictionary, parameters=parameters)
    return list(corners), [] if numbers is None else [int(number) for number in np.ravel(numbers)]
