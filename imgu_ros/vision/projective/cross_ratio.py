# SPDX-License-Identifier: Apache-2.0
"""The cross ratio of four points on a line, and of four lines through a point (IU 6.4.5; HZ section 2.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_number
from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, as_floats, as_matrix, as_rows
from imgu_ros.vision.projective.points_and_lines import homogeneous, normalised_lines, normalised_points

#: Determinants of unit vectors below this are rounding.
_ROUNDING = 1e-12


def cross_ratio(points: ArrayLike, tolerance: float = 1e-6) -> float:
    """Return (A, B; C, D) = AC BD / (BC AD), lengths with sign: what every homography preserves.

    Parameters
    ----------
    points : (4, 2) Cartesian or (4, 3) homogeneous, A, B, C, D on a line; one of them may be at infinity
    tolerance : largest distance of a point from the common line, as a share of the extent of the points

    Raises
    ------
    DegenerateConfiguration
        If the points are not on a line, three coincide, or B = C or A = D (then it is infinite).

    Examples
    --------
    >>> round(cross_ratio([[0, 0], [1, 1], [2, 2], [4, 4]]), 12)
    1.5
    """
    tolerance = as_number(tolerance, "tolerance")
    rows = as_floats(points, "points")
    if rows.shape in ((4, 1, 2), (4, 1, 3)):
        rows = rows[:, 0]
    if rows.shape not in ((4, 2), (4, 3)):
        raise ShapeError(f"points: shape {rows.shape}; need (4, 2) or (4, 3)")
    xyw = homogeneous(rows) if rows.shape[1] == 2 else normalised_points(rows)
    return _cross_ratio(_centred_points(xyw), tolerance, "points")


def cross_ratio_of_lines(lines: ArrayLike, tolerance: float = 1e-6) -> float:
    """Return the cross ratio of four lines through a point, or parallel: the dual of `cross_ratio`.

    Any line that crosses the four meets them in points of this cross ratio.

    Parameters
    ----------
    lines : (4, 3)
    tolerance : largest distance of the common point from a line, as a share of the coordinates' size

    Raises
    ------
    DegenerateConfiguration
        If the lines do not meet in a point, three coincide, or B = C or A = D.

    Examples
    --------
    >>> round(cross_ratio_of_lines([[1, 0, 0], [1, 0, -1], [1, 0, -2], [1, 0, -4]]), 12)
    1.5
    """
    tolerance = as_number(tolerance, "tolerance")
    scaled = normalised_lines(as_matrix(as_rows(lines, 3, "lines"), (4, 3), "lines"))
    return _cross_ratio(_centred_lines(scaled), tolerance, "lines")


def _centred_points(points: Floats) -> Floats:
    """Apply a similarity after which the finite points lie about the origin at distances of about 1."""
    finite = points[points[:, 2] != 0, :2]
    if len(finite) == 0:
        return points
    with np.errstate(over="ignore", invalid="ignore"):
        centre = finite.mean(axis=0)
        extent = float(np.abs(finite - centre).max())
    if not np.isfinite(extent):
        raise ShapeError("points: coordinates beyond floats; need smaller ones")
    moved = points.copy()
    moved[points[:, 2] != 0, :2] -= centre
    moved[points[:, 2] != 0, :2] /= extent or 1.0
    return moved


def _centred_lines(lines: Floats) -> Floats:
    """Move the origin to the common point, or between parallel lines, and bring the distances to about 1."""
    finite = lines[:, :2].any(axis=1)
    normals, offsets = lines[finite, :2], lines[finite, 2]
    if len(offsets) == 0:
        return lines
    size = float(np.abs(offsets).max()) or 1.0
    # The least-norm solution: of parallel lines the middle one.
    singular = np.linalg.svd(normals, compute_uv=False)
    origin = np.linalg.lstsq(normals, -offsets / size, rcond=max(1e-9, _ROUNDING / singular[0]))[0]
    rest = offsets / size + normals @ origin
    largest = float(np.abs(rest).max())
    moved = lines.copy()
    moved[finite, 2] = rest if np.linalg.matrix_rank(normals, 1e-9) == 2 else rest / (largest or 1.0)
    return moved


def _cross_ratio(rows: Floats, tolerance: float, name: str) -> float:
    """Return the cross ratio of four homogeneous vectors in a plane through the origin."""
    if not 0 < tolerance < 1:
        raise ShapeError(f"tolerance: {tolerance}; need 0 to 1")
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    _, singular, axes = np.linalg.svd(rows)
    if singular[2] > tolerance:
        raise DegenerateConfiguration(
            f"{name}: off a common {'line' if name == 'points' else 'point'} by {singular[2]:.2g} of their extent; "
            f"need at most {tolerance:g}"
        )
    # In the two-dimensional space that they span, signed lengths are determinants of pairs (HZ 2.19).
    a, b, c, d = rows @ axes[:2].T
    ac, bd, bc, ad = (_determinant(*pair) for pair in ((a, c), (b, d), (b, c), (a, d)))
    if abs(bc * ad) <= _ROUNDING:
        raise DegenerateConfiguration(f"{name}: B = C or A = D (or three coincide); need others")
    return ac * bd / (bc * ad)


def _determinant(p: Floats, q: Floats) -> float:
    return float(p[0] * q[1] - p[1] * q[0])
