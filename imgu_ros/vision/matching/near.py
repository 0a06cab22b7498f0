# SPDX-License-Identifier: Apache-2.0
"""Which points of one set lie near which of another."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Indices, Points, as_points

#: Differences of larger numbers overflow.
_LARGEST = 1e300
#: Of pairs that are compared at once.
_AT_ONCE = 2**20
#: Cells along each axis.
_MOST_CELLS = 2**20


@dataclass(frozen=True, slots=True, eq=False)
class NearPairs:
    """Pairs of points, (K,) indices each: by the first set's point, then by the second's."""

    a: Indices
    b: Indices


def near_pairs(a_xy: ArrayLike, b_xy: ArrayLike, radius_px: float, most: int | None = None) -> NearPairs | None:
    """Return all pairs up to `radius_px` apart along x and along y.

    Points are sorted into cells as wide as the radius, so that the time goes with the number of points and of pairs.

    Parameters
    ----------
    a_xy, b_xy : (N, 2) and (M, 2), numbers below 1e300
    radius_px : 0 or more
    most : None is returned instead of more pairs

    Raises
    ------
    ShapeError
        If the points are no such numbers, or the radius is negative or not finite.

    Examples
    --------
    >>> pairs = near_pairs([[0, 0], [9, 0]], [[3, -3], [9, 1], [0, 4]], radius_px=3.0)
    >>> pairs.a.tolist(), pairs.b.tolist()
    ([0, 1], [0, 1])
    """
    radius_px = as_number(radius_px, "radius_px")
    most = None if most is None else as_integer(most, "most")
    a_xy, b_xy = _checked(a_xy, "a_xy"), _checked(b_xy, "b_xy")
    if not 0 <= radius_px < np.inf:
        raise ShapeError(f"radius_px: {radius_px!r}; need a number >= 0")
    if not len(a_xy) or not len(b_xy):
        return NearPairs(np.zeros(0, np.intp), np.zeros(0, np.intp))
    ranges = _ranges(a_xy, b_xy, radius_px)
    found: list[NearPairs] = []
    total = 0
    for rows in _blocks(ranges.count.sum(axis=1)):
        found.append(_compared(a_xy, b_xy, radius_px, ranges, rows))
        total += len(found[-1].a)
        if most is not None and total > most:
            return None
    return NearPairs(np.concatenate([pairs.a for pairs in found]), np.concatenate([pairs.b for pairs in found]))


@dataclass(frozen=True, slots=True, eq=False)
class _Ranges:
    """Where those that may be near stand: for each point of the first set three stretches of the second's `order`."""

    order: Indices
    first: Indices
    count: Indices


def _ranges(a_xy: Points, b_xy: Points, radius_px: float) -> _Ranges:
    origin = np.minimum(a_xy.min(axis=0), b_xy.min(axis=0))
    extent = float((np.maximum(a_xy.max(axis=0), b_xy.max(axis=0)) - origin).max())
    # A little wider than the radius: rounding must not put two near ones two cells apart.
    side = max(1.000001 * radius_px, extent / _MOST_CELLS) or 1.0
    a_cell, b_cell = (np.floor((xy - origin) / side).astype(np.int64) + 1 for xy in (a_xy, b_xy))
    columns = _MOST_CELLS + 4
    key = b_cell[:, 1] * columns + b_cell[:, 0]
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    middle = (a_cell[:, 1:] + (-1, 0, 1)) * columns + a_cell[:, :1]
    first = np.searchsorted(ordered, middle - 1, "left")
    return _Ranges(order, first, np.searchsorted(ordered, middle + 1, "right") - first)


def _blocks(count: Indices) -> list[slice]:
    """Return stretches of rows with few candidates each, in all."""
    number = np.cumsum(count) // _AT_ONCE
    starts = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(count)]
    return [slice(start, end) for start, end in itertools.pairwise(starts)]


def _compared(a_xy: Points, b_xy: Points, radius_px: float, ranges: _Ranges, rows: slice) -> NearPairs:
    count, first = ranges.count[rows].ravel(), ranges.first[rows].ravel()
    before = np.cumsum(count) - count
    b = ranges.order[np.arange(count.sum()) + np.repeat(first - before, count)]
    a = np.repeat(np.arange(rows.start, rows.stop), ranges.count[rows].sum(axis=1))
    near = np.flatnonzero((np.abs(a_xy[a] - b_xy[b]) <= radius_px).all(axis=1))
    a, b = a[near], b[near]
    order = np.lexsort((b, a))
    return NearPairs(a[order], b[order])


def _checked(xy: ArrayLike, name: str) -> Points:
    points = as_points(xy, name)
    # Differences of such numbers stay finite.
    if len(points) and not np.abs(points).max() < _LARGEST:
        raise ShapeError(f"{name}: up to {np.abs(points).max():g}; need less than {_LARGEST:g}")
    return points
