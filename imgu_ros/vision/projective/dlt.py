"""The direct linear transformation: a homography from points (notes 6.5, 7.2; HZ section 4.1, algorithm 4.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, TooFewPoints
from imgu_ros.types import Floats, Matrix3, Points, as_points
from imgu_ros.vision.projective.transform import normalised_homography

_RANK_TOLERANCE = 1e-9


def homography_dlt(src: ArrayLike, dst: ArrayLike, weights: Floats | None = None) -> Matrix3:
    """Return H with dst ~ H src that minimises the (weighted) algebraic error of normalised points.

    Parameters
    ----------
    src, dst : (N, 2), N >= 4
    weights : (N,) >= 0, of each correspondence's squared error; None: all 1

    Returns
    -------
    (3, 3), unit Frobenius norm, positive determinant where that is possible (see `normalised_homography`).

    Raises
    ------
    TooFewPoints
        If there are fewer than four correspondences.
    DegenerateConfiguration
        If the points do not determine a homography (three of four collinear, coincident, ...).
    """
    src = as_points(src, "src")
    dst = as_points(dst, "dst")
    if len(src) != len(dst) or len(src) < 4:
        raise TooFewPoints(f"src, dst: {len(src)} and {len(dst)} points; need at least 4 pairs")
    T_src, T_dst = normalisation(src), normalisation(dst)
    x, y = (src @ T_src[:2, :2].T + T_src[:2, 2]).T
    u, v = (dst @ T_dst[:2, :2].T + T_dst[:2, 2]).T
    A = np.zeros((len(src), 2, 9))
    A[:, 0, 3:6] = -np.column_stack((x, y, np.ones_like(x)))
    A[:, 0, 6:9] = -v[:, None] * A[:, 0, 3:6]
    A[:, 1, 0:3] = -A[:, 0, 3:6]
    A[:, 1, 6:9] = u[:, None] * A[:, 0, 3:6]
    if weights is not None:
        A *= np.sqrt(weights)[:, None, None]
    # The triangular factor has the same singular values and right vectors, and at most nine rows.
    _, singular, vectors = np.linalg.svd(np.linalg.qr(A.reshape(-1, 9), mode="r"), full_matrices=True)
    if singular[7] <= _RANK_TOLERANCE * singular[0]:
        raise DegenerateConfiguration(
            f"src, dst: the {len(src)} correspondences do not determine a homography; need four with no three collinear"
        )
    H = np.linalg.solve(T_dst, vectors[8].reshape(3, 3) @ T_src)
    if abs(np.linalg.det(vectors[8].reshape(3, 3))) <= _RANK_TOLERANCE:
        raise DegenerateConfiguration("src, dst: the homography is singular; need points that span the plane in both")
    return normalised_homography(H)


def normalisation(points: Points) -> Matrix3:
    """Return the similarity that moves the centroid to 0 and the mean distance from it to sqrt 2 (HZ 4.4.4).

    Raises
    ------
    DegenerateConfiguration
        If all points coincide.
    """
    centroid = points.mean(axis=0)
    distance = float(np.hypot(*(points - centroid).T).mean())
    if not distance > 1e-12 * max(1.0, float(np.abs(centroid).max())):
        raise DegenerateConfiguration(f"points: all {len(points)} coincide; need points that span the plane")
    s = np.sqrt(2) / distance
    return np.array([[s, 0, -s * centroid[0]], [0, s, -s * centroid[1]], [0, 0, 1]])
