# SPDX-License-Identifier: Apache-2.0
"""The covariance of a camera's numbers: fx, fy, cx, cy and the distortion coefficients."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, as_floats, as_matrix
from imgu_ros.vision.camera.intrinsics import Camera

#: Of the largest element: an asymmetry or a negative eigenvalue so small is rounding (numbers written with 6 digits).
_ROUNDING = 1e-5
#: Squares of larger variances overflow.
_LARGEST = 1e100


def with_covariance(camera: Camera, covariance: ArrayLike | None) -> Camera:
    """Return the camera with the covariance of its numbers.

    Parameters
    ----------
    camera : with D distortion coefficients
    covariance : (4 + D, 4 + D) of fx, fy, cx, cy and the distortion coefficients, symmetric, positive semidefinite; of
        coefficients that are not in it the camera's are exact. None: taken as exact

    Raises
    ------
    ShapeError
        If it is no covariance, or of more or other numbers than the camera has.

    Examples
    --------
    >>> from imgu_ros.vision.camera.intrinsics import make_camera
    >>> camera = make_camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], (), "plumb_bob", 640, 480)
    >>> with_covariance(camera, np.diag([4.0, 4, 1, 1])).covariance.shape
    (9, 9)
    """
    require_type(camera, Camera, "camera")
    if covariance is None:
        return replace(camera, covariance=None)
    given = as_covariance(covariance)
    count = 4 + len(camera.distortion)
    if len(given) > count and not given[count:].any():
        given = given[:count, :count]
    if not (
        len(given) == 4
        or len(given) == count
        or (4 < len(given) < count and not camera.distortion[len(given) - 4 :].any())
    ):
        raise ShapeError(
            f"covariance: of {len(given)} numbers; need {count} x {count}: fx, fy, cx, cy and the "
            f"{len(camera.distortion)} coefficients of {camera.model}, or 4 x 4"
        )
    whole = np.zeros((count, count))
    whole[: len(given), : len(given)] = given
    whole.flags.writeable = False
    return replace(camera, covariance=whole)


def as_covariance(covariance: ArrayLike, name: str = "covariance") -> Floats:
    """Return a covariance of at least fx, fy, cx, cy as a symmetric float64 matrix.

    Parameters
    ----------
    covariance : (P, P), or its P * P numbers row by row, P >= 4
    name : what messages call it

    Raises
    ------
    ShapeError
        If it is not square, symmetric, finite and positive semidefinite, or of fewer than four numbers.
    """
    values = as_floats(covariance, name)
    side = round(values.size**0.5)
    if side * side != values.size or side < 4 or (values.ndim > 1 and values.shape != (side, side)):
        raise ShapeError(
            f"{name}: {values.size} numbers; need a square: 16 of fx, fy, cx, cy, "
            "or (4 + n)^2 with n distortion coefficients"
        )
    matrix = as_matrix(values.reshape(side, side), (side, side), name)
    variances = matrix.diagonal()
    if not (variances.min() >= 0 and variances.max() < _LARGEST):
        worst = variances.min() if variances.min() < 0 else variances.max()
        raise ShapeError(f"{name}: a variance of {worst:g}; need 0 or more")
    # In units of standard deviations: those of focal lengths and coefficients differ by 10^6.
    scale = np.sqrt(np.outer(variances, variances))
    if not (np.abs(matrix - matrix.T) <= _ROUNDING * scale).all():
        raise ShapeError(f"{name}: not symmetric; need a covariance, row by row")
    matrix = (matrix + matrix.T) / 2
    known = np.where(scale > 0, scale, 1.0)
    if (
        not (np.abs(matrix) <= (1 + _ROUNDING) * scale).all()
        or np.linalg.eigvalsh(matrix / known).min() < -_ROUNDING * side
    ):
        raise ShapeError(f"{name}: not positive semidefinite; need a covariance")
    return np.asarray(matrix, np.float64)


@lru_cache(maxsize=16)
def covariance_factor(camera: Camera) -> Floats:
    """Return F with F F^T the covariance of the camera's numbers, (P, P); zeros where they are exact."""
    count = 4 + len(camera.distortion)
    return np.zeros((count, count)) if camera.covariance is None else factor_of(camera.covariance)


def factor_of(covariance: Floats) -> Floats:
    """Return F with F F^T a `covariance`, (P, P), but for eigenvalues that rounding made negative.

    Raises
    ------
    ShapeError
        If it is not square, or not finite.
    """
    covariance = as_floats(covariance, "covariance")
    if covariance.ndim != 2 or covariance.shape[0] != covariance.shape[1]:
        raise ShapeError(f"covariance: shape {covariance.shape}; need a square")
    if not np.abs(covariance).max(initial=0) < _LARGEST:
        raise ShapeError(f"covariance: up to {np.abs(covariance).max():g}; need that of a camera's numbers")
    variances = covariance.diagonal()
    scale = np.sqrt(np.where(variances > 0, variances, 1.0))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0)), np.float64)
