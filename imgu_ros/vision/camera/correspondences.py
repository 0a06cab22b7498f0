# SPDX-License-Identifier: Apache-2.0
"""Points of space and their pictures, checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError, TooFewPoints
from imgu_ros.types import Floats, Points, as_points, as_rows


def as_correspondences(
    points: ArrayLike, pixels: ArrayLike, fewest: int, name: str = "points", largest: float = 1e100
) -> tuple[Floats, Points]:
    """Return `points`, (N, 3), and `pixels`, (N, 2), as float64 arrays when there are at least `fewest`.

    No number is to be larger than `largest`.

    Raises
    ------
    ShapeError
        If an array has another shape or is not finite, or a number is too large; it calls the points by `name`.
    TooFewPoints
        If there are fewer.
    """
    fewest = as_integer(fewest, "fewest")
    largest = as_number(largest, "largest")
    points, pixels = as_rows(points, 3, name), as_points(pixels, "pixels")
    if len(points) != len(pixels):
        raise ShapeError(f"pixels: {len(pixels)} points; need {len(points)}, one for each of {name}")
    if len(points) < max(fewest, 1):
        raise TooFewPoints(f"{name}, pixels: {len(points)} points; need at least {max(fewest, 1)}")
    found = max(float(np.abs(points).max()), float(np.abs(pixels).max()))
    if found > largest:
        raise ShapeError(f"{name}, pixels: up to {found:g}; need numbers of the size of a scene and a picture")
    return points, pixels
