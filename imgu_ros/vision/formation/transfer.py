# SPDX-License-Identifier: Apache-2.0
"""Values of pictures and light: transfer functions, sRGB (IEC 61966-2-1) among them.

Image files and printers speak sRGB, in which equal steps look equal; a sensor's raw values go with the light. What is
printed from the one and seen by the other has less contrast in the shadows and more in the lights. Cameras that deliver
8 bits may apply such a function before they quantise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.types import Choice, Image, as_floats, as_image, require_finite

#: Exponent of the film curve, and light^exponent at the middle of its straight part: 18 % grey gives 0.47, as sRGB does
#: (0.46); full scale is approached at a slope of 0.2 (sRGB: 0.44), and black at none.
_FILM_EXPONENT, _FILM_MIDDLE = 1.2, 0.2


class TransferFunction(Choice):
    """How values follow the light."""

    LINEAR = "linear"  #: proportional to it
    SRGB = "srgb"  #: IEC 61966-2-1
    FILM = "film"  #: a logistic function of the logarithm of the light: toe, straight part and shoulder


def encode_light(light: ArrayLike, transfer: TransferFunction | str) -> NDArray[Any]:
    """Return the values that a camera with a transfer function gives for light.

    The film curve is v = 1.2 p / (p + 0.2) with p = light^1.2: over the logarithm of the light it has the S shape of
    the characteristic curve of photographic film (Hurter & Driffield 1890).

    Parameters
    ----------
    light : any shape, 1 is full scale; what lies beyond 1 or below -1 counts as that. A negative value (of noise about
        black) is encoded as its opposite is.
    transfer : linear, srgb or film

    Returns
    -------
    same shape, -1 to 1, monotone (sRGB to 3e-8, as its constants are rounded); float32 for float32, else float64

    Raises
    ------
    ShapeError
        If a value is not finite, or there is no such function.

    Examples
    --------
    >>> encode_light([0.0, 0.18, 1.0], "srgb").round(3).tolist()
    [0.0, 0.461, 1.0]
    >>> encode_light([0.0, 0.18, 1.0], "film").round(3).tolist()
    [0.0, 0.468, 1.0]
    """
    transfer = TransferFunction(transfer)
    signed = _full_scale(light, "light")
    if transfer is TransferFunction.LINEAR:
        return signed
    x = np.abs(signed)
    if transfer is TransferFunction.SRGB:
        values = _srgb_of_light(x)
    else:
        p = x**_FILM_EXPONENT
        values = (1 + _FILM_MIDDLE) * p / (p + _FILM_MIDDLE)
    return np.asarray(np.copysign(values, signed))


def decode_light(values: ArrayLike, transfer: TransferFunction | str) -> NDArray[Any]:
    """Return the light for which a camera with a transfer function gives these values: `encode_light` undone.

    Parameters
    ----------
    values : any shape, 1 is full scale; what lies beyond 1 or below -1 counts as that
    transfer : linear, srgb or film

    Returns
    -------
    same shape, -1 to 1; float32 for float32, else float64

    Raises
    ------
    ShapeError
        If a value is not finite, or there is no such function.

    Examples
    --------
    >>> decode_light(encode_light([0.02, 0.18, 0.9], "film"), "film").round(6).tolist()
    [0.02, 0.18, 0.9]
    """
    transfer = TransferFunction(transfer)
    signed = _full_scale(values, "values")
    if transfer is TransferFunction.LINEAR:
        return signed
    v = np.abs(signed)
    if transfer is TransferFunction.SRGB:
        light = _light_of_srgb(v)
    else:
        light = (_FILM_MIDDLE * v / (1 + _FILM_MIDDLE - v)) ** (1 / _FILM_EXPONENT)
    return np.asarray(np.copysign(light, signed))


def light_of_srgb() -> NDArray[np.float64]:
    """Return the light, 0 to 1, that each of the 256 values of sRGB stands for, (256,).

    Examples
    --------
    >>> light_of_srgb()[[0, 128, 255]].round(4).tolist()
    [0.0, 0.2159, 1.0]
    """
    return np.asarray(_light_of_srgb(np.arange(256) / 255), np.float64)


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
    return np.rint(255 * _srgb_of_light(np.arange(256) / 255)).astype(np.uint8)[image]


def _light_of_srgb(v: NDArray[Any]) -> NDArray[Any]:
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def _srgb_of_light(light: NDArray[Any]) -> NDArray[Any]:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def _full_scale(values: ArrayLike, name: str) -> NDArray[Any]:
    """Return finite values, clamped to -1 to 1; single precision, in which frames are simulated, stays."""
    array = values if type(values) is np.ndarray and values.dtype == np.float32 else as_floats(values, name)
    return np.asarray(np.clip(require_finite(array, name), -1, 1))
