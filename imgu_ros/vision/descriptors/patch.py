# SPDX-License-Identifier: Apache-2.0
"""Patches as descriptors: the pixels themselves, turned and scaled to the keypoint (IU 5.1)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Points, as_image, as_matrix, as_points
from imgu_ros.vision.descriptors.described import Described, checked_corners
from imgu_ros.vision.keypoints.keypoints import Corners

#: Samples along a side.
SIDE = 13
#: Between neighbouring samples, in sigmas of the structure: the patch is 22 sigma wide, like ORB's.
STEP_PER_SIGMA = 1.75
#: Share of the step by which an image is smoothed before it is sampled so sparsely.
_SMOOTHING_PER_STEP = 0.5
#: Steps of sigma, in octaves, for which one smoothed image serves.
_SMOOTHINGS_PER_OCTAVE = 2
_LARGEST_SMOOTHING_PX = 64.0
#: Samples taken at once: bounds the memory.
_CHUNK = 2**19
_LARGEST_PX = 1e6
_LARGEST_SIDE = 256


def describe_patch(image: Image, corners: Corners) -> Described:
    """Describe corners of one image by 169 samples each, 0 to 255, row by row of a turned and scaled square.

    To be compared by SSD, zero-mean SSD or NCC. The image is smoothed according to the distance of the samples.

    Parameters
    ----------
    image : (H, W) uint8
    corners : with scale (samples are 1.75 sigma apart) and angle; those whose square reaches beyond the border are
        left out

    Raises
    ------
    ShapeError
        If the image or a corner is not of that kind.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = np.tile(np.arange(100, dtype=np.uint8), (100, 1))
    >>> corner = Corners(np.array([[50.0, 50.0]]), np.array([2.0]), np.zeros(1), np.ones(1))
    >>> describe_patch(ramp, corner).descriptors[0, :3].round(3).tolist()
    [29.0, 32.5, 36.0]
    """
    image = as_image(image, dtypes=(np.uint8,))
    corners = checked_corners(corners)
    step = STEP_PER_SIGMA * corners.scale
    inside = np.flatnonzero(_is_inside(image, corners.xy, step, corners.angle, SIDE))
    descriptors = np.empty((len(inside), SIDE * SIDE), np.float32)
    smoothing = 2 ** (np.rint(_SMOOTHINGS_PER_OCTAVE * np.log2(step[inside])) / _SMOOTHINGS_PER_OCTAVE)
    for distance in np.unique(smoothing):
        which = np.flatnonzero(smoothing == distance)
        sigma = min(_SMOOTHING_PER_STEP * float(distance), _LARGEST_SMOOTHING_PX)
        smoothed = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma)
        some = inside[which]
        patches = sample_patches(smoothed, corners.xy[some], step[some], corners.angle[some], SIDE)
        descriptors[which] = patches.reshape(len(some), -1)
    return Described(inside, descriptors)


def sample_patches(image: Image, xy: Points, step_px: Floats, angle: Floats, side: int) -> NDArray[np.float32]:
    """Sample turned and scaled squares of an image, bilinearly.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float32; beyond its border its outermost pixels go on
    xy : (N, 2) px, the squares' centres
    step_px : (N,) px between neighbouring samples, > 0
    angle : (N,) rad, from the image's x axis to the squares', from x towards y
    side : samples along a side, 1 to 256

    Returns
    -------
    (N, side, side) float32, in the image's units

    Raises
    ------
    ShapeError
        If an argument is not of that kind.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.array([[0, 10], [20, 30]], np.uint8)
    >>> centre, one = np.array([[0.5, 0.5]]), np.ones(1)
    >>> sample_patches(image, centre, one, 0 * one, 2).tolist()
    [[[0.0, 10.0], [20.0, 30.0]]]
    """
    side = as_integer(side, "side")
    image = as_image(image)
    xy = as_points(xy, "xy")
    step_px, angle = as_matrix(step_px, (len(xy),), "step_px"), as_matrix(angle, (len(xy),), "angle")
    if isinstance(side, bool) or not isinstance(side, int | np.integer) or not 1 <= side <= _LARGEST_SIDE:
        raise ShapeError(f"side: {side!r}; need an integer from 1 to {_LARGEST_SIDE}")
    if len(xy) and not (np.abs(xy).max() < _LARGEST_PX and 0 < step_px.min() <= step_px.max() < _LARGEST_PX):
        raise ShapeError(f"xy, step_px: out of range; need coordinates and steps > 0 below {_LARGEST_PX:g} px")
    offset = np.arange(side) - (side - 1) / 2
    patches = np.empty((len(xy), side, side), np.float32)
    at_once = max(1, _CHUNK // side**2)
    for start in range(0, len(xy), at_once):
        some = slice(start, start + at_once)
        along, across = (step_px[some, None] * f(angle[some, None]) for f in (np.cos, np.sin))
        x = xy[some, 0, None, None] + (along * offset)[:, None, :] - (across * offset)[:, :, None]
        y = xy[some, 1, None, None] + (across * offset)[:, None, :] + (along * offset)[:, :, None]
        patches[some] = _bilinear(image, x, y)
    return patches


def _bilinear(image: Image, x: Floats, y: Floats) -> NDArray[np.float32]:
    height, width = image.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    column, row = x.astype(np.intp), y.astype(np.intp)
    u, v = (x - column).astype(np.float32), (y - row).astype(np.float32)
    right, below = (column < width - 1).astype(np.intp), (row < height - 1) * width
    pixels = image.ravel()
    at = row * width + column
    # Weights on the pixels, not differences: those of float32 pixels may overflow.
    upper = pixels[at] * (1 - u) + pixels[at + right] * u
    lower = pixels[at + below] * (1 - u) + pixels[at + below + right] * u
    return np.asarray(upper * (1 - v) + lower * v, np.float32)


def _is_inside(image: Image, xy: Points, step: Floats, angle: Floats, side: int) -> NDArray[np.bool_]:
    """Return which squares lie inside the image, to the last sample."""
    reach = (side - 1) / 2 * step * (np.abs(np.cos(angle)) + np.abs(np.sin(angle)))
    limit = np.array(image.shape[1::-1]) - 1
    return np.asarray(np.minimum(xy, limit - xy).min(axis=1, initial=np.inf) >= reach)
