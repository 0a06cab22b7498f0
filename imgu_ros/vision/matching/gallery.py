# SPDX-License-Identifier: Apache-2.0
"""A set of descriptors that others are matched to, prepared once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Indices, Points, as_points
from imgu_ros.vision.matching.hamming import BinaryRows, binary_rows
from imgu_ros.vision.matching.metrics import Metric, checked_rows, metric_of_rows, require_index
from imgu_ros.vision.matching.near import near_pairs
from imgu_ros.vision.matching.numbers import NumberRows, number_rows


@dataclass(frozen=True, slots=True, eq=False)
class Gallery:
    """Descriptors that others are matched to again and again.

    Attributes
    ----------
    descriptors : (M, D) uint8 or float32, as given
    metric : never auto
    prepared : what comparing with the metric needs of them
    places : where they lie, and which of them at the same place; or None
    """

    descriptors: Image
    metric: Metric
    prepared: BinaryRows | NumberRows
    places: Places | None

    def __len__(self) -> int:
        return len(self.descriptors)


def prepare_gallery(
    descriptors: Image, metric: Metric | str = Metric.AUTO, xy: Points | None = None, same_place_px: float = 8.0
) -> Gallery:
    """Prepare descriptors for `match_to_gallery`; the parameters are those of `match`.

    Parameters
    ----------
    descriptors : (M, D), uint8 (bits) or float32
    metric : see `Metric`
    xy : (M, 2) px where they lie, the `dst_xy` of `match`; None: they have no places
    same_place_px : up to how far apart, along x and along y, two are at the same place

    Raises
    ------
    ShapeError
        If rows, data type or metric do not fit each other, a row is not finite, or the places are not (M, 2).
    """
    same_place_px = as_number(same_place_px, "same_place_px")
    descriptors = checked_rows(descriptors, "dst")
    metric = metric_of_rows(descriptors, metric)
    places = None
    if xy is not None:
        xy = as_points(xy, "dst_xy")
        if len(xy) != len(descriptors):
            raise ShapeError(f"dst_xy: {len(xy)} points; need {len(descriptors)}, one for each row")
        places = find_places(xy, same_place_px)
    if not 0 <= same_place_px < np.inf:
        raise ShapeError(f"same_place_px: {same_place_px!r}; need a number >= 0")
    prepared = binary_rows(descriptors) if metric is Metric.HAMMING else number_rows(descriptors, metric)
    return Gallery(descriptors, metric, prepared, places)


#: Most pairs that are kept; points so dense are compared anew each time.
_MOST_PAIRS = 2**22


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """Pairs, (K,) indices each: the point that was asked for, and one at its place."""

    asked: Indices
    point: Indices


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """M points and who is near whom.

    Attributes
    ----------
    xy : (M, 2) px
    radius_px : up to how far apart, along x and along y, two points are at the same place
    near : points at the place of point 0, then of point 1, ...; None where they would be too many to keep
    start : (M + 1,) where the ones of each point start in `near`
    """

    xy: Points
    radius_px: float
    near: Indices | None
    start: Indices

    def at(self, points: Indices) -> Neighbours:
        """Return all points at the place of each of `points`, (N,), themselves included; `asked` is 0 to N - 1.

        Raises
        ------
        ShapeError
            If they are no (N,) indices of points.
        """
        require_index(points, points.size if isinstance(points, np.ndarray) else 0, len(self.xy))
        if self.near is None:
            apart = np.abs(self.xy[points, None] - self.xy).max(axis=2)
            return Neighbours(*np.nonzero(apart <= self.radius_px))
        count = self.start[points + 1] - self.start[points]
        first = np.cumsum(count) - count
        place = np.arange(count.sum()) + np.repeat(self.start[points] - first, count)
        return Neighbours(np.repeat(np.arange(len(points)), count), self.near[place])


def find_places(xy: Points, radius_px: float) -> Places:
    """Find for each of (M, 2) points those up to `radius_px` >= 0 away along x and along y.

    Parameters
    ----------
    xy : (M, 2) px
    radius_px : 0 or more

    Raises
    ------
    ShapeError
        If the points are not finite, or the radius is negative or not finite.

    Examples
    --------
    >>> import numpy as np
    >>> places = find_places([[0, 0], [9, 0], [3, -3]], radius_px=3.0)
    >>> places.at(np.array([2])).point.tolist()
    [0, 2]
    """
    radius_px = as_number(radius_px, "radius_px")
    xy = as_points(xy, "xy")
    pairs = near_pairs(xy, xy, radius_px, _MOST_PAIRS)
    if pairs is None:
        return Places(xy, radius_px, None, np.zeros(0, np.intp))
    return Places(xy, radius_px, pairs.b, np.searchsorted(pairs.a, np.arange(len(xy) + 1)))
