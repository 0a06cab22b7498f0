# SPDX-License-Identifier: Apache-2.0
"""Checks that functions of a homography and corresponding points start and end with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, Matrix3, Points, as_matrix, as_points
from imgu_ros.vision.projective.homography import normalised_homography

#: Larger numbers are no places in a picture, and their squares overflow.
LARGEST = 1e100
#: Determinant of a matrix with rows of unit length below whose square it counts as singular: rounding.
_SINGULAR = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """A homography of unit norm, det H > 0, and as many points (N, 2) on both sides."""

    H: Matrix3
    src: Points
    dst: Points


def checked_pairs(H: ArrayLike, src: ArrayLike, dst: ArrayLike) -> Pairs:
    """Return a homography (3, 3) and the points src and dst, (N, 2) each, checked.

    Raises
    ------
    ShapeError
        If the arrays do not fit each other, or hold numbers that are not finite or too large.
    DegenerateConfiguration
        If H is singular.
    """
    src, dst = as_points(src, "src"), as_points(dst, "dst")
    if len(src) != len(dst):
        raise ShapeError(f"dst: {len(dst)} points; need {len(src)}, one for each of src")
    for points, name in ((src, "src"), (dst, "dst")):
        if points.size and not np.abs(points).max() < LARGEST:
            raise ShapeError(f"{name}: up to {np.abs(points).max():g}; need less than {LARGEST:g}")
    H = as_matrix(H, (3, 3), "H")
    largest = float(np.abs(H).max())
    if largest == 0:
        raise DegenerateConfiguration("H: all zero; need a homography")
    H = normalised_homography(H / largest)
    rows = np.linalg.norm(H, axis=1)
    if not rows.min() > 0 or not abs(np.linalg.det(H / rows[:, None])) > _SINGULAR**2:
        raise DegenerateConfiguration("H: singular; need a homography")
    return Pairs(H, src, dst)


def finite(values: Floats, name: str) -> Floats:
    """Return `values`, which the errors call by `name`.

    Raises
    ------
    DegenerateConfiguration
        If one is not finite: a point was mapped to infinity.
    ShapeError
        If they are no real numbers.
    """
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
        raise ShapeError(f"{name}: no array of floats; need one")
    if not np.isfinite(values).all():
        raise DegenerateConfiguration(f"{name}: not finite; need points that H does not map to infinity")
    return values
