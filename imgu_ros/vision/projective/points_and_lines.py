# SPDX-License-Identifier: Apache-2.0
"""Homogeneous points and lines of the plane: join, meet, infinity, distance (IU 6.3, 6.4.4; HZ section 2.2).

Points are rows (x, y, w), lines rows (a, b, c) with a x + b y + c w = 0. By duality each function of points has a
counterpart of lines that is the same computation. What is returned is scaled, so that equal points and equal lines are
equal arrays: a finite point has w = 1, a point at infinity is (dx, dy, 0) of unit length with dx > 0 (or dx = 0 and
dy > 0); a line has a^2 + b^2 = 1 with a > 0 (or a = 0 and b > 0), the line at infinity is (0, 0, 1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, Points, as_matrix, as_points, as_rows
from imgu_ros.vision.projective.transformations import cofactors, require_regular

#: The line on which all points at infinity lie, (3,).
LINE_AT_INFINITY: Floats = np.array([0.0, 0.0, 1.0])
LINE_AT_INFINITY.flags.writeable = False

#: A difference of two products that is this small beside them is rounding.
_ROUNDING = 4 * float(np.finfo(np.float64).eps)


def join(points: ArrayLike, others: ArrayLike) -> Floats:
    """Return the line through each point and its partner: l = x1 x x2 (IU 6.3.4).

    Parameters
    ----------
    points, others : (N, 2) Cartesian or (N, 3) homogeneous; one row stands for as many as the other has

    Returns
    -------
    (N, 3)

    Raises
    ------
    DegenerateConfiguration
        If two points coincide, or one is (0, 0, 0).

    Examples
    --------
    >>> join([[0, 2]], [[3, 2]]).tolist()
    [[0.0, 1.0, -2.0]]
    """
    return normalised_lines(_crossed(_as_points3(points, "points"), _as_points3(others, "others"), "points, others"))


def meet(lines: ArrayLike, others: ArrayLike) -> Floats:
    """Return the point on each line and its partner: x = l1 x l2, the dual of `join` (IU 6.3.4).

    Parameters
    ----------
    lines, others : (N, 3); one row stands for as many as the other has

    Returns
    -------
    (N, 3); of parallel lines the point at infinity

    Raises
    ------
    DegenerateConfiguration
        If two lines coincide, or one is (0, 0, 0).

    Examples
    --------
    >>> meet([[1, -1, 1]], [[1, -1, -1]]).round(4).tolist()
    [[0.7071, 0.7071, 0.0]]
    """
    return normalised_points(_crossed(as_rows(lines, 3, "lines"), as_rows(others, 3, "others"), "lines, others"))


def homogeneous(points: ArrayLike) -> Floats:
    """Return Cartesian points (N, 2) as (x, y, 1), (N, 3) (IU 6.3.1)."""
    points = as_points(points)
    return np.column_stack((points, np.ones(len(points))))


def cartesian(points: ArrayLike) -> Points:
    """Return homogeneous points (N, 3) as (x / w, y / w), (N, 2) (IU 6.3.1).

    Raises
    ------
    DegenerateConfiguration
        If one is at infinity.
    """
    scaled = normalised_points(points)
    if not scaled[:, 2].all():
        raise DegenerateConfiguration(
            f"points: {np.count_nonzero(scaled[:, 2] == 0)} of {len(scaled)} at infinity; need finite points"
        )
    return scaled[:, :2]


def points_at_infinity(directions: ArrayLike) -> Floats:
    """Return where lines of these directions (N, 2) meet, (N, 3) with w = 0 (IU 6.3.5).

    Raises
    ------
    DegenerateConfiguration
        If a direction is zero.
    """
    directions = as_points(directions, "directions")
    return normalised_points(np.column_stack((directions, np.zeros(len(directions)))))


def normalised_points(points: ArrayLike) -> Floats:
    """Scale homogeneous points (N, 3): w = 1, or unit length at infinity (see the head of this module).

    Raises
    ------
    DegenerateConfiguration
        If one is (0, 0, 0).
    """
    points = _without_zero_rows(as_rows(points, 3, "points"), "points")
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        finite = points / points[:, 2:]
        size = np.hypot(points[:, 0], points[:, 1]) * _sign(points)
        infinite = points / size[:, None]
    # Farther than floats reach is at infinity.
    near = np.isfinite(finite).all(axis=1)
    infinite[:, 2] = 0
    # No negative zeros: equal points are to look equal.
    return np.where(near[:, None], finite, infinite) + 0.0


def normalised_lines(lines: ArrayLike) -> Floats:
    """Scale lines (N, 3) to a^2 + b^2 = 1; the line at infinity to (0, 0, 1) (see the head of this module).

    Raises
    ------
    DegenerateConfiguration
        If one is (0, 0, 0).
    """
    lines = _without_zero_rows(as_rows(lines, 3, "lines"), "lines")
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        scaled = lines / (np.hypot(lines[:, 0], lines[:, 1]) * _sign(lines))[:, None]
    near = np.isfinite(scaled).all(axis=1)
    return np.where(near[:, None], scaled, LINE_AT_INFINITY) + 0.0


def transform_points(H: ArrayLike, points: ArrayLike) -> Floats:
    """Map homogeneous points, (N, 3), those at infinity as well: x' = H x (IU 6.3.6 to 6.3.8, 6.4.5).

    Raises
    ------
    DegenerateConfiguration
        If H is singular.

    Examples
    --------
    A projective transformation brings points at infinity into sight, the vanishing points:

    >>> transform_points([[1, 0, 0], [0, 1, 0], [0, 0.01, 1]], [[0, 1, 0], [1, 0, 0]]).round(6).tolist()
    [[0.0, 100.0, 1.0], [1.0, 0.0, 0.0]]
    """
    H = as_matrix(H, (3, 3), "H")
    require_regular(H, 3, "H")
    points = _without_zero_rows(_as_points3(points, "points"), "points")
    return normalised_points(points @ (H / np.abs(H).max()).T)


def transform_lines(H: ArrayLike, lines: ArrayLike) -> Floats:
    """Map lines, (N, 3), as H maps their points: l' = H^-T l (IU 6.4.4, HZ 2.6).

    Raises
    ------
    DegenerateConfiguration
        If H is singular.

    Examples
    --------
    The vanishing line is where the line at infinity goes; an affine transformation leaves it at infinity:

    >>> transform_lines([[1, 0, 0], [0, 1, 0], [0, 0.01, 1]], [LINE_AT_INFINITY]).round(6).tolist()
    [[0.0, 1.0, -100.0]]
    >>> transform_lines([[2, 1, 5], [0, 3, 7], [0, 0, 1]], [LINE_AT_INFINITY]).tolist()
    [[0.0, 0.0, 1.0]]
    """
    H = as_matrix(H, (3, 3), "H")
    require_regular(H, 3, "H")
    lines = _without_zero_rows(as_rows(lines, 3, "lines"), "lines")
    return normalised_lines(lines @ cofactors(H).T)


def line_distances(points: ArrayLike, lines: ArrayLike) -> Floats:
    """Return the distance of each point from its line, (N,) >= 0, px.

    Parameters
    ----------
    points : (N, 2) Cartesian or (N, 3) homogeneous
    lines : (N, 3); one row stands for as many as the other has

    Raises
    ------
    DegenerateConfiguration
        If a point or a line is at infinity.

    Examples
    --------
    >>> line_distances([[3, 4]], [[3, 4, 0]]).round(9).tolist()
    [5.0]
    """
    xy, lines = _paired(cartesian(_as_points3(points, "points")), normalised_lines(lines), "points, lines")
    if (np.abs(lines[:, :2]).max(axis=1, initial=0) == 0).any():
        raise DegenerateConfiguration("lines: one is the line at infinity; need finite lines")
    with np.errstate(over="ignore", invalid="ignore"):
        distance: Floats = np.abs(np.einsum("ij,ij->i", xy, lines[:, :2]) + lines[:, 2])
    if not np.isfinite(distance).all():
        raise ShapeError("points, lines: a distance is beyond floats; need smaller coordinates")
    return distance


def _as_points3(points: ArrayLike, name: str) -> Floats:
    try:
        return as_rows(points, 3, name)
    except ShapeError as error:
        try:
            return homogeneous(as_points(points, name))
        except ShapeError:
            raise error from None


def _crossed(a: Floats, b: Floats, names: str) -> Floats:
    """Return a x b row by row; differences that are rounding alone are zero, so that parallel is parallel."""
    a, b = (_without_zero_rows(rows, names) for rows in _paired(a, b, names))
    plus, minus = a[:, [1, 2, 0]] * b[:, [2, 0, 1]], a[:, [2, 0, 1]] * b[:, [1, 2, 0]]
    crossed: Floats = plus - minus
    crossed[np.abs(crossed) <= _ROUNDING * (np.abs(plus) + np.abs(minus))] = 0
    if not crossed.any(axis=1).all():
        raise DegenerateConfiguration(f"{names}: the two of a pair coincide; need different ones")
    return crossed


def _paired(a: Floats, b: Floats, names: str) -> tuple[Floats, Floats]:
    if len(a) != len(b) and 1 not in (len(a), len(b)):
        raise ShapeError(f"{names}: {len(a)} and {len(b)} rows; need as many of both, or one")
    count = len(a) if len(b) == 1 else len(b)
    return np.broadcast_to(a, (count, a.shape[1])), np.broadcast_to(b, (count, b.shape[1]))


def _without_zero_rows(rows: Floats, names: str) -> Floats:
    """Scale each row to a largest element of 1; homogeneous scale means nothing, and products stay finite."""
    largest = np.abs(rows).max(axis=1, initial=0, keepdims=True)
    if not largest.all():
        raise DegenerateConfiguration(f"{names}: one is (0, 0, 0); need homogeneous coordinates")
    return np.ldexp(rows, -np.frexp(largest)[1])


def _sign(rows: Floats) -> Floats:
    """Return the sign of the first of the first two elements that is not zero."""
    return np.where(np.where(rows[:, 0] == 0, rows[:, 1], rows[:, 0]) < 0, -1.0, 1.0)
