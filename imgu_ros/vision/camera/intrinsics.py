"""The calibrated camera: intrinsic matrix, lens distortion, projection and its inverse.

Sources: notes 8.1.1-8.1.4; the distortion models are those of sensor_msgs/CameraInfo and of OpenCV's calib3d:
`plumb_bob` (Brown 1966: k1 k2 p1 p2 k3), `rational_polynomial` (k1 k2 p1 p2 k3 k4 k5 k6) and `equidistant`
(Kannala & Brandt 2006: k1 k2 k3 k4).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Mask, Matrix3, Points, as_matrix, as_points, as_rows


class DistortionModel(StrEnum):
    """Lens distortion models, named as in sensor_msgs/CameraInfo."""

    PLUMB_BOB = "plumb_bob"
    RATIONAL_POLYNOMIAL = "rational_polynomial"
    EQUIDISTANT = "equidistant"


#: Number of coefficients of each model.
COEFFICIENTS = {
    DistortionModel.PLUMB_BOB: 5,
    DistortionModel.RATIONAL_POLYNOMIAL: 8,
    DistortionModel.EQUIDISTANT: 4,
}

_MAX_STEPS = 50
_TOLERANCE = 1e-12  # normalised image units: below 1e-8 px for any real focal length


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Intrinsics of a camera.

    Attributes
    ----------
    K : (3, 3) px
    distortion : (5,) for plumb_bob, (8,) for rational_polynomial, (4,) for equidistant; zeros: none
    model : the distortion model
    width, height : image size in px
    """

    K: Matrix3
    distortion: Floats
    model: DistortionModel
    width: int
    height: int

    @property
    def is_distorted(self) -> bool:
        """Whether any distortion coefficient differs from 0 (an equidistant lens always bends)."""
        return self.model is DistortionModel.EQUIDISTANT or bool(np.any(self.distortion))

    def project(self, points: ArrayLike) -> Points:
        """Project points of the camera's frame into the raw image.

        Parameters
        ----------
        points : (N, 3) m, z > 0

        Returns
        -------
        (N, 2) px

        Raises
        ------
        ShapeError
            If a point is not in front of the camera.
        """
        return self.distort(_normalized(as_rows(points, 3, "points")))

    def project_with_jacobian(self, points: ArrayLike) -> tuple[Points, Floats]:
        """As `project`, and the derivative of each pixel by its point, (N, 2, 3)."""
        points = as_rows(points, 3, "points")
        xy = _normalized(points)
        z = points[:, 2]
        d_xy = np.zeros((len(points), 2, 3))
        d_xy[:, 0, 0] = d_xy[:, 1, 1] = 1 / z
        d_xy[:, :, 2] = -xy / z[:, None]
        if not self.is_distorted:
            return xy @ self.K[:2, :2].T + self.K[:2, 2], self.K[:2, :2] @ d_xy
        bent, d_bent = _bend(self.model, self.distortion, xy)
        return bent @ self.K[:2, :2].T + self.K[:2, 2], self.K[:2, :2] @ d_bent @ d_xy

    def distort(self, normalized: ArrayLike) -> Points:
        """Map ideal normalised coordinates (x / z, y / z), (N, 2), to raw pixels, (N, 2)."""
        xy = as_points(normalized, "normalized")
        if self.is_distorted:
            xy = _bend(self.model, self.distortion, xy)[0]
        return xy @ self.K[:2, :2].T + self.K[:2, 2]

    def undistort(self, pixels: ArrayLike) -> tuple[Points, Mask]:
        """Map raw pixels to ideal normalised coordinates, by Newton's method on the distortion.

        Parameters
        ----------
        pixels : (N, 2) px

        Returns
        -------
        normalized : (N, 2) x / z, y / z
        valid : (N,) False where the lens model has no inverse; such a row holds the distorted coordinates
        """
        pixels = as_points(pixels, "pixels")
        bent = np.asarray(np.linalg.solve(self.K[:2, :2], (pixels - self.K[:2, 2]).T).T, np.float64)
        if not self.is_distorted:
            return bent, np.ones(len(pixels), bool)
        return _unbend(self.model, self.distortion, bent)

    def ideal_pixels(self, pixels: ArrayLike) -> tuple[Points, Mask]:
        """Map raw pixels to the pixels of a camera with the same K and no distortion; see `undistort`."""
        xy, valid = self.undistort(pixels)
        return xy @ self.K[:2, :2].T + self.K[:2, 2], valid

    def raw_pixels(self, ideal: ArrayLike) -> Points:
        """Map pixels of the distortion-free camera, (N, 2), to raw pixels: the inverse of `ideal_pixels`."""
        ideal = as_points(ideal, "ideal")
        return self.distort(np.linalg.solve(self.K[:2, :2], (ideal - self.K[:2, 2]).T).T)


def make_camera(K: ArrayLike, distortion: ArrayLike, model: DistortionModel | str, width: int, height: int) -> Camera:
    """Check intrinsics and build a `Camera`.

    Parameters
    ----------
    K : (3, 3) px, upper triangular with K[2, 2] = 1 and positive focal lengths
    distortion : coefficients, as many as the model has or fewer (the missing ones are 0)
    model : plumb_bob, rational_polynomial or equidistant
    width, height : px, positive

    Raises
    ------
    ShapeError
        If one of them does not describe a camera.
    """
    matrix = as_matrix(K, (3, 3), "K").copy()
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and matrix[1, 0] == 0 and np.array_equal(matrix[2], (0, 0, 1))):
        raise ShapeError(f"K: {matrix.tolist()}; need [[fx > 0, s, cx], [0, fy > 0, cy], [0, 0, 1]]")
    if width <= 0 or height <= 0:
        raise ShapeError(f"camera size: {width} x {height}; need positive width and height")
    try:
        model = DistortionModel(model)
    except ValueError:
        raise ShapeError(f"distortion model: {str(model)!r}; need one of {', '.join(DistortionModel)}") from None
    given = np.asarray(distortion, dtype=np.float64).ravel()
    if len(given) > COEFFICIENTS[model] or not np.isfinite(given).all():
        raise ShapeError(f"distortion: {given.tolist()}; need at most {COEFFICIENTS[model]} finite numbers for {model}")
    coefficients = np.zeros(COEFFICIENTS[model])
    coefficients[: len(given)] = given
    return Camera(matrix, coefficients, model, int(width), int(height))


def _normalized(points: Floats) -> Points:
    if len(points) and not points[:, 2].min() > 0:
        raise ShapeError(f"points: smallest z {points[:, 2].min():g}; need z > 0 (in front of the camera)")
    return np.ascontiguousarray(points[:, :2] / points[:, 2:])


def _bend(model: DistortionModel, k: Floats, xy: Points) -> tuple[Points, Floats]:
    """Distort normalised points (N, 2); also return the Jacobian (N, 2, 2)."""
    return _bend_equidistant(k, xy) if model is DistortionModel.EQUIDISTANT else _bend_polynomial(k, xy)


def _bend_polynomial(k: Floats, xy: Points) -> tuple[Points, Floats]:
    x, y = xy.T
    k1, k2, p1, p2, k3 = k[:5]
    k4, k5, k6 = k[5:8] if len(k) > 5 else (0.0, 0.0, 0.0)
    r2 = x * x + y * y
    numerator = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    denominator = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = numerator / denominator
    # d radial / d r2
    slope = (k1 + r2 * (2 * k2 + 3 * k3 * r2) - radial * (k4 + r2 * (2 * k5 + 3 * k6 * r2))) / denominator
    bent = np.column_stack(
        (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )
    )
    jacobian = np.empty((len(xy), 2, 2))
    jacobian[:, 0, 0] = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    jacobian[:, 1, 1] = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    return bent, jacobian


def _bend_equidistant(k: Floats, xy: Points) -> tuple[Points, Floats]:
    r = np.hypot(xy[:, 0], xy[:, 1])
    theta = np.arctan(r)
    t2 = theta * theta
    bent_theta = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    d_theta = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
    # Near the axis both ratios are replaced by their limits: bent_theta / r = 1 + (k1 - 1/3) r^2 + O(r^4).
    near = r < 1e-6
    safe = np.where(near, 1.0, r)
    scale = np.where(near, 1.0, bent_theta / safe)
    slope = np.where(near, 2 * (k[0] - 1 / 3), (d_theta / (1 + r * r) - scale) / (safe * safe))
    jacobian = scale[:, None, None] * np.eye(2) + slope[:, None, None] * xy[:, :, None] * xy[:, None, :]
    return xy * scale[:, None], jacobian


def _unbend(model: DistortionModel, k: Floats, bent: Points) -> tuple[Points, Mask]:
    if model is DistortionModel.EQUIDISTANT:
        # Start from the undistorted equidistant lens; r = tan(theta), kept below 90 degrees.
        theta = np.minimum(np.hypot(bent[:, 0], bent[:, 1]), 1.5)
        xy = bent * np.where(theta > 0, np.tan(theta) / np.where(theta > 0, theta, 1.0), 1.0)[:, None]
    else:
        xy = bent.copy()
    done = np.zeros(len(bent), bool)
    for _ in range(_MAX_STEPS):
        value, jacobian = _bend(model, k, xy)
        error = bent - value
        determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
        # A point beyond the fold of the lens model (determinant <= 0) has no inverse.
        regular = determinant > 1e-9
        scale = np.maximum(1.0, np.abs(bent).max(axis=1))
        done = regular & (np.abs(error).max(axis=1) <= _TOLERANCE * scale)
        active = regular & ~done
        if not active.any():
            break
        step = np.linalg.solve(jacobian[active], error[active][:, :, None])[:, :, 0]
        # Half a radian a step at most keeps Newton on the branch that contains the axis.
        length = np.hypot(step[:, 0], step[:, 1])
        xy[active] += step * np.minimum(1.0, 0.5 / np.maximum(length, 0.5))[:, None]
    xy[~done] = bent[~done]
    return xy, done
