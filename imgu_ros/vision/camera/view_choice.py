# SPDX-License-Identifier: Apache-2.0
"""Which views of a board to calibrate from: different ones, not a thousand of nearly the same."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_sequence
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Indices, as_points

#: Views whose corners moved by less than this share of the picture's diagonal (RMS) are the same view.
_SAME = 0.01
#: And copies when they moved by less than this share, or by what noise alone may do, px.
_COPY, _COPY_PX = 0.001, 1.0
#: Of the distance to the next point, by how much a turned board's points may miss those of the board.
_TURN_TOLERANCE = 0.01
#: Squares of larger numbers, summed, overflow.
_LARGEST = 1e100


def choose_views(
    views: Sequence[ArrayLike], width: int, height: int, most: int = 50, *, board_xy: ArrayLike | None = None
) -> tuple[int, ...]:
    """Choose views that differ, farthest first: each next one is the farthest from all that are chosen.

    Two views are as far apart as the RMS distance of their points, however the board is turned: as they are, or with
    the board turned onto itself. Takes time as views x `most`.

    Parameters
    ----------
    views : each (N, 2) px, the same points in the same order
    width, height : px, of the pictures
    most : how many to choose at most
    board_xy : (N, 2) m, the points on the board, which tell how it can be turned onto itself; None: by half a turn,
        which reverses the order of a grid's points

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
    most = as_integer(most, "most")
    if not most >= 1:
        raise ShapeError(f"most: {most}; need a positive number")
    stack = _in_diagonals(views, width, height)
    if not len(stack):
        return ()
    turns = _turns(board_xy, stack)
    chosen = [0]
    distance = _distances(stack, stack[0], turns)
    while len(chosen) < most:
        farthest = int(np.argmax(distance))
        if distance[farthest] < _SAME:
            break
        chosen.append(farthest)
        distance = np.minimum(distance, _distances(stack, stack[farthest], turns))
    return tuple(sorted(chosen))


def without_copies(board_xy: ArrayLike, views: Sequence[ArrayLike], width: int, height: int) -> tuple[int, ...]:
    """Return the indices of views that are no copies of an earlier one.

    A copy shows nothing new: the same file once more, the next frame of a camera and a board that stand still, the same
    with the board's points counted from another corner. Its noise is that of the first, at least in part, so that it
    must not count as another measurement. Copies are views whose points moved by less than a pixel, or a thousandth of
    the picture's diagonal (RMS). Takes time as views x different views.

    Parameters
    ----------
    board_xy : (N, 2) m, the points on the board
    views : each (N, 2) px
    width, height : px, of the pictures

    Raises
    ------
    ShapeError
        As `choose_views`.
    """
    stack = _in_diagonals(views, width, height)
    turns = _turns(board_xy, stack)
    limit = max(_COPY_PX / math.hypot(width, height), _COPY)
    different: list[int] = []
    is_copy = np.zeros(len(views), bool)
    for index in range(len(views)):
        if not is_copy[index]:
            different.append(index)
            is_copy |= _distances(stack, stack[index], turns) < limit
    return tuple(different)


def board_turns(board_xy: ArrayLike) -> tuple[Indices, ...]:
    """Return the orders in which a board's points look the same: as they are, and turned by 90, 180 or 270 degrees.

    Parameters
    ----------
    board_xy : (N, 2) m

    Returns
    -------
    One to four permutations, each (N,); of a grid of squares two, when it has as many rows as columns four.

    Raises
    ------
    ShapeError
        If they are no finite points.
    """
    # It takes half a second to load: only for those who calibrate.
    from scipy.spatial import KDTree

    board_xy = as_points(board_xy, "board_xy", 1)
    as_is = np.arange(len(board_xy))
    size = float(np.ptp(board_xy, axis=0).max())
    if not 0 < size < _LARGEST:
        return (as_is,)
    board_xy = board_xy / size
    centred = board_xy - (board_xy.min(axis=0) + board_xy.max(axis=0)) / 2
    tree = KDTree(centred)
    spacing = float(tree.query(centred, k=2)[0][:, 1].min())
    turns = [as_is]
    for cosine, sine in ((0, 1), (-1, 0), (0, -1)):
        distance, index = tree.query(centred @ np.array([[cosine, sine], [-sine, cosine]]))
        if distance.max() <= _TURN_TOLERANCE * spacing and len(np.unique(index)) == len(index):
            turns.append(np.asarray(index, np.intp))
    return tuple(turns)


def _in_diagonals(views: Sequence[ArrayLike], width: int, height: int) -> Floats:
    """Return views of equally many points, (V, N, 2), in units of the picture's diagonal."""
    views, width, height = as_sequence(views, "views"), as_integer(width, "width"), as_integer(height, "height")
    if not (width > 0 and height > 0):
        raise ShapeError(f"width, height: {width}, {height}; need positive numbers")
    points = [as_points(view, f"views[{index}]", 1) for index, view in enumerate(views)]
    if len({len(view) for view in points}) > 1:
        raise ShapeError(f"views: {sorted({len(view) for view in points})} points; need the same number in all")
    stack = np.stack(points or [np.zeros((0, 2))])[: len(points)] / math.hypot(width, height)
    if np.abs(stack).max(initial=0.0) > _LARGEST:
        raise ShapeError(f"views: up to {np.abs(stack).max():g} diagonals; need px of a picture")
    return np.asarray(stack, np.float64)


def _turns(board_xy: ArrayLike | None, stack: Floats) -> tuple[Indices, ...]:
    count = stack.shape[1]
    if board_xy is None:
        as_is: Indices = np.arange(count)
        return (as_is, as_is[::-1])
    turns = board_turns(board_xy)
    if len(turns[0]) != count:
        raise ShapeError(f"board_xy: {len(turns[0])} points; need {count}, as in every view")
    return turns


def _distances(stack: Floats, view: Floats, turns: Sequence[Indices]) -> Floats:
    """Return the RMS distance of every view (V, N, 2) from one, (V,)."""
    each = [((stack - view[turn]) ** 2).sum(axis=2).mean(axis=1) for turn in turns]
    return np.asarray(np.sqrt(np.min(each, axis=0)), np.float64)
