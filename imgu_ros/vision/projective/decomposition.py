# SPDX-License-Identifier: Apache-2.0
"""Taking homographies and affine maps apart into simpler ones (IU 6.4.5; HZ section 2.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Floats, Matrix3, as_matrix
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.transformations import require_regular

#: h33 beside the largest element, in units in which the matrix is balanced: below this the origin goes to infinity.
_SMALLEST_H33 = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class HomographyParts:
    """H ~ similarity @ affine @ projective (HZ 2.17).

    Attributes
    ----------
    similarity : [[s R, t], [0, 1]], s > 0, R a rotation
    affine : [[K, 0], [0, 1]], K upper triangular with positive diagonal and det K = 1
    projective : [[I, 0], [v, 1]]
    """

    similarity: Matrix3
    affine: Matrix3
    projective: Matrix3

    @property
    def scale(self) -> float:
        """The similarity's scale s."""
        return math.hypot(self.similarity[0, 0], self.similarity[1, 0])

    @property
    def angle_rad(self) -> float:
        """The similarity's angle, from x towards y."""
        return math.atan2(self.similarity[1, 0], self.similarity[0, 0])

    def recomposed(self) -> Matrix3:
        """Return the product, at unit Frobenius norm, det > 0."""
        return normalised_homography(self.similarity @ self.affine @ self.projective)


@dataclass(frozen=True, slots=True, eq=False)
class AffineParts:
    """A = R(angle) R(-axis) diag(scales) R(axis): scaling along two orthogonal directions, then a rotation (HZ 2.10).

    Attributes
    ----------
    angle_rad : of the rotation, from x towards y
    axis_rad : direction of the larger scale, -pi/2 < axis <= pi/2; 0 where both are equal
    scales : (2,), larger first; the smaller one is negative when A mirrors
    """

    angle_rad: float
    axis_rad: float
    scales: Floats

    def recomposed(self) -> Floats:
        """Return A, (2, 2)."""
        turn = _rotation(self.axis_rad)
        return _rotation(self.angle_rad) @ turn @ np.diag(self.scales) @ turn.T


def decompose_homography(H: ArrayLike) -> HomographyParts:
    """Split a homography into its similarity, affine and projective parts (HZ 2.17).

    The pipeline is unique: s > 0 and a positive diagonal of K fix the signs.

    Parameters
    ----------
    H : (3, 3), of any scale

    Raises
    ------
    DegenerateConfiguration
        If H is singular, maps the origin to infinity (h33 = 0: choose another origin), or mirrors the plane about the
        origin (then the similarity would hold a reflection).

    Examples
    --------
    >>> parts = decompose_homography([[1.707, 0.586, 1.0], [2.707, 8.242, 2.0], [1.0, 2.0, 1.0]])  # HZ example 2.18
    >>> round(parts.scale, 2), round(np.degrees(parts.angle_rad))
    (2.0, 45)
    >>> parts.affine[:2, :2].round(2).tolist(), parts.projective[2].tolist()
    ([[0.5, 1.0], [0.0, 2.0]], [1.0, 2.0, 1.0])
    """
    checked = as_matrix(H, (3, 3), "H")
    require_regular(checked, 3, "H")
    M: Matrix3 = checked / float(np.abs(checked).max())
    if not abs(M[2, 2]) > _SMALLEST_H33 * min(float(np.abs(M[2]).max()), float(np.abs(M[:, 2]).max())):
        raise DegenerateConfiguration("H: h33 = 0, the origin goes to infinity; need another origin")
    with np.errstate(over="ignore", invalid="ignore"):
        M = M / M[2, 2]
        linear = M[:2, :2] - np.outer(M[:2, 2], M[2, :2])
    if not (np.isfinite(M).all() and np.isfinite(linear).all()):
        raise DegenerateConfiguration("H: h33 vanishes beside the other elements; need another origin")
    require_regular(linear, 2, "A - t v of H")
    similarity, affine, projective = np.eye(3), np.eye(3), np.eye(3)
    unit = float(np.abs(linear).max())
    (a, b), (c, d) = (linear / unit).tolist()
    determinant = a * d - b * c
    if determinant <= 0:
        raise DegenerateConfiguration("H: mirrors the plane about the origin; need det H and h33 of one sign")
    # linear = (s R) K, K upper triangular: its first column is s R's first one times k11.
    first = math.hypot(a, c)
    cosine, sine = a / first, c / first
    s = math.sqrt(determinant)
    similarity[:2, :2] = np.array([[cosine, -sine], [sine, cosine]]) * (s * unit)
    similarity[:2, 2] = M[:2, 2]
    affine[:2, :2] = [[first / s, (cosine * b + sine * d) / s], [0.0, s / first]]
    projective[2] = M[2]
    return HomographyParts(similarity, affine, projective)


def decompose_affine(A: ArrayLike) -> AffineParts:
    """Split a (2, 2) matrix into scalings along two orthogonal directions and a rotation (HZ 2.10).

    Raises
    ------
    DegenerateConfiguration
        If A is singular.

    Examples
    --------
    >>> parts = decompose_affine([[0, -2], [3, 0]])
    >>> round(np.degrees(parts.angle_rad)), round(np.degrees(parts.axis_rad)), parts.scales.round(9).tolist()
    (90, 0, [3.0, 2.0])
    """
    A = as_matrix(A, (2, 2), "A")
    require_regular(A, 2, "A")
    size = float(np.abs(A).max())
    U, scales, Vt = np.linalg.svd(A / size)
    if np.linalg.det(U) * np.linalg.det(Vt) < 0:
        # A mirror image: into the smaller scale with it.
        U, scales = U @ np.diag([1.0, -1.0]), scales * (1.0, -1.0)
    turn = U @ Vt
    direction = Vt[0] if abs(scales[0] - scales[1]) > 1e-12 * scales[0] else np.array([1.0, 0.0])
    if direction[0] < 0 or (direction[0] == 0 and direction[1] < 0):
        direction = -direction
    return AffineParts(
        math.atan2(turn[1, 0], turn[0, 0]), math.atan2(direction[1], direction[0]), np.asarray(scales * size)
    )


def _rotation(angle_rad: float) -> Floats:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s], [s, c]])
