# SPDX-License-Identifier: Apache-2.0
"""Orientations from the histogram of gradient directions about a keypoint (IU 4.2.4; Lowe 2004, section 5)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Indices, Points, as_image, as_matrix, as_points

_BINS = 36
_SMOOTHING = np.array([1, 4, 6, 4, 1]) / 16
#: Another peak as high as this share of the highest is a direction, too.
_PEAK_SHARE = 0.8
#: Sigma of the window's weights and its radius, in sigmas of the structure.
_WINDOW = 1.5
_RADIUS = 4.5
_SAMPLE_COUNT = 256

#: Images smoothed for an octave of scales.
_LEVELS_PER_OCTAVE = 2
#: Sigma of the finest level of an image that is halved, in its pixels: halving it loses nothing.
_BASE_SIGMA_PX = 1.6
#: Variances, px^2: of the blur that an image is taken to have, and of Scharr's derivatives as a blur.
_PICTURE_VARIANCE = 0.25
_SCHARR_VARIANCE = 0.35
_SCHARR_SUM = 32
#: Windows sampled at once: bounds the memory, and cv2.remap takes no more than 32767 rows.
_CHUNK = 2048
_LARGEST_PX = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Orientations:
    """M directions of N points, by point, the strongest first.

    Attributes
    ----------
    index : (M,) the point; each of the N has one direction at least
    angle : (M,) rad in [-pi, pi), from x towards y
    """

    index: Indices
    angle: Floats


def dominant_orientations(image: Image, xy: Points, scale: Floats) -> Orientations:
    """Return the directions in which the image rises most about each point.

    Histograms of 36 directions of the gradients at the point's scale, weighted by magnitude and by a Gaussian of 1.5
    scales about the point itself, not about its pixel; smoothed; every peak of 80 % of the highest, at the vertex of
    the parabola through its three bins.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float32; nothing beyond its border counts
    xy : (N, 2) px
    scale : (N,) px, sigma of the structure, > 0; what is below 0.8 px cannot be told from 0.8

    Returns
    -------
    Orientations; 0 for a point about which there is no contrast.

    Raises
    ------
    ShapeError
        If an argument is not of that kind.

    Notes
    -----
    Lowe, "Distinctive image features from scale-invariant keypoints", 2004, section 5. Ours differs from the usual
    implementations in sampling about the point, and in gradients and bins that favour no direction: the direction of
    a blob on a slope, or of an oblong one, is good to 1.2 degrees wherever it lies.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = np.tile(np.arange(100, dtype=np.uint8), (100, 1))
    >>> found = dominant_orientations(ramp.T.copy(), np.array([[50.3, 40.8]]), np.array([3.0]))
    >>> found.index.tolist(), np.degrees(found.angle).round(3).tolist()
    ([0], [90.0])
    """
    image = as_image(image)
    xy = as_points(xy, "xy")
    scale = as_matrix(scale, (len(xy),), "scale")
    if len(xy) and not (np.abs(xy).max() < _LARGEST_PX and 0 < scale.min() <= scale.max() < _LARGEST_PX):
        raise ShapeError(f"xy, scale: out of range; need coordinates and scales > 0 below {_LARGEST_PX:g} px")
    histograms = np.zeros((len(xy), _BINS))
    for level in _levels(image, scale):
        for start in range(0, len(level.points), _CHUNK):
            some = level.points[start : start + _CHUNK]
            histograms[some] = _histograms(level, xy[some], scale[some])
    return _peaks(histograms)


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """Derivatives of a smoothed image, every `step` px, and the points that they are right for."""

    dx: Image
    dy: Image
    step: int
    points: Indices


def _levels(image: Image, scale: Floats) -> Iterator[_Level]:
    """Yield the levels that points of these scales need, finest first."""
    steps = np.rint(_LEVELS_PER_OCTAVE * np.log2(scale / _BASE_SIGMA_PX)).astype(int)
    # No image need be halved beyond one pixel, and below half the first scale it is as sharp as it is.
    steps = np.clip(steps, -_LEVELS_PER_OCTAVE, _LEVELS_PER_OCTAVE * math.ceil(math.log2(max(image.shape)) + 1) - 1)
    base = image.astype(np.float32)
    highest = float(np.abs(base).max())
    if highest > 0:
        base /= highest  # neither squares nor sums of huge numbers overflow
    base -= base[0, 0]  # smoothing leaves no rest where there is no contrast
    step, variance = 1, _PICTURE_VARIANCE
    for level in np.unique(steps):
        sigma = _BASE_SIGMA_PX * 2 ** (level / _LEVELS_PER_OCTAVE)
        while 2 * step * _BASE_SIGMA_PX <= sigma * (1 + 1e-9) and max(base.shape) > 1:
            smoothing = (2 * step * _BASE_SIGMA_PX) ** 2 - variance
            base = np.ascontiguousarray(_smoothed(base, math.sqrt(smoothing) / step)[::2, ::2])
            variance += smoothing
            step *= 2
        left = (sigma**2 - variance) / step**2 - _SCHARR_VARIANCE
        smooth = _smoothed(base, math.sqrt(max(left, 0.0)))
        dx, dy = (
            cv2.Scharr(smooth, cv2.CV_32F, *order, scale=1 / _SCHARR_SUM, borderType=cv2.BORDER_REPLICATE)
            for order in ((1, 0), (0, 1))
        )
        yield _Level(dx, dy, step, np.flatnonzero(steps == level))


def _smoothed(image: Image, sigma: float) -> Image:
    if sigma < 0.1:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101), np.float32)


def _sunflower() -> Points:
    """Return the places of the samples, in sigmas, (K, 2): evenly over the disc, and in no direction more than another.

    On a square grid more samples lie at 0, 45 and 90 degrees from the middle, which turns the directions of blobs.
    """
    k = np.arange(_SAMPLE_COUNT)
    share = (k + 0.5) / _SAMPLE_COUNT * (1 - math.exp(-0.5 * (_RADIUS / _WINDOW) ** 2))
    radius, turn = _WINDOW * np.sqrt(-2 * np.log(1 - share)), math.pi * (3 - math.sqrt(5)) * k
    return np.column_stack((radius * np.cos(turn), radius * np.sin(turn)))


_SAMPLES = _sunflower()


def _histograms(level: _Level, xy: Points, scale: Floats) -> Floats:
    """Return the weighted histogram of directions about each point, (N, 36): bin b about 10 b degrees."""
    x, y = (((xy[:, i, None] + scale[:, None] * _SAMPLES[:, i]) / level.step).astype(np.float32) for i in (0, 1))
    dx, dy = (
        cv2.remap(d, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        for d in (level.dx, level.dy)
    )
    magnitude, degrees = cv2.cartToPolar(dx, dy, angleInDegrees=True)
    # A gradient is shared among the two bins next to it: whole ones would pull directions to their middles.
    place = degrees * np.float32(_BINS / 360)
    lower = place.astype(np.int32)
    upper_share = magnitude * (place - lower)
    lower %= _BINS
    at = lower + _BINS * np.arange(len(xy), dtype=np.int32)[:, None]
    size = _BINS * len(xy)
    low = np.bincount(at.ravel(), (magnitude - upper_share).ravel(), size).reshape(-1, _BINS)
    high = np.bincount(at.ravel(), upper_share.ravel(), size).reshape(-1, _BINS)
    return np.asarray(low + np.roll(high, 1, axis=1), np.float64)


def _peaks(histograms: Floats) -> Orientations:
    smooth = sum(
        weight * np.roll(histograms, shift, axis=1) for weight, shift in zip(_SMOOTHING, range(-2, 3), strict=True)
    )
    smooth = np.asarray(smooth, np.float64)
    before, after = np.roll(smooth, 1, axis=1), np.roll(smooth, -1, axis=1)
    highest = smooth.max(axis=1, keepdims=True)
    # Of two equal bins the first is the peak, at the middle between them.
    peak = (smooth > before) & (smooth >= after) & (smooth >= _PEAK_SHARE * highest)
    flat = np.flatnonzero(~peak.any(axis=1))
    peak[flat, 0] = True
    point, bins = np.nonzero(peak)
    left, middle, right = (values[point, bins] for values in (before, smooth, after))
    bend = left - 2 * middle + right
    offset = np.where(bend < 0, (left - right) / (2 * np.where(bend < 0, bend, 1.0)), 0.0)
    angle = (bins + offset) * (2 * math.pi / _BINS)
    order = np.lexsort((-middle, point))
    angle = (angle[order] + math.pi) % (2 * math.pi) - math.pi
    return Orientations(point[order], np.where(angle >= math.pi, -math.pi, angle))
