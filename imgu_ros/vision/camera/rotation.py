# SPDX-License-Identifier: Apache-2.0
"""Rotations: the exponential map and quaternions (HZ appendix A4.3; IU 8.1.5)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Matrix3, as_matrix

#: How far R^T R may be from the identity: looser than rounding, tighter than any other kind of matrix.
_ORTHONORMAL = 1e-5
#: Radians; the fraction of a turn is lost in longer vectors.
_LONGEST_VECTOR = 1e8


def exp_so3(vector: ArrayLike) -> Matrix3:
    """Return the rotation by |vector| radians about the direction of `vector`, (3,).

    Raises
    ------
    ShapeError
        If `vector` is not three finite numbers of at most 1e8.

    Examples
    --------
    >>> exp_so3([0, 0, np.pi / 2]).round(6).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    vector = as_matrix(vector, (3,), "vector")
    if np.abs(vector).max() > _LONGEST_VECTOR:
        raise ShapeError(f"vector: {vector.tolist()}; need radians, at most {_LONGEST_VECTOR:g}")
    angle = math.sqrt(float(vector @ vector))
    # R = I + sin(a) / a [v]x + (1 - cos(a)) / a^2 [v]x^2 (Rodrigues), both quotients without cancellation.
    sine, versine = (math.sin(angle) / angle, 2 * (math.sin(angle / 2) / angle) ** 2) if angle > 1e-150 else (1.0, 0.5)
    x, y, z = vector.tolist()
    turn = sine * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    square = np.array(
        [[-(y * y) - z * z, x * y, x * z], [x * y, -(x * x) - z * z, y * z], [x * z, y * z, -(x * x) - y * y]]
    )
    return np.asarray(np.eye(3) + turn + versine * square, np.float64)


def log_so3(R: ArrayLike) -> Floats:
    """Return the rotation vector (3,) of R, of length 0 to pi. ShapeError as `as_rotation`.

    Examples
    --------
    >>> log_so3([[0, -1, 0], [1, 0, 0], [0, 0, 1]]).round(6).tolist()
    [0.0, 0.0, 1.570796]
    """
    # The quaternion keeps all digits, at half turns as well as at small ones.
    x, y, z, w = quaternion(R).tolist()
    sine = math.hypot(x, y, z)
    scale = 2 * math.atan2(sine, w) / sine if sine > 1e-150 else 2.0
    return np.array([scale * x, scale * y, scale * z])


def quaternion(R: ArrayLike) -> Floats:
    """Return R's unit quaternion (x, y, z, w) with w >= 0; at w = 0 the first other non-zero part is positive.

    ShapeError as `as_rotation`.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = as_rotation(R).tolist()
    # A row of 4 q q^T, that of the largest part: no digit is lost (Shepperd 1978). Four numbers are quicker by hand.
    trace = xx + yy + zz
    rows = {
        xx: (1 - trace + 2 * xx, xy + yx, xz + zx, zy - yz),
        yy: (xy + yx, 1 - trace + 2 * yy, yz + zy, xz - zx),
        zz: (xz + zx, yz + zy, 1 - trace + 2 * zz, yx - xy),
        trace: (zy - yz, xz - zx, yx - xy, 1 + trace),
    }
    row = rows[max(rows)]
    length = math.hypot(*row)
    leading = next(part for part in (row[3], *row) if part)
    return np.array(row) / math.copysign(length, leading) + 0.0


def from_quaternion(q: ArrayLike) -> Matrix3:
    """Return the rotation of a quaternion q = (x, y, z, w), which is normalised first. ShapeError when it is zero."""
    q = as_matrix(q, (4,), "q")
    largest = float(np.abs(q).max())
    if largest == 0:
        raise ShapeError("q: all zero; need a quaternion (x, y, z, w)")
    # Divided first: the square of a large or tiny number is none.
    x, y, z, w = (q / largest).tolist()
    s = 2 / (x * x + y * y + z * z + w * w)
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )


def as_rotation(R: ArrayLike, name: str = "R") -> Matrix3:
    """Return R as a float64 matrix (3, 3) when it is a rotation.

    Raises
    ------
    ShapeError
        If it is not (3, 3), not finite, not orthonormal to 1e-5, or a reflection; it calls R by `name`.
    """
    R = as_matrix(R, (3, 3), name)
    # R^T R - I and det R by hand: on nine numbers Python is several times quicker than numpy.
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    errors = (
        a * a + d * d + g * g - 1, b * b + e * e + h * h - 1, c * c + f * f + i * i - 1,
        a * b + d * e + g * h, a * c + d * f + g * i, b * c + e * f + h * i,
    )  # fmt: skip
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if not (determinant > 0 and all(-_ORTHONORMAL <= error <= _ORTHONORMAL for error in errors)):
        raise ShapeError(f"{name}: {R.tolist()}; need a rotation (R^T R = I, det R = 1)")
    return R


def nearest_rotation(matrix: ArrayLike, name: str = "matrix") -> Matrix3:
    """Return the rotation nearest to a (3, 3) matrix in the Frobenius norm (orthogonal Procrustes; HZ appendix A4).

    Raises
    ------
    ShapeError
        If the matrix is not (3, 3) and finite, or so nearly singular that the rotation is not determined; it calls the
        matrix by `name`.
    """
    matrix = as_matrix(matrix, (3, 3), name)
    largest = float(np.abs(matrix).max())
    U, singular, Vt = np.linalg.svd(matrix / (largest or 1.0))
    sign = 1.0 if np.linalg.det(U @ Vt) > 0 else -1.0
    # With det < 0 the smallest direction is turned over; two equal smallest ones leave open which.
    if not singular[1] + sign * singular[2] > 1e-9:
        raise ShapeError(f"{name}: singular values {singular.tolist()}; need a matrix near a rotation")
    return np.asarray((U * (1.0, 1.0, sign)) @ Vt, np.float64)
