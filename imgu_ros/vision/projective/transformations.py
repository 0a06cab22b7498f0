# SPDX-License-Identifier: Apache-2.0
"""Building, composing and inverting the transformations of the plane (IU 6.2, 6.4; HZ section 2.4)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer
from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Matrix3, as_matrix
from imgu_ros.vision.projective.homography import normalised_homography

#: Singular values of the balanced matrix, smallest / largest: below this it has no inverse worth the name.
_RANK_TOLERANCE = 1e-12


def translation(t: ArrayLike) -> Matrix3:
    """Return the translation by t = (x, y) (IU 6.2.1).

    Examples
    --------
    >>> translation([5, -2]).tolist()
    [[1.0, 0.0, 5.0], [0.0, 1.0, -2.0], [0.0, 0.0, 1.0]]
    """
    return affine(np.eye(2), t)


def rotation(angle_rad: float, about: ArrayLike = (0.0, 0.0)) -> Matrix3:
    """Return the rotation by `angle_rad` about a point (IU 6.2.2).

    A positive angle turns x towards y: counter-clockwise with y up as in the notes, clockwise as seen in an image,
    whose y points down.

    Examples
    --------
    >>> rotation(np.pi / 2, about=(1, 0)).round(9).tolist()
    [[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
    """
    R = similarity(1.0, angle_rad, (0.0, 0.0))[:2, :2]
    about = as_matrix(about, (2,), "about")
    with np.errstate(over="ignore", invalid="ignore"):
        return affine(R, about - R @ about)


def euclidean(angle_rad: float, t: ArrayLike) -> Matrix3:
    """Return x -> R x + t: first the rotation by `angle_rad` about the origin, then the translation (IU 6.2.3)."""
    return similarity(1.0, angle_rad, t)


def similarity(scale: float, angle_rad: float, t: ArrayLike) -> Matrix3:
    """Return x -> scale R x + t, scale > 0, R the rotation by `angle_rad` (IU 6.2.5, HZ 2.8)."""
    scale, angle = _number(scale, "scale"), _number(angle_rad, "angle_rad")
    if scale <= 0:
        raise ShapeError(f"scale: {scale}; need more than 0")
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    return affine([[c, -s], [s, c]], t)


def scaling(x: float, y: float | None = None) -> Matrix3:
    """Return the scaling about the origin by a factor along each axis; y None: as x (IU 6.2.4, 6.4.1).

    Examples
    --------
    >>> scaling(2, 3).tolist()
    [[2.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 1.0]]
    """
    return affine(np.diag([_number(x, "x"), _number(x if y is None else y, "y")]), (0.0, 0.0))


def shear_x(factor: float) -> Matrix3:
    """Return (x, y) -> (x + factor y, y) (IU 6.4.2)."""
    return affine([[1.0, _number(factor, "factor")], [0.0, 1.0]], (0.0, 0.0))


def shear_y(factor: float) -> Matrix3:
    """Return (x, y) -> (x, y + factor x) (IU 6.4.2)."""
    return affine([[1.0, 0.0], [_number(factor, "factor"), 1.0]], (0.0, 0.0))


def affine(A: ArrayLike, t: ArrayLike) -> Matrix3:
    """Return x -> A x + t for a regular (2, 2) matrix A and t = (x, y) (IU 6.4.3, HZ 2.9).

    Raises
    ------
    DegenerateConfiguration
        If A is singular.
    """
    H = np.eye(3)
    H[:2, :2] = as_matrix(A, (2, 2), "A")
    H[:2, 2] = as_matrix(t, (2,), "t")
    require_regular(H[:2, :2], 2, "A")
    return H


def projective(A: ArrayLike, t: ArrayLike, v: ArrayLike) -> Matrix3:
    """Return [[A, t], [v, 1]] at unit Frobenius norm, det > 0 (IU 6.4.5, HZ 2.15).

    Parameters
    ----------
    A : (2, 2)
    t : (2,) where the origin goes
    v : (2,) 1/px; the line v . x + 1 = 0 is mapped to infinity

    Raises
    ------
    DegenerateConfiguration
        If the matrix is singular.
    """
    H = np.eye(3)
    H[:2, :2] = as_matrix(A, (2, 2), "A")
    H[:2, 2] = as_matrix(t, (2,), "t")
    H[2, :2] = as_matrix(v, (2,), "v")
    require_regular(H, 3, "A, t, v")
    return normalised_homography(H)


def compose(*transformations: ArrayLike) -> Matrix3:
    """Return the transformation that applies all `transformations`, (3, 3) each, in their order: first the first.

    Returns
    -------
    (3, 3); an affine one with last row (0, 0, 1), any other at unit Frobenius norm with det > 0.

    Raises
    ------
    DegenerateConfiguration
        If one of them is singular, or the product is, as far as floats tell.

    Examples
    --------
    First turned, then moved is not first moved, then turned:

    >>> turn, move = rotation(np.pi / 2), translation([1, 0])
    >>> compose(turn, move)[:2, 2].round(9).tolist(), compose(move, turn)[:2, 2].round(9).tolist()
    ([1.0, 0.0], [0.0, 1.0])
    """
    product = np.eye(3)
    for i, transformation in enumerate(transformations):
        H = as_matrix(transformation, (3, 3), f"transformations[{i}]")
        require_regular(H, 3, f"transformations[{i}]")
        with np.errstate(over="ignore", invalid="ignore"):
            product = _normal_form(_unit(H)) @ product
        require_regular(product, 3, "product")
        product = _normal_form(product)
    return product


def inverse(H: ArrayLike) -> Matrix3:
    """Return the inverse transformation, scaled as by `compose`.

    Raises
    ------
    DegenerateConfiguration
        If H is singular.

    Examples
    --------
    >>> inverse(translation([5, -2])).tolist()
    [[1.0, 0.0, -5.0], [0.0, 1.0, 2.0], [0.0, 0.0, 1.0]]
    """
    H = as_matrix(H, (3, 3), "H")
    require_regular(H, 3, "H")
    # The adjugate: no division, and the zeros of an affine matrix stay zeros.
    adjugate = cofactors(H).T
    require_regular(adjugate, 3, "inverse of H")
    return _normal_form(adjugate)


def cofactors(H: ArrayLike) -> Matrix3:
    """Return the matrix of cofactors, proportional to H^-T: how lines go when points go by H (IU 6.4.4).

    Largest element between 1/2 and 6 in size; of a matrix of rank 1 it is zero.
    """
    H = as_matrix(H, (3, 3), "H")
    if not H.any():
        return np.zeros((3, 3))
    H = _unit(H)
    found = np.stack((np.cross(H[1], H[2]), np.cross(H[2], H[0]), np.cross(H[0], H[1])))
    # No negative zeros.
    return (_unit(found) if found.any() else found) + 0.0


def require_regular(matrix: ArrayLike, size: int, name: str) -> None:
    """Raise unless a (size, size) matrix is finite and has an inverse, whatever the units of its rows and columns are.

    `name` is what the error calls it.

    Raises
    ------
    ShapeError
        If it has another shape or is not finite.
    DegenerateConfiguration
        If it is singular.
    """
    size = as_integer(size, "size")
    values = as_matrix(matrix, (size, size), name)
    # A translation by 1e6 px is regular: what counts is the rank after rows and columns are brought to one size.
    balanced = np.abs(values)
    for axis in (1, 0, 1, 0):
        largest = balanced.max(axis=axis, keepdims=True)
        if not largest.all():
            raise DegenerateConfiguration(f"{name}: singular (a row or column is zero); need a regular matrix")
        values, balanced = values / largest, balanced / largest
    singular = np.linalg.svd(values, compute_uv=False)
    if not singular[-1] > _RANK_TOLERANCE * singular[0]:
        raise DegenerateConfiguration(
            f"{name}: singular (singular values {singular[-1]:.2g} : {singular[0]:.2g}); need a regular matrix"
        )


def _normal_form(H: Matrix3) -> Matrix3:
    if H[2, 0] == 0 == H[2, 1] and H[2, 2] != 0:
        with np.errstate(over="ignore"):
            scaled: Matrix3 = H / H[2, 2]
        if np.isfinite(scaled).all():
            return scaled
    return normalised_homography(H)


def _unit(H: Matrix3) -> Matrix3:
    """Scale by a power of two, which rounds nothing, to elements of at most 1."""
    return np.ldexp(H, -int(np.frexp(np.abs(H).max())[1]))


def _number(value: float, name: str) -> float:
    return float(as_matrix(value, (), name))
