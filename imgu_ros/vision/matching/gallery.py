# SPDX-License-Identifier: Apache-2.0
"""A set of descriptors that others are matched to, prepared once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Points, as_points
from imgu_ros.vision.matching.hamming import BinaryRows, binary_rows
from imgu_ros.vision.matching.metrics import Metric, checked_rows, metric_of_rows
from imgu_ros.vision.matching.numbers import NumberRows, number_rows
from imgu_ros.vision.matching.places import Places, find_places


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
