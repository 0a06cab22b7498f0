# SPDX-License-Identifier: Apache-2.0
"""A sensor that does not stand across the lens's axis: the tilt of OpenCV's model of 14 coefficients (IU 1.1.3).

A tilt is a homography of the normalised image plane that leaves the axis where it is (Scheimpflug; Louhichi, Fournel,
Lavest & Ben Aissia 2007).
"""

from __future__ import annotations

import math

import numpy as np

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Matrix3

#: Smallest cosine of the sensor's tilt: below, the sensor is edge on.
_EDGE_ON = 1e-6


def tilt_matrix(tau_x: float, tau_y: float) -> Matrix3:
    """Return the homography, (3, 3), of a sensor turned by `tau_x` about x, then `tau_y` about y, rad.

    Raises
    ------
    ShapeError
        If the light would fall on the sensor from the side or from behind.

    Examples
    --------
    >>> tilt_matrix(0.0, 0.0).tolist() == np.eye(3).tolist()
    True
    >>> tilt_matrix(0.1, -0.05)[:2, 2].tolist()  # the axis stays
    [0.0, 0.0]
    """
    tau_x, tau_y = as_number(tau_x, "tau_x"), as_number(tau_y, "tau_y")
    finite = math.isfinite(tau_x) and math.isfinite(tau_y)
    R = _turn_y(tau_y) @ _turn_x(tau_x) if finite else np.zeros((3, 3))
    if not R[2, 2] > _EDGE_ON:
        raise ShapeError(f"tau_x, tau_y: {tau_x:g}, {tau_y:g} rad; need a sensor that faces the lens")
    tilted = _along_axis(R, 1.0) @ R
    tilted[:2, 2] = 0.0  # but for rounding
    return tilted


def tilt_derivatives(tau_x: float, tau_y: float) -> Floats:
    """Return the derivatives of `tilt_matrix` by `tau_x` and by `tau_y`, (2, 3, 3); errors as there."""
    tilt_matrix(tau_x, tau_y)
    about_x, about_y = _turn_x(tau_x), _turn_y(tau_y)
    R = about_y @ about_x
    # A turn about an axis changes as one by a quarter turn more, but for the axis itself.
    by_x = about_y @ (_turn_x(tau_x + math.pi / 2) - np.diag((1.0, 0.0, 0.0)))
    by_y = (_turn_y(tau_y + math.pi / 2) - np.diag((0.0, 1.0, 0.0))) @ about_x
    derivatives = np.stack([_along_axis(by, 0.0) @ R + _along_axis(R, 1.0) @ by for by in (by_x, by_y)])
    derivatives[:, :2, 2] = 0.0
    return derivatives


def _turn_x(angle: float) -> Matrix3:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]])


def _turn_y(angle: float) -> Matrix3:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


def _along_axis(R: Matrix3, one: float) -> Matrix3:
    """Return what projects the turned plane along the axis; with `one` 0 its derivative."""
    return np.array([[R[2, 2], 0, -R[0, 2]], [0, R[2, 2], -R[1, 2]], [0, 0, one]])
