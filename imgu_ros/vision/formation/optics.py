# SPDX-License-Identifier: Apache-2.0
"""A thin lens: focus, circle of confusion, depth of field (IU 1.1.3-1.1.4; Szeliski 2022, 2.2.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_number, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, as_floats


@dataclass(frozen=True, slots=True)
class ThinLens:
    """A lens without thickness or aberrations, focused at one distance.

    Attributes
    ----------
    focal_length_m : distance of the image of an infinitely far point; > 0
    f_number : focal length over aperture diameter; > 0
    focus_m : distance, from the lens, of what is sharp; above the focal length; may be infinite

    Examples
    --------
    A 50 mm lens at f/2, focused at 2 m:

    >>> lens = ThinLens(0.050, 2.0, 2.0)
    >>> round(lens.aperture_m * 1e3, 3), round(lens.image_distance_m * 1e3, 3)
    (25.0, 51.282)
    """

    focal_length_m: float
    f_number: float
    focus_m: float = math.inf

    def __post_init__(self) -> None:
        """Raise ShapeError when a value is out of range."""
        _positive(self.focal_length_m, "focal_length_m", "m")
        _positive(self.f_number, "f_number")
        if not self.focus_m > self.focal_length_m:
            raise ShapeError(f"focus_m: {self.focus_m:g} m; need more than the focal length, {self.focal_length_m:g} m")

    @property
    def aperture_m(self) -> float:
        """Diameter of the aperture: focal length over f-number."""
        return self.focal_length_m / self.f_number

    @property
    def image_distance_m(self) -> float:
        """Distance from the lens to the sensor: 1 / focal length = 1 / focus + 1 / image distance.

        Over the pixel pitch it is what the matrix K calls the focal length, in pixels.
        """
        return self.focal_length_m / (1 - self.focal_length_m / self.focus_m)

    @property
    def magnification(self) -> float:
        """Size of the image over the size of what is in focus; 0 at infinity."""
        return self.image_distance_m / self.focus_m


@dataclass(frozen=True, slots=True)
class DepthOfField:
    """The distances between which nothing is blurred by more than the accepted circle.

    Attributes
    ----------
    near_m : m
    far_m : m; infinite when the lens is focused at its hyperfocal distance or beyond
    """

    near_m: float
    far_m: float


def circle_of_confusion(lens: ThinLens, depth_m: ArrayLike) -> Floats:
    """Return the diameter of the disc on the sensor that a point becomes.

    By similar triangles: c = A v |1/s - 1/d|, with aperture A, image distance v, focus s and depth d; in the usual
    form, c = A f |d - s| / (d (s - f)).

    Parameters
    ----------
    lens : with its focus
    depth_m : distances of points from the lens, any shape; > 0, may be infinite

    Returns
    -------
    m, the shape of `depth_m`

    Raises
    ------
    ShapeError
        If a depth is not positive or not a number.

    Examples
    --------
    >>> lens = ThinLens(0.050, 2.0, 2.0)
    >>> (circle_of_confusion(lens, [1.0, 2.0, 4.0]) * 1e3).round(4).tolist()
    [0.641, 0.0, 0.3205]
    """
    require_type(lens, ThinLens, "lens")
    depth = as_floats(depth_m, "depth_m")
    if not (depth > 0).all():
        raise ShapeError("depth_m: a value is 0, negative or no number; need distances > 0")
    with np.errstate(over="ignore"):
        nearness = 1 / depth  # of a subnormal depth: infinite
    circle = lens.aperture_m * lens.image_distance_m * np.abs(1 / lens.focus_m - nearness)
    if not np.isfinite(circle).all():
        raise ShapeError(f"depth_m: {depth.min():g} m; need distances of at least a femtometre")
    return np.asarray(circle, np.float64)


def hyperfocal_distance(focal_length_m: float, f_number: float, circle_m: float) -> float:
    """Return the nearest focus with which infinity is acceptably sharp: f^2 / (N c) + f, m.

    Parameters
    ----------
    focal_length_m, f_number : of the lens; > 0
    circle_m : diameter of the largest acceptable circle of confusion; > 0

    Raises
    ------
    ShapeError
        If a value is not positive.

    Examples
    --------
    >>> round(hyperfocal_distance(0.050, 8.0, 30e-6), 3)
    10.467
    """
    focal_length_m = as_number(focal_length_m, "focal_length_m")
    f_number = as_number(f_number, "f_number")
    circle_m = as_number(circle_m, "circle_m")
    lens = ThinLens(focal_length_m, f_number)
    distance = lens.aperture_m * focal_length_m / _positive(circle_m, "circle_m", "m") + focal_length_m
    if not math.isfinite(distance):
        raise ShapeError(f"focal_length_m: {focal_length_m:g}; need the focal length of a lens")
    return distance


def depth_of_field(lens: ThinLens, circle_m: float) -> DepthOfField:
    """Return the distances at which the circle of confusion is just the acceptable one.

    Solving `circle_of_confusion` for the depth: 1/d = 1/s +- c / (A v).

    Parameters
    ----------
    lens : with its focus
    circle_m : diameter of the largest acceptable circle, m; often one or two pixels, or the sensor's diagonal / 1500

    Raises
    ------
    ShapeError
        If the circle is not positive.

    Examples
    --------
    >>> field = depth_of_field(ThinLens(0.050, 8.0, 5.0), 30e-6)
    >>> round(field.near_m, 3), round(field.far_m, 3)
    (3.389, 9.527)
    """
    require_type(lens, ThinLens, "lens")
    circle_m = as_number(circle_m, "circle_m")
    reach = _positive(circle_m, "circle_m", "m") / (lens.aperture_m * lens.image_distance_m)
    near, far = 1 / lens.focus_m + reach, 1 / lens.focus_m - reach
    # At the hyperfocal distance the two terms are equal but for rounding.
    return DepthOfField(1 / near, 1 / far if far > 1e-12 * reach else math.inf)


def disc_kernel(diameter_px: float) -> Image:
    """Return the point-spread function of a defocused lens: a uniform disc, each pixel weighted by its covered area.

    Parameters
    ----------
    diameter_px : circle of confusion over the pixel pitch; 0 to 1000

    Returns
    -------
    (2 r + 1, 2 r + 1) float32, sum 1; a diameter of 0 gives one pixel

    Raises
    ------
    ShapeError
        If the diameter is out of range.

    Examples
    --------
    >>> disc_kernel(2.0).astype(float).round(3).tolist()
    [[0.025, 0.145, 0.025], [0.145, 0.318, 0.145], [0.025, 0.145, 0.025]]
    """
    diameter_px = as_number(diameter_px, "diameter_px")
    if not 0 <= diameter_px <= 1000:
        raise ShapeError(f"diameter_px: {diameter_px:g}; need 0 to 1000 px")
    radius = diameter_px / 2
    reach = max(0, math.ceil(radius - 0.5))
    if radius <= 0.5:
        return np.ones((1, 1), np.float32)  # the disc lies within one pixel
    # Chords of the disc across narrow columns, cut to each row.
    x = (np.arange((2 * reach + 1) * _CHORDS) + 0.5) / _CHORDS - reach - 0.5
    half = np.sqrt(np.maximum(radius**2 - x**2, 0))
    edges = np.arange(2 * reach + 2) - reach - 0.5
    below = np.clip(edges[:, None], -half, half)
    kernel = np.diff(below, axis=0).reshape(2 * reach + 1, 2 * reach + 1, _CHORDS).mean(axis=2)
    kernel = (kernel + kernel.T) / 2  # the disc is symmetric; its integration by columns only nearly so
    return np.asarray(kernel / kernel.sum(), np.float32)


_CHORDS = 64


def _positive(value: float, name: str, unit: str = "") -> float:
    if not (isinstance(value, int | float | np.number) and math.isfinite(value) and value > 0):
        shown = f"{value:g}" if isinstance(value, int | float) else repr(value)
        raise ShapeError(f"{name}: {shown}; need more than 0{' ' + unit if unit else ''}")
    return float(value)
