"""Gaussian smoothing (notes 2.2.4, 3.3.1)."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Image, as_image

#: The time of a convolution grows with sigma: beyond this it would seem to hang.
_MAX_SIGMA_PX = 1000


class GaussianKernel(Choice):
    """Discrete approximations of the Gaussian."""

    SAMPLED = "sampled"  #: the Gaussian's values at the pixels, normalised to sum 1 (notes 3.3.1)


def smooth(image: Image, sigma: float, kernel: GaussianKernel | str = GaussianKernel.SAMPLED) -> Image:
    """Convolve with a Gaussian, borders reflected.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8, uint16 or float32
    sigma : px, 0 to 1000; the sampled kernel reaches 4 sigma, 3 sigma for uint8
    kernel : how the Gaussian is made discrete

    Returns
    -------
    Same shape and data type.

    Raises
    ------
    ShapeError
        If `image` is not such an image, sigma lies outside its range or the kernel is unknown.
    """
    image = as_image(image, channels=(1, 3))
    if not 0 <= sigma <= _MAX_SIGMA_PX:
        raise ShapeError(f"sigma: {sigma!r}; need 0 to {_MAX_SIGMA_PX} px")
    function = _KERNELS[GaussianKernel(kernel)]
    return image if sigma == 0 else function(image, sigma)


def _sampled(image: Image, sigma: float) -> Image:
    # Beyond 3 sigma an 8-bit picture does not change.
    size = 2 * math.ceil((3 if image.dtype == np.uint8 else 4) * sigma) + 1
    return cv2.GaussianBlur(image, (size, size), sigmaX=sigma, sigmaY=sigma, borderType=cv2.BORDER_REFLECT_101)


_KERNELS: dict[GaussianKernel, Callable[[Image, float], Image]] = {GaussianKernel.SAMPLED: _sampled}
