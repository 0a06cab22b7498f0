# SPDX-License-Identifier: Apache-2.0
"""Lens distortion: the models of sensor_msgs/CameraInfo, their derivatives, their inverse and its limit (IU 1.1.3).

All act on normalised coordinates x = X / Z, y = Y / Z. With r^2 = x^2 + y^2:

- `plumb_bob` (Brown 1966), coefficients k1 k2 p1 p2 k3: radial 1 + k1 r^2 + k2 r^4 + k3 r^6, tangential
  (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y);
- `rational_polynomial`, k1 k2 p1 p2 k3 k4 k5 k6: the radial part divided by 1 + k4 r^2 + k5 r^4 + k6 r^6;
- `thin_prism`, the same and s1 s2 s3 s4, and `tilted`, the same and tau_x tau_y: OpenCV's models of 12 and 14
  coefficients. Thin prism (Weng, Cohen & Herniou 1992): s1 r^2 + s2 r^4 is added to x, s3 r^2 + s4 r^4 to y. The tilt
  comes last (`imgu_ros.vision.camera.sensor_tilt`);
- `equidistant` (Kannala & Brandt 2006), k1 k2 k3 k4: with theta = atan r, the distorted radius is
  theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Mask, Matrix3, Points, as_points
from imgu_ros.vision.camera.distortion_model import DistortionModel, as_coefficients, as_distortion_model
from imgu_ros.vision.camera.sensor_tilt import tilt_derivatives, tilt_matrix

#: Most iterations of Newton's method: points near the fold of the model take many.
_MAX_STEPS = 50
_TOLERANCE = 1e-13  # normalised image units: below 1e-9 px for any real focal length
#: Bisections of an angle below a quarter turn until float64 resolves no further.
_BISECTIONS = 60
#: A tangential part moves the fold a little off its radius without it.
_FOLD_MARGIN = 1.2
#: Coefficients before those of the thin prism, and before the tilt's.
_PRISM, _TILT = 8, 12


@dataclass(frozen=True, slots=True, eq=False)
class DistortedPoints:
    """Distorted points and their derivatives.

    Attributes
    ----------
    xy : (N, 2) normalised
    by_xy : (N, 2, 2), by the ideal point
    by_coefficients : (N, 2, C), by the model's coefficients
    """

    xy: Points
    by_xy: Floats
    by_coefficients: Floats


def distort(model: DistortionModel | str, coefficients: ArrayLike, xy: ArrayLike) -> tuple[Points, Floats]:
    """Distort ideal normalised points `xy`, (N, 2); also return the derivative by them, (N, 2, 2).

    Raises
    ------
    ShapeError
        If the number of coefficients is not the model's, or a point is so far off the axis that the model overflows.

    Examples
    --------
    >>> distort("plumb_bob", [0.1, 0, 0, 0, 0], [[0.5, 0.0]])[0].round(6).tolist()  # 0.5 (1 + 0.1 * 0.25)
    [[0.5125, 0.0]]
    """
    model, k, xy = _checked(model, coefficients, xy)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        distorted, by_xy = _DISTORTED[model](k, xy)
    if not (np.isfinite(distorted).all() and np.isfinite(by_xy).all()):
        raise ShapeError(f"xy: the {model} model is not finite at {np.abs(xy).max():g}; need points nearer the axis")
    return distorted, by_xy


def distort_with_derivatives(model: DistortionModel | str, coefficients: ArrayLike, xy: ArrayLike) -> DistortedPoints:
    """As `distort`, of the same `model`, `coefficients` and `xy`, with the derivative by the coefficients as well."""
    model, k, xy = _checked(model, coefficients, xy)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        distorted, by_xy = _DISTORTED[model](k, xy)
        by_k = _equidistant_by_coefficients(xy) if model is DistortionModel.EQUIDISTANT else _by_coefficients(k, xy)
    if not (np.isfinite(distorted).all() and np.isfinite(by_xy).all() and np.isfinite(by_k).all()):
        raise ShapeError(f"xy: the {model} model is not finite at {np.abs(xy).max():g}; need points nearer the axis")
    return DistortedPoints(distorted, by_xy, by_k)


def undistort(model: DistortionModel | str, coefficients: ArrayLike, distorted: ArrayLike) -> tuple[Points, Mask]:
    """Remove the distortion of normalised points by Newton's method.

    Where Newton does not arrive from the distorted point itself, it starts again from the inverse of the radial part,
    found by bisection.

    Parameters
    ----------
    model, coefficients : of the lens
    distorted : (N, 2) distorted, normalised

    Returns
    -------
    xy : (N, 2) ideal
    valid : (N,) False where nothing within the model's range (`fold_radius`) is mapped to the point; such a row holds
        the distorted coordinates

    Examples
    --------
    >>> xy, valid = undistort("plumb_bob", [-0.5, 0, 0, 0, 0], [[0.5, 0.0], [0.6, 0.0]])
    >>> xy[0].round(6).tolist(), valid.tolist()  # r (1 - r^2 / 2) never exceeds 0.544
    ([0.618034, 0.0], [True, False])
    """
    model, k, distorted = _checked(model, coefficients, distorted)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        seen = np.ones(len(distorted), bool)
        given = distorted
        if model is DistortionModel.TILTED:
            # The tilt has an exact inverse.
            distorted, _ = _mapped(np.linalg.inv(tilt_matrix(*k[_TILT:])), distorted)
            seen = np.isfinite(distorted).all(axis=1)
            distorted[~seen] = 0.0
            model, k = DistortionModel.THIN_PRISM, k[:_TILT]
        if model is DistortionModel.EQUIDISTANT:
            # Start from the undistorted equidistant lens; r = tan(theta), kept below 90 degrees.
            theta = np.minimum(np.hypot(distorted[:, 0], distorted[:, 1]), 1.5)
            start = distorted * np.where(theta > 0, np.tan(theta) / np.where(theta > 0, theta, 1.0), 1.0)[:, None]
        else:
            start = distorted.copy()
        xy, valid = _newton(model, k, distorted, start)
        farthest = _FOLD_MARGIN * fold_radius(model, k)
        valid &= np.hypot(xy[:, 0], xy[:, 1]) <= farthest
        missed = ~valid
        if missed.any():
            again, found = _newton(model, k, distorted[missed], _radial_inverse(model, k, distorted[missed]))
            found &= np.hypot(again[:, 0], again[:, 1]) <= farthest
            xy[missed], valid[missed] = again, found
        valid &= seen
    xy[~valid] = given[~valid]
    return xy, valid


def fold_radius(model: DistortionModel | str, coefficients: ArrayLike) -> float:
    """Return the ideal radius r = tan(theta) at which the radial part stops growing; inf when it never does.

    Beyond it a model with these `coefficients` is no lens any more: two rays share one pixel, there is no inverse.

    Examples
    --------
    >>> round(fold_radius("plumb_bob", [-0.5, 0, 0, 0, 0]), 6), fold_radius("plumb_bob", [0.1, 0, 0, 0, 0])
    (0.816497, inf)
    """
    model, k, _ = _checked(model, coefficients, np.zeros((0, 2)))
    return _fold_radius(model, tuple(k.tolist()))


@functools.lru_cache(maxsize=64)
def _fold_radius(model: DistortionModel, k: tuple[float, ...]) -> float:
    """Find the first zero of the slope of the radial part, or pole of it, in s = r^2 (or theta^2)."""
    if model is DistortionModel.EQUIDISTANT:
        theta = math.sqrt(_first_root([1, 3 * k[0], 5 * k[1], 7 * k[2], 9 * k[3]]))
        return math.tan(theta) if theta < math.pi / 2 else math.inf
    k4, k5, k6 = k[5:8] if len(k) > 5 else (0.0, 0.0, 0.0)
    N, D = np.polynomial.Polynomial([1, k[0], k[1], k[4]]), np.polynomial.Polynomial([1, k4, k5, k6])
    s = np.polynomial.Polynomial([0, 1])
    with np.errstate(over="ignore", invalid="ignore"):
        slope = N * D + 2 * s * (N.deriv() * D - N * D.deriv())
    return math.sqrt(min(_first_root(slope.coef), _first_root(D.coef)))


def _first_root(ascending: ArrayLike) -> float:
    """Return the smallest positive real root of a polynomial; inf when there is none."""
    coefficients = np.asarray(ascending, np.float64)
    if not np.isfinite(coefficients).all():
        return math.inf
    coefficients = np.trim_zeros(coefficients, "b")
    try:
        with np.errstate(all="ignore"):
            roots = np.roots(coefficients[::-1])
    except np.linalg.LinAlgError:
        return math.inf  # coefficients apart by 1e300
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(real.min()) if real.size else math.inf


def _checked(
    model: DistortionModel | str, coefficients: ArrayLike, xy: ArrayLike
) -> tuple[DistortionModel, Floats, Points]:
    model = as_distortion_model(model)
    k = as_coefficients(coefficients, model)
    return model, k, as_points(xy, "xy")


def _distort_polynomial(k: Floats, xy: Points) -> tuple[Points, Floats]:
    x, y = xy.T
    k1, k2, p1, p2, k3 = k[:5]
    k4, k5, k6 = k[5:8] if len(k) > 5 else (0.0, 0.0, 0.0)
    r2 = x * x + y * y
    numerator = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    denominator = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = numerator / denominator
    # d radial / d r2
    slope = (k1 + r2 * (2 * k2 + 3 * k3 * r2) - radial * (k4 + r2 * (2 * k5 + 3 * k6 * r2))) / denominator
    distorted = np.column_stack(
        (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )
    )
    jacobian = np.empty((len(xy), 2, 2))
    jacobian[:, 0, 0] = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    jacobian[:, 1, 1] = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    if len(k) > _PRISM:
        first, second = k[[8, 10]], k[[9, 11]]
        distorted += r2[:, None] * first + (r2 * r2)[:, None] * second
        jacobian += 2 * (first + 2 * r2[:, None] * second)[:, :, None] * xy[:, None, :]
    if len(k) > _TILT:
        distorted, by_flat = _mapped(tilt_matrix(*k[_TILT:]), distorted)
        jacobian = by_flat @ jacobian
    return distorted, jacobian


def _mapped(T: Matrix3, xy: Points) -> tuple[Points, Floats]:
    """Map points by a homography; also return the derivative, (N, 2, 2). Both are NaN where w is not positive."""
    mapped = np.column_stack((xy, np.ones(len(xy)))) @ T.T
    w = np.where(mapped[:, 2:] > 0, mapped[:, 2:], np.nan)
    to = mapped[:, :2] / w
    return to, (T[:2, :2] - to[:, :, None] * T[2, :2]) / w[:, :, None]


def _by_coefficients(k: Floats, xy: Points) -> Floats:
    x, y = xy.T
    r2 = x * x + y * y
    powers = np.stack((r2, r2**2, r2**3), axis=1)
    denominator = 1 + powers @ k[5:8] if len(k) > 5 else np.ones(len(xy))
    radial = (1 + powers @ k[[0, 1, 4]]) / denominator
    by_k = np.zeros((len(xy), 2, len(k)))
    by_k[:, :, [0, 1, 4]] = xy[:, :, None] * (powers / denominator[:, None])[:, None, :]
    by_k[:, 0, 2] = by_k[:, 1, 3] = 2 * x * y
    by_k[:, 0, 3] = r2 + 2 * x * x
    by_k[:, 1, 2] = r2 + 2 * y * y
    if len(k) > 5:
        by_k[:, :, 5:8] = -xy[:, :, None] * (powers * (radial / denominator)[:, None])[:, None, :]
    if len(k) > _PRISM:
        by_k[:, 0, 8:10] = by_k[:, 1, 10:12] = powers[:, :2]
    if len(k) > _TILT:
        flat, _ = _distort_polynomial(k[:_TILT], xy)
        T = tilt_matrix(*k[_TILT:])
        distorted, by_flat = _mapped(T, flat)
        by_k[:, :, :_TILT] = by_flat @ by_k[:, :, :_TILT]
        homogeneous = np.column_stack((flat, np.ones(len(xy))))
        by_tilt = homogeneous @ np.swapaxes(tilt_derivatives(*k[_TILT:]), 1, 2)
        by_k[:, :, _TILT:] = np.moveaxis(
            (by_tilt[:, :, :2] - distorted * by_tilt[:, :, 2:]) / (homogeneous @ T[2])[:, None], 0, 2
        )
    return by_k


def _distort_equidistant(k: Floats, xy: Points) -> tuple[Points, Floats]:
    r = np.hypot(xy[:, 0], xy[:, 1])
    theta = np.arctan(r)
    t2 = theta * theta
    distorted_theta = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    d_theta = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
    # Near the axis both ratios are replaced by their limits: distorted_theta / r = 1 + (k1 - 1/3) r^2 + O(r^4).
    near = r < 1e-6
    safe = np.where(near, 1.0, r)
    scale = np.where(near, 1.0, distorted_theta / safe)
    slope = np.where(near, 2 * (k[0] - 1 / 3), (d_theta / (1 + r * r) - scale) / (safe * safe))
    jacobian = scale[:, None, None] * np.eye(2) + slope[:, None, None] * xy[:, :, None] * xy[:, None, :]
    return xy * scale[:, None], jacobian


def _equidistant_by_coefficients(xy: Points) -> Floats:
    r = np.hypot(xy[:, 0], xy[:, 1])
    theta = np.arctan(r)
    direction = xy / np.where(r > 0, r, 1.0)[:, None]
    return np.asarray(direction[:, :, None] * theta[:, None, None] ** np.array([3.0, 5.0, 7.0, 9.0]), np.float64)


_DISTORTED = {
    DistortionModel.PLUMB_BOB: _distort_polynomial,
    DistortionModel.RATIONAL_POLYNOMIAL: _distort_polynomial,
    DistortionModel.THIN_PRISM: _distort_polynomial,
    DistortionModel.TILTED: _distort_polynomial,
    DistortionModel.EQUIDISTANT: _distort_equidistant,
}


def _newton(model: DistortionModel, k: Floats, distorted: Points, start: Points) -> tuple[Points, Mask]:
    xy = start
    done = np.zeros(len(distorted), bool)
    scale = np.maximum(1.0, np.abs(distorted).max(axis=1, initial=0.0))
    for _ in range(_MAX_STEPS):
        value, jacobian = _DISTORTED[model](k, xy)
        error = distorted - value
        determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
        # A point beyond the fold of the lens model (determinant <= 0) has no inverse.
        regular = (determinant > 1e-9) & np.isfinite(determinant)
        done = regular & (np.abs(error).max(axis=1) <= _TOLERANCE * scale)
        active = regular & ~done
        if not active.any():
            break
        step = np.linalg.solve(jacobian[active], error[active][:, :, None])[:, :, 0]
        # Half a radian a step at most keeps Newton on the branch that contains the axis.
        length = np.hypot(step[:, 0], step[:, 1])
        xy[active] += step * np.minimum(1.0, 0.5 / np.maximum(length, 0.5))[:, None]
    xy[~done] = distorted[~done]
    return xy, done


def _radial_inverse(model: DistortionModel, k: Floats, distorted: Points) -> Points:
    """Invert the radial part alone, by bisection between the axis and the fold (or 89.9 degrees off the axis)."""
    radius = np.hypot(distorted[:, 0], distorted[:, 1])
    # Bisected in the angle off the axis: finite where r is not.
    low = np.zeros(len(distorted))
    high = np.full(len(distorted), min(math.atan(fold_radius(model, k)) * (1 - 1e-6), math.radians(89.9)))
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        along_x = np.column_stack((np.tan(middle), np.zeros(len(distorted))))
        below = _DISTORTED[model](_without_tangential(model, k), along_x)[0][:, 0] < radius
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return distorted * (np.tan(low) / np.where(radius > 0, radius, 1.0))[:, None]


def _without_tangential(model: DistortionModel, k: Floats) -> Floats:
    if model is DistortionModel.EQUIDISTANT:
        return k
    radial = k[:_PRISM].copy()
    radial[2:4] = 0.0
    return radial
