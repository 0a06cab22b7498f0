# SPDX-License-Identifier: Apache-2.0
"""Spreading keypoints evenly over an image."""

from __future__ import annotations

import math

import numpy as np

from imgu_ros.arguments import as_integer, as_number, as_sequence
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Indices, Points, as_matrix, as_points


def spread(xy: Points, response: Floats, size: tuple[int, int], count: int, strongest_share: float = 0.5) -> Indices:
    """Choose up to `count` points: the strongest ones, then in turns among the cells of a grid.

    In the turns every cell's strongest point comes before any cell's second strongest, and so on; within a turn the
    stronger come first. The grid has about as many cells as half the wanted points.

    Parameters
    ----------
    xy : (N, 2) px
    response : (N,) larger is stronger
    size : (width, height) px
    count : wanted number, >= 1
    strongest_share : share of `count` that is kept wherever it lies, 0 to 1

    Returns
    -------
    (min(N, count),) indices, strongest first

    Raises
    ------
    ShapeError
        If the arrays do not fit each other or hold NaN or infinity, count or size is not positive, or the share
        out of its range.
    """
    count = as_integer(count, "count")
    strongest_share = as_number(strongest_share, "strongest_share")
    xy = as_points(xy, "xy")
    if not 0 <= strongest_share <= 1:
        raise ShapeError(f"strongest_share: {strongest_share}; need 0 to 1")
    response = as_matrix(response, (len(xy),), "response")
    sides = [as_integer(side, "size") for side in as_sequence(size, "size")]
    if len(sides) != 2 or count < 1 or min(sides) < 1:
        raise ShapeError(f"count, size: {count}, {size}; need a positive number, and (width, height)")
    strongest_first = np.lexsort((xy[:, 0], xy[:, 1], -response))
    if len(xy) > count:
        side = math.sqrt(sides[0] * sides[1] / max(1, count // 2))
        columns = max(1, math.ceil(sides[0] / side))
        # A point outside the image counts to the nearest cell.
        row, column = (np.clip(xy[:, i], 0, sides[i] - 1) // side for i in (1, 0))
        cell = (row * columns + column).astype(np.intp)
        cell = cell[strongest_first]
        by_cell = np.argsort(cell, kind="stable")
        starts = np.flatnonzero(np.r_[True, np.diff(cell[by_cell]) != 0])
        turn = np.empty(len(xy), np.intp)
        turn[by_cell] = np.arange(len(xy)) - np.repeat(starts, np.diff(np.r_[starts, len(xy)]))
        # The strongest are kept wherever it lies: a small target in front of a dull wall needs its points.
        turn[: math.floor(count * strongest_share)] = -1
        kept = np.sort(np.argsort(turn, kind="stable")[:count])
        strongest_first = strongest_first[kept]
    return strongest_first
