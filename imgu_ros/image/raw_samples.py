# SPDX-License-Identifier: Apache-2.0
"""What an alignment by raw samples compares: the samples of a sensor, and a picture in linear light."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.types import Floats, Image, Indices, Mask, Points
from imgu_ros.vision.scale_space.pyramid import PixelScaling

Singles = NDArray[np.float32]
#: Raw px (N, 2) of ideal px (N, 2), and the derivative (N, 2, 2): what a lens does.
Lens = Callable[[Points], tuple[Points, Floats]]

#: Up to these variances of a row of taps, of a texel squared, three and five of them do; beyond, seven.
_TAPS = (1.4, 5.0)
#: The outer two of three even samples tell a steeper slope than that of their mean: by this factor where the picture's
#: details are 3 px long.
_EVEN_STEEPNESS = 1.11
#: Variance of the place in a site, px^2.
SITE_VARIANCE = 1 / 12
#: Texels in a px of the image, and in the standard deviation of the narrower side of a spread: fewer blur and alias.
#: Measured: benchmarks/thresholds.py, study samples.
_TEXELS, _SPREAD_TEXELS = 4.8, 2.0
#: Variance by the interpolation between texels, and by the averaging that made a reduced level, of a texel squared.
_INTERPOLATED, _AVERAGED = 1 / 6, 1 / 12
#: Share of the variance of a spread by which the picture is blurred beforehand. Left to the taps is at least so much of
#: a texel squared, and so much, px^2: they give the derivatives, too. Measured: benchmarks/thresholds.py, study
#: samples.
_BLUR_SHARE, _LEFT_TEXELS2, _LEAST_VARIANCE = 0.8, 0.3, 0.02
#: Variances by which a picture is blurred beforehand, of a px squared.
_BLURS = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6)
#: So many blurred pictures of each level are kept.
_BLURRED_KEPT = 2


class LightLevel:
    """A picture at one scale, in linear light.

    Parameters
    ----------
    light : (H, W) or (H, W, C) float32
    step : px of the full-resolution picture in one px of this level, along x and y

    Attributes
    ----------
    scaling : between the picture and the level
    """

    def __init__(self, light: Singles, step: Floats) -> None:
        self.scaling = PixelScaling(step)
        self._values: Sequence[Singles] = _channels(light)
        self._blurred: dict[float, Sequence[Singles]] = {}

    def blurred(self, most: float) -> tuple[float, Sequence[Singles]]:
        """Return the picture blurred by at most this variance, px^2 of it: by which, and each channel, (H, W)."""
        variance = max((blur for blur in _BLURS if blur <= most), default=None)
        if variance is None:
            return 0.0, self._values
        known = self._blurred.get(variance)
        if known is None:
            known = [
                np.asarray(cv2.GaussianBlur(each, (0, 0), math.sqrt(variance)), np.float32) for each in self._values
            ]
            kept = [*self._blurred.items()][1 - _BLURRED_KEPT :]
            self._blurred = dict([*kept, (variance, known)])
        return variance, known


class DrawnLevel(LightLevel):
    """A grey picture at one scale that is drawn when it is first needed.

    Parameters
    ----------
    draw : returns it, (H, W) float32
    step : as for `LightLevel`
    channels : number of equal channels
    """

    def __init__(self, draw: Callable[[], Singles], step: Floats, channels: int) -> None:
        self.scaling = PixelScaling(step)
        self._draw: Callable[[], Singles] | None = draw
        self._count = channels
        self._values, self._blurred = (), {}

    def blurred(self, most: float) -> tuple[float, Sequence[Singles]]:
        """See `LightLevel.blurred`."""
        if self._draw is not None:
            self._values, self._draw = (self._draw(),), None
        variance, (known,) = super().blurred(most)
        return variance, (known,) * self._count


def _channels(light: Singles) -> Sequence[Singles]:
    return [np.asarray(each, np.float32) for each in cv2.split(light)]


def light_levels(light: Singles, most: int = 8, smallest_px: int = 24) -> tuple[LightLevel, ...]:
    """Return a picture in linear light, (H, W) or (H, W, C) float32, at full resolution and halved, fine to coarse."""
    height, width = light.shape[:2]
    levels: list[LightLevel] = []
    while not levels or (min(light.shape[:2]) >= smallest_px and len(levels) < most):
        h, w = light.shape[:2]
        levels.append(LightLevel(light, np.array((width / w, height / h))))
        halved = cv2.resize(light, (max(w // 2, 1), max(h // 2, 1)), interpolation=cv2.INTER_AREA)
        light = np.asarray(halved, np.float32)
    return tuple(levels)


@dataclass(frozen=True, slots=True, eq=False)
class Mosaic:
    """Raw samples, and what they mean.

    Attributes
    ----------
    values : (H, W) uint8 or uint16
    channels : of the four sites of a quad, row-major; (0, 0, 0, 0) where all see the same
    black, white : raw values of no light and of full scale; from a little below `white` on a value says only that the
        light is at least so
    light : light of each raw value, float32, where values do not go with the light; None: they do
    """

    values: Image
    channels: tuple[int, int, int, int]
    black: float
    white: float
    light: Singles | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PatchSites:
    """The sites of a square patch, channel after channel.

    Attributes
    ----------
    row, column, quad : (S,), and the number of the quad
    slices : of each channel
    knots : (9, 2) places (x, y) in the patch, from which a smooth function is interpolated
    """

    row: Indices
    column: Indices
    quad: Indices
    slices: tuple[slice, ...]
    knots: Points
    _of_knots: Floats

    def first_in(self, origins: Indices, shape: tuple[int, int]) -> Mask:
        """Return which sites of N patches lie in none before: (N, S).

        Parameters
        ----------
        origins : (N, 2) px of the mosaic (x, y), even
        shape : height and width of the mosaic
        """
        x, y = (origins // 2).T[:, :, None]
        steps = np.arange(math.isqrt(int(self.quad.max()) + 1))
        at = ((y + steps)[:, :, None], (x + steps)[:, None])
        number = np.arange(len(origins), dtype=np.int32)[:, None, None]
        first = np.empty((shape[0] // 2, shape[1] // 2), np.int32)
        first[at[0][::-1], at[1][::-1]] = number[::-1]
        mine: Mask = (first[at] == number).reshape(len(origins), -1)
        return mine[:, self.quad]

    def interpolated(self, values: Floats) -> Floats:
        """Return a smooth function of the place at the sites, (K, N, S), by values at the knots, (N, 9, K)."""
        return np.moveaxis(values, 2, 0) @ self._of_knots


@lru_cache(maxsize=8)
def patch_sites(side: int, channels: tuple[int, int, int, int]) -> PatchSites:
    """Return the sites of a patch of `side` px that begins at a quad, which sees `channels`."""
    y, x = (each.ravel() for each in np.mgrid[:side, :side])
    channel = np.array(channels)[2 * (y % 2) + x % 2]
    order = np.argsort(channel, kind="stable")
    row, column = y[order], x[order]
    ends = np.searchsorted(channel[order], np.arange(max(channels) + 2))
    slices = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))
    middle = (side - 1) / 2
    knots = np.array([(i, j) for j in (0, middle, side - 1) for i in (0, middle, side - 1)], np.float64)
    # Parabolas along x and along y.
    by_column, by_row = ((1, t, t * t) for t in ((column - middle) / middle, (row - middle) / middle))
    to_parabola = np.linalg.inv([[1, -1, 1], [1, 0, 0], [1, 1, 1]]).T
    along, across = (to_parabola @ np.stack(np.broadcast_arrays(*each)) for each in (by_column, by_row))
    of_knots = (across[:, None] * along[None]).reshape(9, -1)
    return PatchSites(row, column, (row // 2) * (side // 2) + column // 2, slices, knots, of_knots)


def undistorted(lens: Lens, near: Points, raw: Floats) -> Floats:
    """Return ideal px of raw ones, (N, K, 2), each K near one of (N, 2) ideal px.

    To first order about these, then one step of Newton's method with the same derivative.
    """
    at, by = lens(near)
    back = np.swapaxes(np.linalg.inv(by), 1, 2)
    ideal = near[:, None] + (raw - at[:, None]) @ back
    again = lens(ideal.reshape(-1, 2))[0].reshape(ideal.shape)
    return np.asarray(ideal + (raw - again) @ back, np.float64)


def inside_picture(G: Floats, x: Singles, y: Singles, size: tuple[int, int], rim: float) -> Mask:
    """Return which places, x and y of one shape, a homography G maps into a picture, `rim` or more from its border.

    Parameters
    ----------
    G : (3, 3), to px of the picture
    x, y : the places
    size : width and height of the picture, px
    rim : px of the picture
    """
    u, v, w = G @ np.stack((x.ravel(), y.ravel(), np.ones(x.size)))
    u, v, low = u / w, v / w, rim - 0.5
    inside: Mask = (w > 0) & (u > low) & (v > low) & (u < size[0] - 1 - low) & (v < size[1] - 1 - low)
    return inside.reshape(x.shape)


@dataclass(frozen=True, slots=True, eq=False)
class SpreadTaps:
    """Samples of a picture that tell its mean over a point spread, and the derivatives of the mean.

    Attributes
    ----------
    offsets : (K, 2) px, where they are taken
    means : (6, K) weights of the mean's derivatives by a displacement x, y and by the variances xx, xy, yy of the
        spread, and of the mean
    steepness : by what factor the derivatives by a displacement are too large
    """

    offsets: Floats
    means: Floats
    steepness: float = 1.0

    def turned(self, angle: float) -> SpreadTaps:
        """Return the same along axes that are turned by an angle from x to y, rad."""
        c, s = math.cos(angle), math.sin(angle)
        turned = np.array(
            (
                (c, -s, 0, 0, 0, 0),
                (s, c, 0, 0, 0, 0),
                (0, 0, c * c, -c * s, s * s, 0),
                (0, 0, 2 * c * s, c * c - s * s, -2 * c * s, 0),
                (0, 0, s * s, c * s, c * c, 0),
                (0, 0, 0, 0, 0, 1),
            )
        )
        return SpreadTaps(self.offsets @ turned[:2, :2].T, turned @ self.means, self.steepness)


@dataclass(frozen=True, slots=True, eq=False)
class RowScan:
    """A rolling shutter: rows are exposed one after the other, and the image moves meanwhile.

    Attributes
    ----------
    by_row : (N, 2) px, motion of each of the given centres from one row to the next
    doubts : (K, N, 2) px, ways in which all of it may be wrong together, each by one standard deviation
    row : at whose time the homography is to hold
    """

    by_row: Points
    doubts: Floats
    row: float

    def seen(self, at: Points) -> Points:
        """Return where the centres, which are at (N, 2) px at that time, are when their row is exposed."""
        rows = (at[:, 1] - self.row) / (1 - self.by_row[:, 1])
        return np.asarray(at + self.by_row * rows[:, None])


def spread_samples(
    levels: Sequence[LightLevel], texels_px: Sequence[float], variances: tuple[float, float]
) -> tuple[LightLevel, Sequence[Singles], SpreadTaps]:
    """Return how the mean of a picture over a Gaussian spread is sampled: the level, its channels, and the samples.

    Few samples alias where the picture's details are as fine as the spread: the level is blurred by most of it.

    Parameters
    ----------
    levels : the picture, fine to coarse
    texels_px : side of a px of each level in the image, px
    variances : of the spread, sites included, along the samples' axes x and y, px^2
    """
    least = min(variances)
    wanted = max(1 / _TEXELS, math.sqrt(max(least - SITE_VARIANCE, 0)) / _SPREAD_TEXELS)
    texel = min(texels_px, key=lambda texel: abs(math.log(texel / wanted)))
    level, texel2 = levels[texels_px.index(texel)], texel**2
    by_level = _INTERPOLATED + _AVERAGED * (1 - texels_px[0] ** 2 / texel2)
    narrow = least / texel2 - by_level
    blur, channels = level.blurred(min(_BLUR_SHARE * narrow, narrow - _LEFT_TEXELS2))
    x, y = [max(each - (by_level + blur) * texel2, _LEAST_VARIANCE) for each in variances]
    return level, channels, gaussian_taps((x, y), texel2)


def gaussian_taps(variances: tuple[float, float], texel2: float) -> SpreadTaps:
    """Return samples whose mean is that over a Gaussian with these variances along x and y, px^2.

    Parameters
    ----------
    variances : of the Gaussian
    texel2 : of the picture that is sampled, px^2
    """
    halves = [1 + bisect_left(_TAPS, variance / texel2) for variance in variances]
    unit = _unit_taps(*halves)
    x, y = [math.sqrt(variance) for variance in variances]
    by = np.array(((1 / x,), (1 / y,), (1 / (x * x),), (1 / (x * y),), (1 / (y * y),), (1,)))
    return SpreadTaps(unit.offsets * (x, y), unit.means * by, unit.steepness)


@lru_cache(maxsize=16)
def _unit_taps(half_x: int, half_y: int) -> SpreadTaps:
    """Return 2 half + 1 samples along x and along y, for variances of 1."""
    (along, x_weights), (across, y_weights) = _row(half_x), _row(half_y)
    x, y = (each.ravel() for each in np.meshgrid(along, across))
    weights = np.outer(y_weights, x_weights).ravel()
    powers = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y))
    quadratic = np.linalg.solve((powers * weights) @ powers.T, powers * weights)
    steepness = _EVEN_STEEPNESS if half_x == half_y == 1 else 1.0
    return SpreadTaps(np.stack((x, y), axis=1), np.vstack((quadratic[1:], weights)), steepness)


def _row(half: int) -> tuple[Floats, Floats]:
    """Return places and weights of a row of samples of variance 1."""
    if half == 1:
        # Nearly even between interpolated texels, as a site is.
        return np.array([-1.0, 0.0, 1.0]) * math.sqrt(1.5), np.full(3, 1 / 3)
    steps = np.arange(-half, half + 1) * (2.25 / half)
    weights = np.exp(-(steps**2) / 2)
    weights /= weights.sum()
    places = steps / math.sqrt(float(weights @ steps**2))
    return places.astype(np.float64), weights.astype(np.float64)
