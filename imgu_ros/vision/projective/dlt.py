# SPDX-License-Identifier: Apache-2.0
"""The direct linear transformation: a homography from points (IU 6.5, 7.2; HZ section 4.1, algorithm 4.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Matrix3, as_floats, as_matrix, as_points
from imgu_ros.vision.projective.homography import normalised_homography

#: Singular values below this share of the largest: the points leave the homography undetermined.
_RANK_TOLERANCE = 1e-9
#: Mean distance from the centroid, as a share of its coordinates, up to which points coincide: that of rounding.
_COINCIDING = 1e-14
#: Larger numbers are no places in a picture, and their squares overflow.
_LARGEST = 1e100


def homography_dlt(src: ArrayLike, dst: ArrayLike, weights: ArrayLike | None = None) -> Matrix3:
    """Return H with dst ~ H src that minimises the (weighted) algebraic error of normalised points.

    Parameters
    ----------
    src, dst : (N, 2), N >= 4
    weights : (N,) >= 0, of each correspondence's squared error; None: all 1. Where one of weight 0 lies, as long as
        it is a plain number, changes nothing

    Returns
    -------
    (3, 3), unit Frobenius norm, positive determinant where that is possible (see `normalised_homography`).

    Raises
    ------
    TooFewPoints
        If there are fewer than four correspondences (of weight above 0).
    DegenerateConfiguration
        If the points do not determine a homography (three of four collinear, coincident, ...).
    ShapeError
        If the weights are not one number >= 0 for each correspondence, or a number is not finite or too large.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> H = homography_dlt(square, [[5, 5], [7, 5], [7, 7], [5, 7]])
    >>> ((H / H[2, 2]).round(9) + 0.0).tolist()
    [[2.0, 0.0, 5.0], [0.0, 2.0, 5.0], [0.0, 0.0, 1.0]]
    """
    src = as_points(src, "src")
    dst = as_points(dst, "dst")
    if len(src) != len(dst) or len(src) < 4:
        raise TooFewPoints(f"src, dst: {len(src)} and {len(dst)} points; need at least 4 pairs")
    w = None
    if weights is not None:
        w = _checked_weights(weights, len(src))
        src, dst, w = src[w > 0], dst[w > 0], w[w > 0]
        if len(src) < 4:
            raise TooFewPoints(f"weights: {len(src)} above 0; need at least 4")
    T_src, T_dst = _weighted_normalisation(src, w), _weighted_normalisation(dst, w)
    A = design_matrix(src @ T_src[:2, :2].T + T_src[:2, 2], dst @ T_dst[:2, :2].T + T_dst[:2, 2])
    if w is not None:
        A *= np.sqrt(w)[:, None, None]
    # The triangular factor has the same singular values and right vectors, and at most nine rows.
    _, singular, vectors = np.linalg.svd(np.linalg.qr(A.reshape(-1, 9), mode="r"), full_matrices=True)
    if not singular[7] > _RANK_TOLERANCE * singular[0]:
        raise DegenerateConfiguration(
            f"src, dst: the {len(src)} correspondences do not determine a homography; need four with no three collinear"
        )
    H = np.linalg.solve(T_dst, vectors[8].reshape(3, 3) @ T_src)
    if abs(np.linalg.det(vectors[8].reshape(3, 3))) <= _RANK_TOLERANCE:
        raise DegenerateConfiguration("src, dst: the homography is singular; need points that span the plane in both")
    return normalised_homography(H)


def design_matrix(src: ArrayLike, dst: ArrayLike) -> Floats:
    """Return each correspondence's two equations A h = 0 in the nine elements of H, row-major: (N, 2, 9).

    They are the first two rows of dst x (H src) = 0 (HZ equation 4.3, with w' = 1), of points as they are:
    `normalisation` first makes them well conditioned.

    Raises
    ------
    ShapeError
        If there are not as many points on both sides, or they are too large.

    Examples
    --------
    >>> design_matrix([[2, 3]], [[5, 7]])[0].tolist()[1]
    [2.0, 3.0, 1.0, 0.0, 0.0, 0.0, -10.0, -15.0, -5.0]
    """
    src, dst = as_points(src, "src"), as_points(dst, "dst")
    if len(src) != len(dst):
        raise ShapeError(f"dst: {len(dst)} points; need {len(src)}, one for each of src")
    _require_plain(src)
    _require_plain(dst)
    A = np.zeros((len(src), 2, 9))
    A[:, 1, 0:2] = src
    A[:, 1, 2] = 1
    A[:, 0, 3:6] = -A[:, 1, 0:3]
    A[:, 0, 6:9] = dst[:, 1:] * A[:, 1, 0:3]
    A[:, 1, 6:9] = -dst[:, :1] * A[:, 1, 0:3]
    return A


def normalisation(points: ArrayLike, name: str = "points") -> Floats:
    """Return the similarity that moves the centroid to 0 and the mean distance from it to sqrt D (HZ 4.4.4, 7.1).

    Parameters
    ----------
    points : (N, D), N >= 1, D = 2 or 3
    name : what errors call them

    Returns
    -------
    (D + 1, D + 1)

    Raises
    ------
    DegenerateConfiguration
        If all points coincide.
    ShapeError
        If there are none, they have another shape, or one is not finite or too large.

    Examples
    --------
    >>> normalisation([[0, 0], [4, 0], [4, 4], [0, 4]]).tolist()
    [[0.5, 0.0, -1.0], [0.0, 0.5, -1.0], [0.0, 0.0, 1.0]]
    """
    array = as_floats(points, name)
    if array.ndim == 3 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 2 or array.shape[1] not in (2, 3) or not len(array):
        raise ShapeError(f"{name}: shape {array.shape}; need (N, 2) or (N, 3), N >= 1")
    return _weighted_normalisation(as_matrix(array, array.shape, name), None, name)


def _weighted_normalisation(array: Floats, weights: Floats | None, name: str = "points") -> Floats:
    """Return the similarity that moves the weighted centroid to 0 and the weighted mean distance from it to sqrt D."""
    _require_plain(array, name)
    centroid = np.average(array, axis=0, weights=weights)
    offsets = array - centroid
    distance = float(np.average(np.sqrt(np.einsum("nd,nd->n", offsets, offsets)), weights=weights))
    if not distance > _COINCIDING * float(np.abs(centroid).max()):
        raise DegenerateConfiguration(f"{name}: all {len(array)} coincide; need points apart")
    dimension = array.shape[1]
    T = np.eye(dimension + 1)
    T[:-1] *= np.sqrt(dimension) / distance
    T[:-1, -1] = T[:-1, :-1] @ -centroid
    return T


def _require_plain(points: Floats, name: str = "points") -> None:
    if len(points) and max(points.max(), -points.min()) > _LARGEST:
        raise ShapeError(f"{name}: up to {np.abs(points).max():g}; need less than {_LARGEST:g}")


def _checked_weights(weights: ArrayLike, count: int) -> Floats:
    weights = as_matrix(weights, (count,), "weights")
    if weights.min() < 0 or weights.max() > _LARGEST:
        raise ShapeError(f"weights: {weights.min():g} to {weights.max():g}; need 0 to {_LARGEST:g}")
    return weights / (weights.max() or 1.0)
