# SPDX-License-Identifier: Apache-2.0
"""What `imgu filter` does to a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.image.frame_image import grey_of
from imgu_ros.types import Image, Mask
from imgu_ros.vision.processing.borders import Border
from imgu_ros.vision.processing.convolution import convolve, mean_filtered
from imgu_ros.vision.processing.derivatives import Derivative, Gradient, gradient
from imgu_ros.vision.processing.edges import canny, edge_map
from imgu_ros.vision.processing.points import full_scale
from imgu_ros.vision.processing.separability import is_separable, split
from imgu_ros.vision.scale_space.gaussian import smooth
from imgu_ros.vision.scale_space.laplacian import LaplacianPyramid, laplacian_pyramid, reconstructed

_RED = (1.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterOptions:
    """Options of the methods; None: the method's default.

    Attributes
    ----------
    size : px, odd
    sigma : px
    kernel : rows of weights
    gain : of detail, or of the gradient's length
    levels : bands of detail
    operator, border : names
    threshold, low, high : grey values per px
    overlay : draw edges over the picture
    """

    size: int = 3
    sigma: float = 1.0
    kernel: Sequence[Sequence[float]] = ((1.0,),)
    gain: float | None = None
    levels: int = 3
    operator: str = Derivative.SOBEL
    border: str = Border.REFLECTED
    threshold: float | None = None
    low: float | None = None
    high: float | None = None
    overlay: bool = False


def filtered(image: Image, method: str, options: FilterOptions, grey_weights: Sequence[float]) -> Image:
    """Return the picture after one of the methods of `imgu filter`.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) RGB, uint8, uint16 or float32
    method : mean, gaussian, kernel, detail (these work on each colour), strength, direction, edges or canny (on grey)
    options : those that the method knows
    grey_weights : of red, green and blue

    Returns
    -------
    Same size and data type, clamped to its range; (H, W, 3) also for `direction` and for edges over the picture.

    Raises
    ------
    ShapeError
        If an option is out of range.
    """
    if method in _OF_COLORS:
        return _OF_COLORS[method](image, options)
    return _OF_GREY[method](image, _grey(image, grey_weights), options)


def described_kernel(kernel: Sequence[Sequence[float]]) -> str:
    """Return the kernel's size, and whether a column and a row do the same, as a line for people."""
    size = f"kernel {len(kernel[0])} x {len(kernel)}"
    if is_separable(kernel):
        return f"{size}: separable, a column and a row"
    return f"{size}: not separable, the sum of {split(kernel).rank} that are"


def _kernel(image: Image, o: FilterOptions) -> Image:
    return _clamped(convolve(image, o.kernel, o.border), image.dtype)


def _detail(image: Image, o: FilterOptions) -> Image:
    parts, gain = laplacian_pyramid(image, o.levels), 2.0 if o.gain is None else o.gain
    return _clamped(
        reconstructed(LaplacianPyramid(tuple(_times(b, gain) for b in parts.bands), parts.base)), image.dtype
    )


def _times(band: Image, gain: float) -> Image:
    if band.dtype.kind == "f":
        return (band * np.float32(gain)).astype(np.float32)
    limits = np.iinfo(band.dtype)
    return np.clip(np.rint(band * gain), limits.min, limits.max).astype(band.dtype)


def _strength(image: Image, grey: Image, o: FilterOptions) -> Image:
    return _brightness(_slope(grey, o), o, image.dtype)


def _direction(image: Image, grey: Image, o: FilterOptions) -> Image:
    slope = _slope(grey, o)
    full = full_scale(image.dtype)
    hue = np.mod(np.rad2deg(slope.direction), 360.0).astype(np.float32)
    value = (_brightness(slope, o, image.dtype) / full).astype(np.float32)
    hsv = np.dstack((hue, np.ones_like(hue), value))
    return _clamped(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB) * full, image.dtype)


def _edges(image: Image, grey: Image, o: FilterOptions) -> Image:
    threshold = 0.1 * full_scale(grey.dtype) if o.threshold is None else o.threshold
    return _drawn(image, edge_map(grey, threshold, o.operator), o.overlay)


def _canny(image: Image, grey: Image, o: FilterOptions) -> Image:
    full = full_scale(grey.dtype)
    # A default gives way to the threshold that is given.
    low = min(0.02 * full, full if o.high is None else o.high) if o.low is None else o.low
    high = max(0.05 * full, low) if o.high is None else o.high
    return _drawn(image, canny(grey, low, high, o.sigma), o.overlay)


def _drawn(image: Image, edges: Mask, overlay: bool) -> Image:
    """Return edges white on black, or red over the picture."""
    full = full_scale(image.dtype)
    if not overlay:
        return (edges * full).astype(image.dtype)
    over = np.dstack([image] * 3) if image.ndim == 2 else image.copy()
    over[edges] = np.array(_RED) * full
    return over


def _slope(grey: Image, o: FilterOptions) -> Gradient:
    return gradient(grey, o.operator, o.sigma, o.border)


def _brightness(slope: Gradient, o: FilterOptions, dtype: np.dtype[np.generic]) -> Image:
    return _clamped(slope.magnitude * np.float32(4.0 if o.gain is None else o.gain), dtype)


def _grey(image: Image, weights: Sequence[float]) -> Image:
    return image if image.ndim == 2 else grey_of(image, weights)


def _clamped(values: Image, dtype: np.dtype[np.generic]) -> Image:
    clamped = np.clip(values, 0, full_scale(dtype))
    return (np.rint(clamped) if dtype.kind == "u" else clamped).astype(dtype)


_OF_COLORS: dict[str, Callable[[Image, FilterOptions], Image]] = {
    "mean": lambda image, o: mean_filtered(image, o.size, o.border),
    "gaussian": lambda image, o: smooth(image, o.sigma, border=o.border),
    "kernel": _kernel,
    "detail": _detail,
}
_OF_GREY: dict[str, Callable[[Image, Image, FilterOptions], Image]] = {
    "strength": _strength,
    "direction": _direction,
    "edges": _edges,
    "canny": _canny,
}
