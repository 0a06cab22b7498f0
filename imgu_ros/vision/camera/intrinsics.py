# SPDX-License-Identifier: Apache-2.0
"""The calibrated camera: intrinsic matrix, lens distortion, projection and its inverse (IU 1.1.1-1.1.3, 8.1).

The distortion models are those of sensor_msgs/CameraInfo; see `imgu_ros.vision.camera.distortion`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Mask, Matrix3, Points, as_points, as_rows
from imgu_ros.vision.camera.distortion import distort, undistort
from imgu_ros.vision.camera.distortion_model import COEFFICIENTS, DistortionModel, as_coefficients, as_distortion_model
from imgu_ros.vision.camera.projection import as_intrinsic_matrix

__all__ = ["COEFFICIENTS", "Camera", "DistortionModel", "make_camera"]


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Intrinsics of a camera.

    Attributes
    ----------
    K : (3, 3) px
    distortion : (5,) for plumb_bob, (8,) for rational_polynomial, (12,) for thin_prism, (14,) for tilted, (4,) for
        equidistant; zeros: none
    model : the distortion model
    width, height : image size in px
    covariance : (4 + D, 4 + D) of fx, fy, cx, cy and the D numbers of `distortion`; None: taken as exact
    """

    K: Matrix3
    distortion: Floats
    model: DistortionModel
    width: int
    height: int
    covariance: Floats | None = None

    @property
    def is_distorted(self) -> bool:
        """Whether any distortion coefficient differs from 0 (an equidistant lens always distorts)."""
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
            If a point is not in front of the camera, or so far off its axis that the pixel is not finite.
        """
        return self.distort(_normalized(as_rows(points, 3, "points")))

    def project_with_jacobian(self, points: ArrayLike) -> tuple[Points, Floats]:
        """As `project`, and the derivative of each pixel by its point, (N, 2, 3)."""
        points = as_rows(points, 3, "points")
        xy = _normalized(points)
        z = points[:, 2]
        with np.errstate(over="ignore", invalid="ignore"):
            d_xy = np.zeros((len(points), 2, 3))
            d_xy[:, 0, 0] = d_xy[:, 1, 1] = 1 / z
            d_xy[:, :, 2] = -xy / z[:, None]
            by_point = self.K[:2, :2] @ d_xy
            if self.is_distorted:
                distorted, d_distorted = distort(self.model, self.distortion, xy)
                xy, by_point = distorted, self.K[:2, :2] @ d_distorted @ d_xy
            pixels = xy @ self.K[:2, :2].T + self.K[:2, 2]
        return _finite(pixels, "points"), _finite(by_point, "points")

    def distort(self, normalized: ArrayLike) -> Points:
        """Map ideal normalised coordinates (x / z, y / z), (N, 2), to raw pixels, (N, 2)."""
        xy = as_points(normalized, "normalized")
        if self.is_distorted:
            xy = distort(self.model, self.distortion, xy)[0]
        with np.errstate(over="ignore", invalid="ignore"):
            return _finite(xy @ self.K[:2, :2].T + self.K[:2, 2], "normalized")

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
        distorted = self._normalized_pixels(as_points(pixels, "pixels"), "pixels")
        if not self.is_distorted:
            return distorted, np.ones(len(distorted), bool)
        return undistort(self.model, self.distortion, distorted)

    def ideal_pixels(self, pixels: ArrayLike) -> tuple[Points, Mask]:
        """Map raw pixels to the pixels of a camera with the same K and no distortion; see `undistort`."""
        xy, valid = self.undistort(pixels)
        with np.errstate(over="ignore", invalid="ignore"):
            return _finite(xy @ self.K[:2, :2].T + self.K[:2, 2], "pixels"), valid

    def raw_pixels(self, ideal: ArrayLike) -> Points:
        """Map pixels of the distortion-free camera, (N, 2), to raw pixels: the inverse of `ideal_pixels`."""
        return self.distort(self._normalized_pixels(as_points(ideal, "ideal"), "ideal"))

    def _normalized_pixels(self, pixels: Points, name: str) -> Points:
        with np.errstate(over="ignore", invalid="ignore"):
            return _finite(np.linalg.solve(self.K[:2, :2], (pixels - self.K[:2, 2]).T).T, name)


def make_camera(K: ArrayLike, distortion: ArrayLike, model: DistortionModel | str, width: int, height: int) -> Camera:
    """Check intrinsics and build a `Camera`.

    Parameters
    ----------
    K : (3, 3) px, upper triangular with K[2, 2] = 1 and positive focal lengths
    distortion : coefficients, as many as the model has or fewer (the missing ones are 0)
    model : plumb_bob, rational_polynomial, thin_prism, tilted or equidistant
    width, height : px, positive

    Raises
    ------
    ShapeError
        If one of them does not describe a camera.

    Examples
    --------
    >>> camera = make_camera([[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], [-0.2, 0.05], "plumb_bob", 640, 480)
    >>> pixels = camera.project([[0.3, -0.1, 1.0]])
    >>> pixels.round(3).tolist()
    [[466.575, 190.475]]
    >>> camera.undistort(pixels)[0].round(6).tolist()
    [[0.3, -0.1]]
    """
    width = as_integer(width, "width")
    height = as_integer(height, "height")
    matrix = as_intrinsic_matrix(K).copy()
    if not (0 < width < math.inf and 0 < height < math.inf):
        raise ShapeError(f"camera size: {width} x {height}; need positive width and height")
    model = as_distortion_model(model)
    return Camera(matrix, as_coefficients(distortion, model).copy(), model, int(width), int(height))


def _normalized(points: Floats) -> Points:
    if len(points) and not points[:, 2].min() > 0:
        raise ShapeError(f"points: smallest z {points[:, 2].min():g}; need z > 0 (in front of the camera)")
    with np.errstate(over="ignore"):
        return _finite(points[:, :2] / points[:, 2:], "points")


def _finite(values: Floats, name: str) -> Floats:
    if not np.isfinite(values).all():
        raise ShapeError(f"{name}: overflow; need numbers of the size of a picture or a scene")
    return np.ascontiguousarray(values, np.float64)
