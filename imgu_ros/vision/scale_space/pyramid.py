# SPDX-License-Identifier: Apache-2.0
"""Gaussian pyramids with coarse and with fine scales, and their bands (IU 3.1, 3.2; Burt & Adelson 1983)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer, as_number, require_type
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Floats, Image, Matrix3, Points, as_floats, as_image, as_points
from imgu_ros.vision.processing.interpolation import Interpolation, resized
from imgu_ros.vision.processing.points import full_scale, require_range
from imgu_ros.vision.scale_space.gaussian import GaussianKernel, smooth

#: Width of a level's band, octaves: of one alone descriptors have too little to tell places apart.
_BAND_OCTAVES = 3

#: Blur that a sampled image is taken to have, in its own pixels (Lowe 2004, section 3.3).
CAMERA_SIGMA_PX = 0.5
#: Larger numbers are no ratio of image sizes.
_LARGEST_STEP = 1e9


class PyramidKind(Choice):
    """How densely scales are sampled."""

    COARSE = "coarse"  #: one level an octave
    FINE = "fine"  #: several levels an octave
    LAPLACIAN = "laplacian"  #: one level an octave, as bands around mid-grey: see `band_passed`


class AlignedPixels:
    """Points in an image and in a reduction of it: their pixel areas, not their pixel centres, are aligned.

        x_full = (x_reduced + 0.5) * step - 0.5

    Base of `PixelScaling`, and of the levels of a pyramid.

    Attributes
    ----------
    step : (2,) px of the full-resolution image in one px of the reduced image, along x and y
    """

    __slots__ = ()
    step: Floats

    def to_full(self, xy: ArrayLike) -> Points:
        """Map points (N, 2) of the reduced image to the full-resolution image."""
        return (as_points(xy, "xy") + 0.5) * self.step - 0.5

    def from_full(self, xy: ArrayLike) -> Points:
        """Map points (N, 2) of the full-resolution image to the reduced image."""
        return (as_points(xy, "xy") + 0.5) / self.step - 0.5

    def to_full_unchecked(self, xy: Points) -> Points:
        """`to_full` without the checks of its argument."""
        return (xy + 0.5) * self.step - 0.5

    def from_full_unchecked(self, xy: Points) -> Points:
        """`from_full` without the checks of its argument."""
        return (xy + 0.5) / self.step - 0.5


class PixelScaling(AlignedPixels):
    """The scaling between an image and a reduction of it, also as homographies.

    Parameters
    ----------
    step : one number, or (2,) along x and y: px of the full-resolution image in one px of the reduced image

    Attributes
    ----------
    full_from_reduced, reduced_from_full : (3, 3)

    Raises
    ------
    ShapeError
        If the step is not one or two finite numbers above 0.

    Examples
    --------
    >>> half = PixelScaling(2.0)
    >>> half.to_full([[0, 0]]).tolist(), half.from_full([[0.5, 2.5]]).tolist()
    ([[0.5, 0.5]], [[0.0, 1.0]])
    """

    __slots__ = ("full_from_reduced", "reduced_from_full", "step")

    def __init__(self, step: ArrayLike) -> None:
        values = as_floats(step, "step")
        if values.shape not in ((), (2,)) or not (values > 1 / _LARGEST_STEP).all() or values.max() > _LARGEST_STEP:
            raise ShapeError(f"step: {values.tolist()}; need one or two numbers above 0")
        self.step: Floats = np.full(2, values)
        sx, sy = self.step
        self.full_from_reduced: Matrix3 = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])
        self.reduced_from_full: Matrix3 = np.array(
            [[1 / sx, 0, 0.5 / sx - 0.5], [0, 1 / sy, 0.5 / sy - 0.5], [0, 0, 1]]
        )


@dataclass(frozen=True, slots=True, eq=False)
class Level(AlignedPixels):
    """One level of a pyramid.

    Attributes
    ----------
    image : (H, W)
    step : (2,) full-resolution pixels in one pixel of this level, along x and y, >= 1; see `AlignedPixels`
    """

    image: Image
    step: Floats

    @property
    def scale(self) -> float:
        """Full-resolution pixels in one pixel of this level: the geometric mean of `step`."""
        return math.sqrt(float(self.step[0] * self.step[1]))


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """Levels from fine to coarse; never empty."""

    levels: tuple[Level, ...]


def build_pyramid(
    image: Image,
    kind: PyramidKind | str = PyramidKind.COARSE,
    levels: int = 8,
    scales_per_octave: int = 3,
    max_side_px: int | None = None,
    min_side_px: int = 32,
    kernel: GaussianKernel | str = GaussianKernel.SAMPLED,
    full_size: ArrayLike | None = None,
) -> Pyramid:
    """Build a Gaussian pyramid.

    Each level has the same blur in its own pixels as the image is taken to have in its own
    (sigma_t^2 = sigma_c^2 + sigma_f^2, IU 3.1.2), counting the blur that resampling adds.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32
    kind : coarse (scale 2 from level to level), fine (2^(1/scales_per_octave)) or laplacian (coarse, as bands)
    levels : most levels
    scales_per_octave : levels in an octave; for `fine`
    max_side_px : level 0 is the image reduced by the smallest whole number with which its longer side is no larger,
        by the mean over the area of each of its pixels; None: level 0 is the image
    min_side_px : no level gets a shorter side than this, level 0 excepted
    kernel : Gaussian that smooths before subsampling
    full_size : (width, height), px, at least the image's, of the picture that `image` is a reduction of, and to which
        the levels' `step` refers; None: it is none

    Raises
    ------
    ShapeError
        If `image` is not such an image, or larger than `full_size`, `kind` or `kernel` is unknown, or a count is not
        positive.
    """
    levels = as_integer(levels, "levels")
    scales_per_octave = as_integer(scales_per_octave, "scales_per_octave")
    max_side_px = None if max_side_px is None else as_integer(max_side_px, "max_side_px")
    min_side_px = as_integer(min_side_px, "min_side_px")
    image = as_image(image)
    if levels < 1 or scales_per_octave < 1:
        raise ShapeError(f"levels, scales_per_octave: {levels}, {scales_per_octave}; need at least 1")
    kind, kernel = PyramidKind(kind), GaussianKernel(kernel)
    per_octave = scales_per_octave if kind is PyramidKind.FINE else 1
    full = _full_size(image, full_size)
    base = image if max_side_px is None else _averaged(image, math.ceil(max(image.shape) / max(max_side_px, 1)))
    pictures = _pictures(base, per_octave, levels, min_side_px, kernel)
    pyramid = Pyramid(tuple(Level(picture, full / np.array(picture.shape[1::-1])) for picture in pictures))
    return band_passed(pyramid) if kind is PyramidKind.LAPLACIAN else pyramid


def band_passed(pyramid: Pyramid) -> Pyramid:
    """Return each level without what is coarser than three octaves, around mid-grey: 128 is no detail.

    Every level G, of a coarse or a fine pyramid, becomes clamp(G - enlarged(reduced(G)) + 128), reduced and enlarged
    three times: the sum of three bands of its Laplacian pyramid, indifferent to slow changes of light. For float32
    mid-grey is 0.5, for uint16 32768.

    Parameters
    ----------
    pyramid : of (H, W) images

    Notes
    -----
    Source: IU 3.2.3; Burt & Adelson 1983.

    Examples
    --------
    >>> flat = build_pyramid(np.full((64, 64), 77, np.uint8), levels=2)
    >>> [int(level.image.min()) for level in band_passed(flat).levels]
    [128, 128]
    """
    require_type(pyramid, Pyramid, "pyramid")
    return Pyramid(tuple(Level(_band(as_image(level.image)), level.step) for level in pyramid.levels))


def _band(image: Image) -> Image:
    require_range(image, 16.0)
    sizes = []
    low = image
    for _ in range(_BAND_OCTAVES):
        sizes.append(low.shape[1::-1])
        low = reduced(low)
    for size in reversed(sizes):
        low = enlarged(low, size)
    if image.dtype.kind == "f":
        return np.clip(image - low + np.float32(0.5), 0, 1)
    # One pass, saturating.
    return cv2.addWeighted(image, 1.0, low, -1.0, (full_scale(image.dtype) + 1) / 2)


def reduced(image: Image, factor: float = 2.0, kernel: GaussianKernel | str = GaussianKernel.SAMPLED) -> Image:
    """Smooth an image and resample it to 1 / factor of its size, so that its blur in its own pixels stays the same.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    factor : 1 to 2, more than 1
    kernel : Gaussian that smooths

    Returns
    -------
    Each side divided and rounded (halves down, at least 1 px); pixel areas are aligned, see `Level`.

    Raises
    ------
    ShapeError
        If `image` is not such an image, the factor lies outside its range or the kernel is unknown.

    Notes
    -----
    Source: IU 3.1.2, 3.2.1.

    Examples
    --------
    >>> reduced(np.full((6, 9), 50, np.uint8)).tolist()
    [[50, 50, 50, 50], [50, 50, 50, 50], [50, 50, 50, 50]]
    """
    factor = as_number(factor, "factor")
    image = as_image(image, channels=(1, 3))
    require_range(image, 4.0)
    if not 1 < factor <= 2:
        raise ShapeError(f"factor: {factor!r}; need more than 1, at most 2")
    # Linear interpolation half-way between pixels (factor 2) is a box of two: variance 1/4;
    # at phases spread evenly over a pixel its mean variance is 1/6.
    added = 0.25 if factor == 2.0 else 1 / 6
    variance = CAMERA_SIGMA_PX**2 * (factor**2 - 1) - added
    smoothed = smooth(image, math.sqrt(variance), kernel) if variance > 0 else image
    height, width = image.shape[:2]
    size = max(1, round(width / factor - 1e-9)), max(1, round(height / factor - 1e-9))
    return cv2.resize(smoothed, size, interpolation=cv2.INTER_LINEAR)


def enlarged(image: Image, size: Sequence[int]) -> Image:
    """Enlarge an image to a size, linearly; pixel areas are aligned: the inverse of `reduced`, but for what it lost.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    size : (width, height), px

    Raises
    ------
    ShapeError
        As `resized`.

    Examples
    --------
    >>> enlarged(np.array([[0, 100]], np.uint8), (4, 1)).tolist()
    [[0, 25, 75, 100]]
    """
    return resized(image, size, Interpolation.LINEAR)


def _full_size(image: Image, full_size: ArrayLike | None) -> Floats:
    size = np.array(image.shape[1::-1], np.float64)
    if full_size is None:
        return size
    full = as_floats(full_size, "full_size")
    if full.shape != (2,) or not (full >= size).all():
        raise ShapeError(
            f"full_size: {full.tolist()}; need width and height, at least {image.shape[1]}, {image.shape[0]}"
        )
    return full


def _averaged(image: Image, factor: int) -> Image:
    """Return the means over squares of `factor` pixels: less of a low-pass than `reduced`, at a tenth of its cost."""
    if factor == 1:
        return image
    height, width = image.shape
    size = max(1, round(width / factor - 1e-9)), max(1, round(height / factor - 1e-9))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _pictures(base: Image, per_octave: int, count: int, min_side_px: int, kernel: GaussianKernel) -> list[Image]:
    """Return at most `count` pictures from fine to coarse."""
    built: list[Image] = []
    while len(built) < count:
        for k in range(min(per_octave, count - len(built))):
            picture = base if k == 0 else reduced(base, 2 ** (k / per_octave), kernel)
            if built and min(picture.shape) < min_side_px:
                return built
            built.append(picture)
        if min(base.shape) < 2 * min_side_px:
            break
        base = reduced(base, 2.0, kernel)
    return built
