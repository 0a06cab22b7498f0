# SPDX-License-Identifier: Apache-2.0
"""Image derivatives (IU 2.2.5, 2.2.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.arguments import as_number
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Floats, Image, as_image
from imgu_ros.vision.processing.borders import Border
from imgu_ros.vision.processing.convolution import convolve_separable
from imgu_ros.vision.processing.points import require_range

_SIGMA_RANGE = (0.3, 100.0)


class Derivative(Choice):
    """Operators of first derivatives."""

    SOBEL = "sobel"  #: (1 2 1)/4 across, (1 0 -1)/2 along
    SCHARR = "scharr"  #: (3 10 3)/16 across: the direction is right to a degree or so at every angle
    GAUSSIAN = "gaussian"  #: the derivative of a Gaussian: smooths by sigma as it derives


@dataclass(frozen=True, slots=True, eq=False)
class Gradient:
    """First derivatives of an image.

    Attributes
    ----------
    dx, dy : (H, W) float32, the image's values per px, x right, y down
    """

    dx: Image
    dy: Image

    @property
    def magnitude(self) -> Image:
        """Length of the gradient, (H, W) float32, values per px; its square is `edge_strength`."""
        return cv2.magnitude(self.dx, self.dy)

    @property
    def direction(self) -> Image:
        """Direction of the steepest rise, (H, W) float32 rad in [-pi, pi], from x towards y; 0 where it is flat."""
        return np.arctan2(self.dy, self.dx)


def gradient(
    image: Image,
    operator: Derivative | str = Derivative.SOBEL,
    sigma: float = 1.0,
    border: Border | str = Border.REFLECTED,
) -> Gradient:
    """Return the derivatives along x and y.

    Scaled to the image's values per px: exact on polynomials of degree 2 away from the borders, whichever operator.

    Parameters
    ----------
    image : (H, W), uint8, uint16 or float32
    operator : sobel, scharr or gaussian
    sigma : px, 0.3 to 100; of the Gaussian, which reaches 4 sigma
    border : what stands outside the image; a constant border is 0

    Raises
    ------
    ShapeError
        If `image` is not such an image or too large in value, sigma lies outside its range, or a name is unknown.

    Notes
    -----
    Source: IU 2.2.5, whose kernels lack the factor 1/8; Scharr 2000, section 9.

    Examples
    --------
    >>> ramp = np.tile(np.arange(0, 15, 3, dtype=np.uint8), (5, 1))
    >>> slope = gradient(ramp, "scharr")
    >>> slope.dx[2].tolist(), slope.dy[2].tolist()
    ([0.0, 3.0, 3.0, 3.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0])
    """
    sigma = as_number(sigma, "sigma")
    image = as_image(image)
    require_range(image, 4.0)
    operator = Derivative(operator)
    if operator is Derivative.GAUSSIAN:
        if not _SIGMA_RANGE[0] <= sigma <= _SIGMA_RANGE[1]:
            raise ShapeError(f"sigma: {sigma!r}; need {_SIGMA_RANGE[0]:g} to {_SIGMA_RANGE[1]:g} px")
        across, along = _gaussian(sigma)
    else:
        across, along = _ACROSS[operator], _CENTRAL
    return Gradient(convolve_separable(image, across, along, border), convolve_separable(image, along, across, border))


def _gaussian(sigma: float) -> tuple[Floats, Floats]:
    """Return the Gaussian of sum 1 and its derivative, of which the first moment is -1: a ramp's slope comes out."""
    reach = max(1, math.ceil(4 * sigma))
    n = np.arange(-reach, reach + 1, dtype=np.float64)
    weights = np.exp(-0.5 * (n / sigma) ** 2)
    return weights / weights.sum(), -n * weights / (n**2 * weights).sum()


#: Convolution flips it: (I(x + 1) - I(x - 1)) / 2.
_CENTRAL = np.array([0.5, 0.0, -0.5])
_ACROSS: dict[Derivative, Floats] = {
    Derivative.SOBEL: np.array([1.0, 2.0, 1.0]) / 4,
    Derivative.SCHARR: np.array([3.0, 10.0, 3.0]) / 16,
}
