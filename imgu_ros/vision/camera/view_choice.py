"""Which views of a board to calibrate from: different ones, not a thousand of nearly the same."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, as_points

#: Views whose corners moved by less than this share of the picture's diagonal (RMS) are the same view.
_SAME = 0.01


def choose_views(views: Sequence[ArrayLike], width: int, height: int, most: int = 50) -> tuple[int, ...]:
    """Choose views that differ, farthest first: each next one is the farthest from all that are chosen.

    Two views are as far apart as the RMS distance of their points (as they are, or with the board turned by half a
    turn). Takes time as views x `most`.

    Parameters
    ----------
    views : each (N, 2) px, the same points in the same order
    width, height : px, of the pictures
    most : how many to choose at most

    Returns
    -------
    Indices of the chosen views, ascending; the first view is always among them.

    Raises
    ------
    ShapeError
        If the views have not all the same number of points, or a number is not finite or positive.

    Examples
    --------
    >>> view = np.array([[100.0, 100], [300, 100], [100, 250], [300, 250]])
    >>> choose_views([view, view + 1, view + [200, 50], view[::-1] - 1], 640, 480)
    (0, 2)
    """
    if not (0 < width < math.inf and 0 < height < math.inf and most >= 1):
        raise ShapeError(f"width, height, most: {width}, {height}, {most}; need positive numbers")
    points = [as_points(view, f"views[{index}]", 1) for index, view in enumerate(views)]
    if not points:
        return ()
    if len({len(view) for view in points}) > 1:
        raise ShapeError(f"views: {sorted({len(view) for view in points})} points; need the same number in all")
    stack = np.stack(points) / math.hypot(width, height)
    if np.abs(stack).max() > 1e100:
        raise ShapeError(f"views: up to {np.abs(stack).max():g} diagonals; need px of a picture")
    chosen = [0]
    distance = _distances(stack, stack[0])
    while len(chosen) < most:
        farthest = int(np.argmax(distance))
        if distance[farthest] < _SAME:
            break
        chosen.append(farthest)
        distance = np.minimum(distance, _distances(stack, stack[farthest]))
    return tuple(sorted(chosen))


def _distances(stack: Floats, view: Floats) -> Floats:
    """Return the RMS distance of every view (V, N, 2) from one, (V,)."""
    as_is, turned = (((stack - other) ** 2).sum(axis=2).mean(axis=1) for other in (view, view[::-1]))
    return np.asarray(np.sqrt(np.minimum(as_is, turned)), np.float64)
