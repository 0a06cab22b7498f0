"""Applying homographies to points (notes 6.3, 6.4.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Floats, Matrix3, Points, as_matrix, as_points


def transform(H: ArrayLike, points: ArrayLike) -> Points:
    """Map points by a homography.

    Parameters
    ----------
    H : (3, 3)
    points : (N, 2)

    Returns
    -------
    (N, 2)

    Raises
    ------
    DegenerateConfiguration
        If a point is mapped to infinity.
    """
    H = as_matrix(H, (3, 3), "H")
    points = as_points(points)
    mapped = points @ H[:, :2].T + H[:, 2]
    if len(points) and (mapped[:, 2] == 0).any():
        raise DegenerateConfiguration("points: one is mapped to infinity by H; need points off the vanishing line")
    return mapped[:, :2] / mapped[:, 2:]


def local_jacobian(H: ArrayLike, points: ArrayLike) -> Floats:
    """Return the derivative of the mapped points by the points, (N, 2, 2): H's local affine part."""
    H = as_matrix(H, (3, 3), "H")
    points = as_points(points)
    mapped = points @ H[:, :2].T + H[:, 2]
    xy = mapped[:, :2] / mapped[:, 2:]
    return (H[None, :2, :2] - xy[:, :, None] * H[2, :2]) / mapped[:, 2][:, None, None]


def normalised_homography(H: ArrayLike) -> Matrix3:
    """Scale a homography to unit Frobenius norm and positive determinant.

    A homography of odd size keeps its orientation under a change of sign only if the determinant changes too:
    det H > 0 is reached for every regular H. Whether the sign also makes w positive for the points at hand is the
    caller's to check (`faces_camera`).

    Raises
    ------
    DegenerateConfiguration
        If H is zero.
    """
    H = as_matrix(H, (3, 3), "H")
    norm = float(np.linalg.norm(H))
    if norm == 0:
        raise DegenerateConfiguration("H: all zero; need a homography")
    return H * ((1 if np.linalg.det(H) >= 0 else -1) / norm)


def faces_camera(H: ArrayLike, points: ArrayLike) -> bool:
    """Whether a homography with det H > 0 maps all points with w > 0.

    Then it keeps the orientation of the plane about each of them and puts none behind the camera; a mirrored view,
    or one in which the vanishing line crosses the points, does not (HZ section 21.1).
    """
    H = normalised_homography(H)
    points = as_points(points)
    return bool((points @ H[2, :2] + H[2, 2] > 0).all())
