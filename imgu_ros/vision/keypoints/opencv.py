# SPDX-License-Identifier: Apache-2.0
"""Between `Corners` and OpenCV's list of cv2.KeyPoint."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter

import cv2
import numpy as np

from imgu_ros.arguments import as_flag, as_number, as_sequence, shown_value
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Points, as_matrix, as_points
from imgu_ros.vision.keypoints.keypoints import Corners, Keypoints

_LARGEST_PX = 1e6
_LARGEST_NUMBER = 1e30


def corners_from_opencv(found: Sequence[cv2.KeyPoint], sigma_per_size: float, with_angle: bool) -> Corners:
    """Convert cv2's keypoints.

    Parameters
    ----------
    found : cv2.KeyPoint objects
    sigma_per_size : sigma of the structure as a share of the detector's `size`
    with_angle : whether the detector's `angle` (degrees, 0 to 360) means anything

    Raises
    ------
    ShapeError
        If `sigma_per_size` is not a positive number.
    """
    sigma_per_size = as_number(sigma_per_size, "sigma_per_size")
    if not 0 < sigma_per_size < _LARGEST_PX:
        raise ShapeError(f"sigma_per_size: {sigma_per_size}; need above 0, below {_LARGEST_PX:g}")
    with_angle = as_flag(with_angle, "with_angle")
    found = _checked(found)
    count = len(found)
    size, angle, response = (
        np.fromiter(map(attrgetter(name), found), np.float64, count) for name in ("size", "angle", "response")
    )
    angle = np.radians(angle) if with_angle else np.zeros(count)
    return Corners(
        xy=positions(found),
        scale=size * sigma_per_size,
        angle=(angle + math.pi) % (2 * math.pi) - math.pi,
        response=response,
    )


def positions(found: Sequence[cv2.KeyPoint]) -> Points:
    """Return the positions of cv2's keypoints `found`, (N, 2) px."""
    found = _checked(found)
    return np.array(cv2.KeyPoint.convert(found), np.float64).reshape(-1, 2) if len(found) else np.zeros((0, 2))


def require_describable(corners: Corners) -> None:
    """Raise ShapeError when one of the `corners` cannot be handed to OpenCV: absurd ones make it write astray."""
    if not isinstance(corners, Corners | Keypoints):
        raise ShapeError(
            f"corners: {shown_value(corners)}; need Corners (corners_from_opencv makes them of cv2.KeyPoint)"
        )
    xy = as_points(corners.xy, "corners.xy")
    scale, _, _ = (as_matrix(getattr(corners, n), (len(xy),), f"corners.{n}") for n in ("scale", "angle", "response"))
    if len(xy) and not np.abs(xy).max() < _LARGEST_PX:
        raise ShapeError(f"corners.xy: up to {np.abs(xy).max():g}; need less than {_LARGEST_PX:g} px")
    if len(xy) and not 0 < scale.min() <= scale.max() < _LARGEST_PX:
        raise ShapeError(f"corners.scale: {scale.min():g} to {scale.max():g}; need above 0, below {_LARGEST_PX:g} px")


def opencv_keypoints(xy: Points, size: Floats, angle: Floats, response: Floats) -> list[cv2.KeyPoint]:
    """Make cv2's keypoints on octave 0.

    Parameters
    ----------
    xy : (N, 2) px
    size : (N,) px, diameter
    angle : (N,) rad
    response : (N,)

    Returns
    -------
    A list, row i with class_id i, which OpenCV hands through.

    Raises
    ------
    ShapeError
        If the arrays do not fit each other or hold what is not finite.
    """
    xy = as_points(xy, "xy")
    size, angle, response = (
        as_matrix(values, (len(xy),), name)
        for values, name in ((size, "size"), (angle, "angle"), (response, "response"))
    )
    if len(xy) and max(np.abs(values).max() for values in (xy, size, angle, response)) > _LARGEST_NUMBER:
        raise ShapeError(
            f"xy, size, angle, response: need numbers up to {_LARGEST_NUMBER:g}, which is what OpenCV holds"
        )
    count = len(xy)
    # OpenCV's constructor takes 0.3 us of plain numbers, and five times as long of numpy's.
    columns = (xy[:, 0], xy[:, 1], size, np.degrees(angle) % 360, response)
    return list(map(cv2.KeyPoint, *(column.tolist() for column in columns), [0] * count, range(count)))


def _checked(found: Sequence[cv2.KeyPoint]) -> Sequence[cv2.KeyPoint]:
    found = as_sequence(found, "found")
    others = set(map(type, found)) - {cv2.KeyPoint}
    if others:
        raise ShapeError(f"found: {', '.join(sorted(kind.__name__ for kind in others))}; need cv2.KeyPoint objects")
    return found
