# SPDX-License-Identifier: Apache-2.0
"""The shutter: exposure, motion blur, rolling rows (IU 1.1.5-1.1.6; Szeliski 2022, 2.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Points, as_floats, as_matrix, as_points

_LONGEST_PX = 1000.0


@dataclass(frozen=True, slots=True)
class Exposure:
    """How much light a camera takes, and how strongly it is amplified.

    Attributes
    ----------
    time_s : for which the shutter is open; > 0
    f_number : focal length over aperture diameter; > 0
    iso : sensitivity (ISO 12232); twice the number, twice the signal; > 0

    Examples
    --------
    Two stops wider, a fourth of the time: the same picture.

    >>> sunny, action = Exposure(1 / 125, 16.0), Exposure(1 / 500, 8.0)
    >>> round(sunny.value, 2), round(action.brightness_over(sunny), 3)
    (14.97, 1.0)
    """

    time_s: float
    f_number: float
    iso: float = 100.0

    def __post_init__(self) -> None:
        """Raise ShapeError when a value is not positive."""
        for name in ("time_s", "f_number", "iso"):
            value = as_number(getattr(self, name), name)
            if not (1e-12 <= value <= 1e12):
                raise ShapeError(f"{name}: {value:g}; need a number above 0 (1e-12 to 1e12)")

    @property
    def value(self) -> float:
        """Exposure value, log2(N^2 / t) - log2(ISO / 100): one more is half the brightness (ISO 2720)."""
        return math.log2(self.f_number**2 / self.time_s) - math.log2(self.iso / 100)

    def brightness_over(self, reference: Exposure) -> float:
        """Return how many times brighter the picture gets than with `reference`; proportional to t ISO / N^2."""
        return math.exp2(reference.value - self.value)


def motion_kernel(velocity_px_s: ArrayLike, time_s: float) -> Image:
    """Return the point-spread function of an image that moves evenly while the shutter is open.

    A line of length |velocity| x time about the centre: filtering with it is the mean, over the exposure, of the image
    shifted by linear interpolation. Exact: between grid lines the weights are quadratic along the line, and Simpson's
    rule integrates them.

    Parameters
    ----------
    velocity_px_s : (2,) x and y, px/s
    time_s : exposure time, >= 0; the line may be 1000 px long

    Returns
    -------
    (2 ry + 1, 2 rx + 1) float32, sum 1, point-symmetric, so that the picture stays that of mid-exposure

    Raises
    ------
    ShapeError
        If the velocity is not two finite numbers, or the line too long.

    Examples
    --------
    >>> motion_kernel([300.0, 0.0], 0.01).astype(float).round(4).tolist()
    [[0.0417, 0.2917, 0.3333, 0.2917, 0.0417]]
    """
    time_s = as_number(time_s, "time_s")
    velocity = as_matrix(velocity_px_s, (2,), "velocity_px_s")
    if not 0 <= time_s < math.inf:
        raise ShapeError(f"time_s: {time_s:g}; need 0 s or more")
    with np.errstate(over="ignore"):
        half = velocity * (time_s / 2)
    if not np.abs(half).max() <= _LONGEST_PX / 2:
        raise ShapeError(f"motion: {velocity.tolist()} px/s x {time_s:g} s; need at most {_LONGEST_PX:g} px")
    reach_x, reach_y = (math.ceil(abs(h)) for h in half.tolist())
    pieces = np.unique(np.concatenate([_crossings(h) for h in half.tolist()]))
    start, end = pieces[:-1], pieces[1:]
    kernel = np.zeros((2 * reach_y + 3, 2 * reach_x + 3))  # one more on each side, for hats that reach out by rounding
    for share, where in ((1 / 6, start), (4 / 6, (start + end) / 2), (1 / 6, end)):
        x, y = where * half[0], where * half[1]
        # The cell is that of the piece's middle: its ends lie on cell borders.
        left, top = (np.floor((start + end) / 2 * h).astype(np.intp) for h in half.tolist())
        fx, fy = x - left, y - top
        for dy, wy in ((0, 1 - fy), (1, fy)):
            for dx, wx in ((0, 1 - fx), (1, fx)):
                np.add.at(
                    kernel, (top + dy + reach_y + 1, left + dx + reach_x + 1), share * (end - start) / 2 * wx * wy
                )
    kernel = np.maximum(kernel[1:-1, 1:-1], 0)
    kernel = (kernel + kernel[::-1, ::-1]) / 2
    return np.asarray(kernel / kernel.sum(), np.float32)


def row_times(height: int, row_time_s: float) -> Floats:
    """Return when each row of a rolling shutter is exposed, against the middle of the picture.

    Parameters
    ----------
    height : rows; >= 1
    row_time_s : from one row to the next; negative: read from the bottom; 0: a global shutter

    Returns
    -------
    (height,) s, mean 0

    Raises
    ------
    ShapeError
        If the height is not positive or the time not finite.

    Examples
    --------
    >>> (row_times(4, 20e-6) * 1e6).round(3).tolist()
    [-30.0, -10.0, 10.0, 30.0]
    """
    height = as_integer(height, "height")
    row_time_s = as_number(row_time_s, "row_time_s")
    if height < 1 or not math.isfinite(height * row_time_s):
        raise ShapeError(f"height, row_time_s: {height}, {row_time_s:g}; need rows and a finite time")
    return np.asarray((np.arange(height) - (height - 1) / 2) * row_time_s, np.float64)


def rolling_shutter_points(points: ArrayLike, velocity_px_s: ArrayLike, row_time_s: float, height: int) -> Points:
    """Return where a rolling shutter shows moving points.

    A point at (x, y) + t v is seen when the row that it is on is read: t = t_row (y' - (height - 1) / 2), which gives
    y' and t in closed form. A vertical line that moves by v_x leans by v_x t_row pixels a row.

    Parameters
    ----------
    points : (N, 2) px where the points are in the middle of the picture's time
    velocity_px_s : (2,) or (N, 2) px/s
    row_time_s : from one row to the next; 0: a global shutter
    height : rows of the image; >= 1

    Returns
    -------
    (N, 2) px

    Raises
    ------
    ShapeError
        If the points or velocities are not such arrays, or a point keeps up with the reading of the rows
        (v_y t_row >= 1), so that no row, or many, would show it.

    Examples
    --------
    >>> rolling_shutter_points([[10.0, 0.0], [10.0, 99.0]], [2000.0, 0.0], 20e-6, 100).round(2).tolist()
    [[8.02, 0.0], [11.98, 99.0]]
    """
    row_time_s = as_number(row_time_s, "row_time_s")
    height = as_integer(height, "height")
    points = as_points(points)
    if height < 1 or not math.isfinite(row_time_s):
        raise ShapeError(f"height, row_time_s: {height}, {row_time_s:g}; need rows and a finite time")
    velocity = as_floats(velocity_px_s, "velocity_px_s")
    velocity = as_matrix(velocity, (2,) if velocity.ndim == 1 else points.shape, "velocity_px_s")
    with np.errstate(over="ignore", invalid="ignore"):
        per_row = np.broadcast_to(velocity * row_time_s, points.shape)  # px a row
        if not (per_row[:, 1] < 1).all():
            raise ShapeError(f"velocity_px_s: {per_row[:, 1].max():g} px down a row's time; need less than 1")
        rows = (points[:, 1] - (height - 1) / 2) / (1 - per_row[:, 1])
        seen = points + rows[:, None] * per_row
    if not np.isfinite(seen).all():
        raise ShapeError("points, velocity_px_s: values too large; need points that stay within floating point")
    return np.asarray(seen, np.float64)


def _crossings(half: float) -> Floats:
    """Return the parameters in [-1, 1] where a coordinate that runs from -half to half is a whole number; and +-1."""
    whole = np.arange(math.ceil(-abs(half)), math.floor(abs(half)) + 1)
    inner = whole / half if abs(half) >= 1 else np.zeros(1)
    return np.concatenate(([-1.0, 1.0], inner))
