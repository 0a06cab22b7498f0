"""Gaussian pyramids with coarse and with fine scales (notes 3.2.1, 3.2.2; Burt & Adelson 1983; Lindeberg 1994)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Floats, Image, Points, as_image
from imgu_ros.vision.scale_space.gaussian import GaussianKernel, smooth

#: Blur that a sampled image is taken to have, in its own pixels (Lowe 2004, section 3.3).
CAMERA_SIGMA_PX = 0.5


class PyramidKind(Choice):
    """How densely scales are sampled."""

    COARSE = "coarse"  #: one level an octave
    FINE = "fine"  #: several levels an octave


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One level of a pyramid.

    Attributes
    ----------
    image : (H, W)
    step : (2,) full-resolution pixels in one pixel of this level, along x and y, >= 1. Pixel areas, not centres,
        are aligned: x_full = (x_level + 0.5) * step - 0.5
    """

    image: Image
    step: Floats

    @property
    def scale(self) -> float:
        """Full-resolution pixels in one pixel of this level: the geometric mean of `step`."""
        return math.sqrt(float(self.step[0] * self.step[1]))

    def to_full(self, xy: Points) -> Points:
        """Map points (N, 2) of this level to the full-resolution image."""
        return (xy + 0.5) * self.step - 0.5

    def from_full(self, xy: Points) -> Points:
        """Map points (N, 2) of the full-resolution image to this level."""
        return (xy + 0.5) / self.step - 0.5


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
) -> Pyramid:
    """Build a Gaussian pyramid.

    Each level has the same blur in its own pixels as the image is taken to have in its own
    (sigma_t^2 = sigma_c^2 + sigma_f^2, notes 3.1.2), counting the blur that resampling adds.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32
    kind : coarse (scale 2 from level to level) or fine (2^(1/scales_per_octave))
    levels : most levels
    scales_per_octave : levels in an octave; for `fine`
    max_side_px : halve the image before level 0 until its longer side is no larger; None: level 0 is the image
    min_side_px : no level gets a shorter side than this, level 0 excepted
    kernel : Gaussian that smooths before subsampling

    Raises
    ------
    ShapeError
        If `image` is not such an image, `kind` or `kernel` is unknown or a count is not positive.
    """
    image = as_image(image)
    if levels < 1 or scales_per_octave < 1:
        raise ShapeError(f"levels, scales_per_octave: {levels}, {scales_per_octave}; need at least 1")
    kernel = GaussianKernel(kernel)
    per_octave = scales_per_octave if PyramidKind(kind) is PyramidKind.FINE else 1
    full = np.array(image.shape[1::-1], np.float64)
    base = image
    while max_side_px is not None and max(base.shape) > max_side_px and min(base.shape) > 1:
        base = _reduced(base, 2.0, kernel)
    built: list[Level] = []
    while len(built) < levels:
        for k in range(min(per_octave, levels - len(built))):
            picture = base if k == 0 else _reduced(base, 2 ** (k / per_octave), kernel)
            if built and min(picture.shape) < min_side_px:
                return Pyramid(tuple(built))
            built.append(Level(picture, full / np.array(picture.shape[1::-1])))
        if min(base.shape) < 2 * min_side_px:
            break
        base = _reduced(base, 2.0, kernel)
    return Pyramid(tuple(built))


def _reduced(image: Image, factor: float, kernel: GaussianKernel) -> Image:
    """Smooth and resample an image to 1 / factor of its size, 1 < factor <= 2."""
    # Linear interpolation half-way between pixels (factor 2) is a box of two: variance 1/4;
    # at phases spread evenly over a pixel its mean variance is 1/6.
    added = 0.25 if factor == 2.0 else 1 / 6
    variance = CAMERA_SIGMA_PX**2 * (factor**2 - 1) - added
    smoothed = smooth(image, math.sqrt(variance), kernel) if variance > 0 else image
    height, width = image.shape
    size = max(1, round(width / factor - 1e-9)), max(1, round(height / factor - 1e-9))
    return cv2.resize(smoothed, size, interpolation=cv2.INTER_LINEAR)
