# SPDX-License-Identifier: Apache-2.0
"""Values of pictures and light: the transfer function of sRGB (IEC 61966-2-1).

Image files and printers speak sRGB, in which equal steps look equal; a sensor's raw values go with the light. What is
printed from the one and seen by the other has less contrast in the shadows and more in the lights.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imgu_ros.types import Image, as_image


def light_of_srgb() -> NDArray[np.float64]:
    """Return the light, 0 to 1, that each of the 256 values of sRGB stands for, (256,).

    Examples
    --------
    >>> light_of_srgb()[[0, 128, 255]].round(4).tolist()
    [0.0, 0.2159, 1.0]
    """
    v = np.arange(256) / 255
    return np.asarray(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4), np.float64)


def linear_from_srgb(image: Image) -> Image:
    """Return an sRGB picture as a sensor without a transfer function would give it.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8

    Returns
    -------
    As `image`

    Raises
    ------
    ShapeError
        If it is no such picture.

    Examples
    --------
    >>> linear_from_srgb(np.array([[0, 128, 255]], np.uint8)).tolist()
    [[0, 55, 255]]
    """
    image = as_image(image, "image", (1, 3), (np.uint8,))
    return np.rint(255 * light_of_srgb()).astype(np.uint8)[image]


def srgb_from_linear(image: Image) -> Image:
    """Return a picture whose values go with the light as sRGB, to be looked at.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8

    Returns
    -------
    As `image`

    Raises
    ------
    ShapeError
        If it is no such picture.

    Examples
    --------
    >>> srgb_from_linear(np.array([[0, 55, 255]], np.uint8)).tolist()
    [[0, 128, 255]]
    """
    image = as_image(image, "image", (1, 3), (np.uint8,))
    light = np.arange(256) / 255
    values = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * values).astype(np.uint8)[image]
