# SPDX-License-Identifier: Apache-2.0
"""The places of large difference-of-Gaussians extrema, to a fraction of a pixel (Lowe 2004, section 4)."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Mask, Points, as_floats, as_image, as_points
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: The larger of the two Gaussians over the smaller: three scales in an octave.
_RATIO = 2 ** (1 / 3)
#: The smaller Gaussian, in pixels of the reduced image, is at least so large: the sums are then as good as integrals.
_FINE_SIGMA = 2.0
_REACH = 4.0
_STEPS = 3
#: Farther than this share of the scale, it would be another extremum.
_FARTHEST = 0.5
_LARGEST_SCALE_PX = 4096.0
#: Windows at a time: bounds the memory.
_BATCH = 256


def refined_centres(image: Image, xy: ArrayLike, scale: ArrayLike) -> Points:
    """Move extrema of the difference of Gaussians to where its gradient vanishes.

    A detector that fits a quadratic to samples of the difference finds the extremum to about a hundredth of its scale:
    the difference is no quadratic. Here its derivatives are sums over the image itself, at any place, for Newton's
    method.

    Parameters
    ----------
    image : (H, W) uint8
    xy : (N, 2) px, near extrema
    scale : (N,) px, 0.5 to 4096: sigma of the smaller of the two Gaussians

    Returns
    -------
    (N, 2) px; a point stays where it was when there is no extremum within half its scale.

    Raises
    ------
    ShapeError
        If an argument is not as said.

    Notes
    -----
    Source: Lowe 2004, section 4, equation 3, with exact derivatives. Time is O(N), whatever the scales: the image is
    reduced until the smaller Gaussian has 2 to 4 px.

    Examples
    --------
    >>> y, x = np.mgrid[0:80, 0:80]
    >>> blob = np.rint(50 + 150 * np.exp(-((x - 40.3) ** 2 + (y - 38.8) ** 2) / 200)).astype(np.uint8)
    >>> refined_centres(blob, [[41, 38]], [8.9]).round(1).tolist()
    [[40.3, 38.8]]
    """
    image = as_image(image, dtypes=(np.uint8,))
    points, sigmas = as_points(xy, "xy").copy(), as_floats(scale, "scale")
    if sigmas.shape != (len(points),):
        raise ShapeError(f"scale: shape {sigmas.shape}; need ({len(points)},), one for each point")
    if not ((sigmas >= 0.5) & (sigmas <= _LARGEST_SCALE_PX)).all():
        raise ShapeError(f"scale: outside its range; need 0.5 to {_LARGEST_SCALE_PX:g} px")
    limits = np.array(image.shape[1::-1]) - 0.5
    inside = ((points >= -0.5) & (points <= limits)).all(axis=1)
    reductions = np.maximum(1, np.floor(sigmas / _FINE_SIGMA)).astype(np.intp)
    # Powers of two: few images, each a reduction of the one before.
    reductions = 2 ** np.floor(np.log2(reductions)).astype(np.intp)
    for factor in np.unique(reductions[inside]).tolist():
        chosen = np.flatnonzero(inside & (reductions == factor))
        size = (math.ceil(image.shape[1] / factor), math.ceil(image.shape[0] / factor))
        reduced = _reduced(image, factor, size)
        # A pixel of the reduced image is a square of the image's.
        scaling = PixelScaling(float(factor))
        local = scaling.from_full_unchecked(points[chosen])
        moved = np.concatenate(
            [
                _moved(reduced, local[start : start + _BATCH], sigmas[chosen][start : start + _BATCH] / factor)
                for start in range(0, len(chosen), _BATCH)
            ]
        )
        points[chosen] = scaling.to_full_unchecked(moved)
    return points


def _reduced(image: Image, factor: int, size: tuple[int, int]) -> Image:
    if factor == 1:
        return image.astype(np.float32)
    # Whole squares of pixels: what lacks of the last ones is mirrored.
    bottom, right = size[1] * factor - image.shape[0], size[0] * factor - image.shape[1]
    whole = cv2.copyMakeBorder(image, 0, bottom, 0, right, cv2.BORDER_REFLECT)
    return cv2.resize(whole.astype(np.float32), size, interpolation=cv2.INTER_AREA)


def _moved(picture: Image, xy: Points, sigma: Floats) -> Points:
    reach = math.ceil(_REACH * _RATIO * float(sigma.max())) + 1
    wide = cv2.copyMakeBorder(picture, reach, reach, reach, reach, cv2.BORDER_REFLECT)
    nearest = np.rint(xy).astype(np.intp)
    nearest = np.clip(nearest, 0, np.array(picture.shape[1::-1]) - 1)
    side = 2 * reach + 1
    windows = np.lib.stride_tricks.sliding_window_view(wide, (side, side))[nearest[:, 1], nearest[:, 0]]
    # Without its mean a window's sums are small numbers.
    windows = windows - windows.mean(axis=(1, 2), keepdims=True)  # float32: their sums are good to 1e-6 of the contrast
    offsets = np.arange(-reach, reach + 1, dtype=np.float64)
    start = xy - nearest
    at, good = start, np.ones(len(xy), bool)
    for _ in range(_STEPS):
        slope, curvature = _derivatives(windows, offsets, at, sigma)
        step, is_extremum = _newton_step(slope, curvature)
        at = at + step
        good &= is_extremum & (np.linalg.norm(at - start, axis=1) <= _FARTHEST * sigma)
        at = np.where(good[:, None], at, start)
    return nearest + at


def _derivatives(windows: Image, offsets: Floats, at: Points, sigma: Floats) -> tuple[Floats, Floats]:
    """Return gradient (N, 2) and Hessian (N, 2, 2) of the difference of Gaussians at places in the windows."""
    total = np.zeros((len(at), 3, 3))
    for sign, width in ((1.0, _RATIO * sigma), (-1.0, sigma)):
        x, y = (_gaussians(offsets, at[:, axis], width).astype(np.float32) for axis in (0, 1))
        # [a, b]: a-th derivative by y, b-th by x.
        total += sign * (y @ windows @ x.transpose(0, 2, 1))
    slope = np.stack((total[:, 0, 1], total[:, 1, 0]), axis=1)
    curvature = np.stack((total[:, 0, 2], total[:, 1, 1], total[:, 1, 1], total[:, 2, 0]), axis=1).reshape(-1, 2, 2)
    return slope, curvature


def _gaussians(offsets: Floats, at: Floats, sigma: Floats) -> Floats:
    """Return a Gaussian about each place and its first two derivatives by the place, (N, 3, n)."""
    u = (offsets[None, :] - at[:, None]) / sigma[:, None]
    g = np.exp(-0.5 * u**2) / (math.sqrt(2 * math.pi) * sigma[:, None])
    return np.stack((g, g * u / sigma[:, None], g * (u**2 - 1) / sigma[:, None] ** 2), axis=1)


def _newton_step(slope: Floats, curvature: Floats) -> tuple[Points, Mask]:
    """Return the steps (N, 2), 0 where the curvatures differ in sign or vanish, and where they do not."""
    a, b, c = curvature[:, 0, 0], curvature[:, 0, 1], curvature[:, 1, 1]
    determinant = a * c - b**2
    is_extremum = determinant > 1e-9 * (a**2 + c**2)
    safe = np.where(is_extremum, determinant, 1.0)
    step = np.stack((b * slope[:, 1] - c * slope[:, 0], b * slope[:, 0] - a * slope[:, 1]), axis=1) / safe[:, None]
    return np.where(is_extremum[:, None], step, 0.0), is_extremum
