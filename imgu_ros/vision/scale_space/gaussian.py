# SPDX-License-Identifier: Apache-2.0
"""Gaussian smoothing (IU 2.2.4, 3.3.1, 3.3.2)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Floats, Image, as_image
from imgu_ros.vision.processing.borders import CV_BORDERS, Border, border_values, padded
from imgu_ros.vision.processing.points import require_range
from imgu_ros.vision.scale_space.kernels import discrete_gaussian, discrete_reach
from imgu_ros.vision.scale_space.recursive import SIGMA_RANGE_PX, smooth_recursively

#: The time of a convolution grows with sigma: beyond this it would seem to hang.
_MAX_SIGMA_PX = 1000


class GaussianKernel(Choice):
    """Discrete approximations of the Gaussian."""

    SAMPLED = "sampled"  #: the Gaussian's values at the pixels, normalised to sum 1 (IU 3.3.1)
    DISCRETE = "discrete"  #: T(n, t) = exp(-t) I_n(t): exact scale space at any sigma (Lindeberg 1990)
    RECURSIVE = "recursive"  #: infinite response at a time that does not depend on sigma (Deriche 1993)


def smooth(
    image: Image,
    sigma: float,
    kernel: GaussianKernel | str = GaussianKernel.SAMPLED,
    border: Border | str = Border.REFLECTED,
    value: float = 0.0,
) -> Image:
    """Convolve with a Gaussian.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    sigma : px, 0 to 1000. The sampled kernel reaches 4 sigma, 3 sigma for uint8; the discrete one until 1e-5 lies
        beyond, 2e-3 for uint8; the recursive one reaches on for ever
    kernel : how the Gaussian is made discrete. Sampled is the fastest up to sigma 5 to 10, recursive beyond; discrete
        is exact below sigma 0.8, where the sampled one's variance falls short
    border, value : what stands outside the image

    Returns
    -------
    Same shape and data type.

    Raises
    ------
    ShapeError
        If `image` is not such an image or its values leave float32, sigma or the value lies outside its range, or the
        kernel or border is unknown.

    Notes
    -----
    Source: IU 2.2.4, 3.3.1, 3.3.2.

    Examples
    --------
    >>> image = np.array([[0, 0, 100, 0, 0]], np.uint8)
    >>> [smooth(image, 1.0, kernel).tolist()[0] for kernel in ("sampled", "discrete", "recursive")]
    [[11, 25, 40, 25, 11], [10, 22, 47, 22, 10], [11, 25, 40, 25, 11]]
    """
    sigma = as_number(sigma, "sigma")
    value = as_number(value, "value")
    image = as_image(image, channels=(1, 3))
    if not 0 <= sigma <= _MAX_SIGMA_PX:
        raise ShapeError(f"sigma: {sigma!r}; need 0 to {_MAX_SIGMA_PX} px")
    function, border = _KERNELS[GaussianKernel(kernel)], Border(border)
    border_values(image.dtype, border, value)
    require_range(image, 4.0)
    return image if sigma == 0 else function(image, sigma, border, value)


def _sampled(image: Image, sigma: float, border: Border, value: float) -> Image:
    # Beyond 3 sigma an 8-bit picture does not change.
    reach = math.ceil((3 if image.dtype == np.uint8 else 4) * sigma)
    size = 2 * reach + 1

    def filtered(picture: Image, cv_border: int) -> Image:
        return cv2.GaussianBlur(picture, (size, size), sigmaX=sigma, sigmaY=sigma, borderType=cv_border)

    return _continued(image, reach, border, value, filtered)


def _discrete(image: Image, sigma: float, border: Border, value: float) -> Image:
    weights = _discrete_weights(float(sigma), image.dtype == np.uint8)

    def filtered(picture: Image, cv_border: int) -> Image:
        return cv2.sepFilter2D(picture, -1, weights, weights, borderType=cv_border)

    return _continued(image, len(weights) // 2, border, value, filtered)


def _recursive(image: Image, sigma: float, border: Border, value: float) -> Image:
    # Below its range a Gaussian's weight beside the pixel is under 1e-20.
    return image if sigma < SIGMA_RANGE_PX[0] else smooth_recursively(image, sigma, border, value)


@lru_cache(maxsize=64)
def _discrete_weights(sigma: float, few: bool) -> Floats:
    weights = discrete_gaussian(sigma, discrete_reach(sigma, 2e-3 if few else 1e-5))
    return np.asarray(weights / weights.sum())


def _continued(
    image: Image, reach: int, border: Border, value: float, filtered: Callable[[Image, int], Image]
) -> Image:
    """Filter, with a margin put around the image for the borders that OpenCV's filters do not have."""
    if border is not Border.PERIODIC and (border is not Border.CONSTANT or value == 0):
        return filtered(image, CV_BORDERS[border])
    wide = filtered(padded(image, reach, reach, border, value), CV_BORDERS[Border.REPLICATED])
    return np.ascontiguousarray(wide[reach : reach + image.shape[0], reach : reach + image.shape[1]])


_KERNELS: dict[GaussianKernel, Callable[[Image, float, Border, float], Image]] = {
    GaussianKernel.SAMPLED: _sampled,
    GaussianKernel.DISCRETE: _discrete,
    GaussianKernel.RECURSIVE: _recursive,
}
