# SPDX-License-Identifier: Apache-2.0
"""The logarithm of a homography, and its inverse: to a plane's motion on the picture what a velocity is to a distance.

By inverse scaling and squaring (Higham, Functions of Matrices, 2008, sections 6.3 and 11.5): square roots bring the
matrix near the identity, where a series is short.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.types import Matrix3, as_matrix
from imgu_ros.vision.projective.transform import inverse3

#: Largest deviation from the identity at which the series is used.
_NEAR = 0.25
#: Most square roots on the way there: each halves the logarithm.
_MOST_ROOTS = 12
#: Most iterations of a square root, which converge quadratically.
_MOST_STEPS = 30
#: Relative change below which that iteration stops: that of rounding.
_EXACT = 1e-12
#: Terms of the series: at `_NEAR` what is left out is some 1e-12.
_TERMS = 6
#: Terms of the exponential: at `_NEAR` the next is below 1e-12.
_FACTORIALS = 14
#: Larger velocities are no motion from one frame to the next.
_LARGEST = 100.0
#: Determinants and products of three of such numbers are finite and regular.
_PLAIN = (1e-30, 1e30)
#: (3, 3).
_IDENTITY = np.eye(3)
_NO_LOGARITHM = "H: no real logarithm; need a motion of less than half a turn, in coordinates of moderate size"


def logarithm(H: ArrayLike) -> Matrix3:
    """Return L, (3, 3) of trace 0, with exp(L) ~ H: exp(s L) is the share s of the motion, also beyond 1.

    Parameters
    ----------
    H : (3, 3) homography from a picture to itself, of coordinates of moderate size (about the plane's own)

    Raises
    ------
    DegenerateConfiguration
        If H turns the plane over or is singular, or its motion is half a turn or more.
    ShapeError
        If H is not (3, 3) of finite numbers.

    Examples
    --------
    A shift is a velocity times a time:

    >>> logarithm([[1, 0, 6], [0, 1, -2], [0, 0, 1]]).round(9).tolist()[0]
    [0.0, 0.0, 6.0]
    """
    H = as_matrix(H, (3, 3), "H")
    largest = float(np.abs(H).max())
    det = float(cv2.determinant(H / largest)) if _PLAIN[0] < largest < _PLAIN[1] else 0.0
    if not _PLAIN[0] < det:
        raise DegenerateConfiguration("H: singular, or it turns the plane over; need one seen from its front")
    A = H / (largest * det ** (1 / 3))
    for roots in range(_MOST_ROOTS):
        if float(np.abs(A - _IDENTITY).max()) < _NEAR:
            return _near_identity(A) * 2.0**roots
        A = _square_root(A)
    raise DegenerateConfiguration(_NO_LOGARITHM)


def exponential(L: ArrayLike) -> Matrix3:
    """Return exp(L), (3, 3): the homography that a velocity makes in a unit of time; of trace 0, its determinant is 1.

    Raises
    ------
    ShapeError
        If L is not (3, 3) of finite numbers.
    DegenerateConfiguration
        If the result is beyond floats.

    Examples
    --------
    >>> exponential([[0, 0, 6], [0, 0, -2], [0, 0, 0]]).tolist()
    [[1.0, 0.0, 6.0], [0.0, 1.0, -2.0], [0.0, 0.0, 1.0]]
    """
    L = as_matrix(L, (3, 3), "L")
    largest = float(np.abs(L).max())
    if not largest < _LARGEST:
        raise DegenerateConfiguration(f"L: up to {largest:g}; need the velocity of a motion, less than {_LARGEST:g}")
    squarings = max(0, math.ceil(math.log2(largest / _NEAR))) if largest > 0 else 0
    step = L / 2.0**squarings
    power, total = step, _IDENTITY + step
    for term in range(2, _FACTORIALS):
        power = power @ step / term
        total = total + power
    for _ in range(squarings):
        total = total @ total
    return total


def _near_identity(A: Matrix3) -> Matrix3:
    # log A = 2 artanh Z, Z = (A - I) (A + I)^-1.
    Z = (A - _IDENTITY) @ inverse3(A + _IDENTITY)
    squared, power, total = Z @ Z, Z, Z
    for term in range(1, _TERMS):
        power = power @ squared
        total = total + power / (2 * term + 1)
    return 2 * total + 0.0


def _square_root(A: Matrix3) -> Matrix3:
    """Return the square root of eigenvalues with a positive real part, by Denman and Beavers' iteration."""
    root, inverse_root = A, _IDENTITY
    for _ in range(_MOST_STEPS):
        further, inverse_root = (root + inverse3(inverse_root)) / 2, (inverse_root + inverse3(root)) / 2
        change = float(np.abs(further - root).max())
        root = further
        if not math.isfinite(change):
            break
        if change <= _EXACT * float(np.abs(root).max()):
            return root
    raise DegenerateConfiguration(_NO_LOGARITHM)
