# SPDX-License-Identifier: Apache-2.0
"""The names of the lens distortion models and of their coefficients, as in sensor_msgs/CameraInfo (IU 1.1.3)."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats


class DistortionModel(StrEnum):
    """Lens distortion models, named as in sensor_msgs/CameraInfo, and OpenCV's two longer ones.

    sensor_msgs/CameraInfo has no names of its own for `thin_prism` and `tilted`: messages and files call them
    `rational_polynomial`, with 12 and 14 coefficients.
    """

    PLUMB_BOB = "plumb_bob"
    RATIONAL_POLYNOMIAL = "rational_polynomial"
    THIN_PRISM = "thin_prism"
    TILTED = "tilted"
    EQUIDISTANT = "equidistant"


#: Number of coefficients of each model.
COEFFICIENTS = {
    DistortionModel.PLUMB_BOB: 5,
    DistortionModel.RATIONAL_POLYNOMIAL: 8,
    DistortionModel.THIN_PRISM: 12,
    DistortionModel.TILTED: 14,
    DistortionModel.EQUIDISTANT: 4,
}

_RATIONAL_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_PRISM_NAMES = (*_RATIONAL_NAMES, "s1", "s2", "s3", "s4")

#: The coefficients' names, in order.
COEFFICIENT_NAMES = {
    DistortionModel.PLUMB_BOB: _RATIONAL_NAMES[:5],
    DistortionModel.RATIONAL_POLYNOMIAL: _RATIONAL_NAMES,
    DistortionModel.THIN_PRISM: _PRISM_NAMES,
    DistortionModel.TILTED: (*_PRISM_NAMES, "tau_x", "tau_y"),
    DistortionModel.EQUIDISTANT: ("k1", "k2", "k3", "k4"),
}


def as_distortion_model(model: DistortionModel | str) -> DistortionModel:
    """Return the model of that name; ShapeError lists the names when there is none."""
    try:
        return DistortionModel(model)
    except ValueError:
        raise ShapeError(f"distortion model: {str(model)!r}; need one of {', '.join(DistortionModel)}") from None


def as_coefficients(coefficients: ArrayLike, model: DistortionModel) -> Floats:
    """Return coefficients as a float64 array of the model's length; those that are not given are 0.

    Raises
    ------
    ShapeError
        If there are too many, or one is not a finite number.
    """
    model = as_distortion_model(model)
    try:
        raw = np.asarray(coefficients)
        given = raw.astype(np.float64).ravel() if raw.dtype.kind in "biufO" else None
    except (TypeError, ValueError, OverflowError):
        given = None
    if given is None:
        raise ShapeError(f"distortion: {type(coefficients).__name__}; need numbers")
    if len(given) == COEFFICIENTS[model] and np.isfinite(given).all():
        return given
    if len(given) > COEFFICIENTS[model] or not np.isfinite(given).all():
        raise ShapeError(f"distortion: {given.tolist()}; need at most {COEFFICIENTS[model]} finite numbers for {model}")
    whole = np.zeros(COEFFICIENTS[model])
    whole[: len(given)] = given
    return whole
