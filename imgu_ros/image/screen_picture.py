# SPDX-License-Identifier: Apache-2.0
"""A frame's colours for a screen: white balance, exposure and the sRGB curve for what a sensor gave; for eyes alone."""

from __future__ import annotations

import cv2
import numpy as np

from imgu_ros.types import Floats, Image
from imgu_ros.vision.formation.transfer import encode_light

#: Exponent of the mean in which the channels shall agree: between the grey world (1) and the brightest patch
#: (infinite); 6 was best on sets of photographs (Finlayson & Trezzi, Shades of gray and colour constancy, 2004).
_NORM = 6
#: Sensors see red and blue with a third to all of the sensitivity of green; beyond it a scene is coloured.
_LARGEST_GAIN = 4.0
#: Quantiles of the values that become black and white.
_DARKEST, _BRIGHTEST = 0.002, 0.998
#: Sensor values are brightened by at most this: a dark frame is to look dark.
_MOST_BRIGHTENING = 8.0
#: Every so many pixels are looked at: about 128 x 128 of them.
_SAMPLES = 128
#: Of full scale: values above it may be clipped, and tell no colour.
_SATURATED = 0.98


def screen_picture(color: Image, *, white: float | None, is_light: bool, is_balanced: bool) -> Image:
    """Return a frame's colours as a screen shows them.

    Parameters
    ----------
    color : (H, W, 3) RGB, uint8 or uint16
    white : value of full scale; None: not known, the brightest pixels become white
    is_light : values are proportional to the light: they are brightened until the brightest are white, and given the
        sRGB curve
    is_balanced : a white surface has equal values; otherwise gains are estimated from the picture (shades of grey)

    Returns
    -------
    (H, W, 3) uint8, a new array; values of 8 bits that are for a screen already stay as they are
    """
    if color.dtype == np.uint8 and not is_light and is_balanced:
        return np.array(color)
    step = max(1, min(color.shape[:2]) // _SAMPLES)
    samples = color[::step, ::step].reshape(-1, 3).astype(np.float64)
    low = 0.0 if white is not None else float(np.quantile(samples, _DARKEST))
    full = float(white if white is not None else np.quantile(samples, _BRIGHTEST)) - low
    if full <= 0:
        return np.zeros(color.shape, np.uint8)
    samples = np.clip((samples - low) / full, 0, 1)
    gains = np.ones(3) if is_balanced else _balancing_gains(samples)
    if is_light:
        brightest = float(np.quantile(samples * gains, _BRIGHTEST))
        gains = gains * min(max(1 / max(brightest, 1e-6), 1.0), _MOST_BRIGHTENING)
    return _through_tables(color, low, full, gains, is_light)


def _balancing_gains(samples: Floats) -> Floats:
    """Return gains of red, green and blue, 1 for green, from pixels (N, 3) of which none is saturated."""
    usable = samples[(samples < _SATURATED).all(axis=1)]
    if not len(usable):
        return np.ones(3)
    means = (usable**_NORM).mean(axis=0) ** (1 / _NORM)
    if means.min() <= 0:
        return np.ones(3)
    gains: Floats = np.clip(means[1] / means, 1 / _LARGEST_GAIN, _LARGEST_GAIN)
    return gains


def _through_tables(color: Image, low: float, full: float, gains: Floats, is_light: bool) -> Image:
    """Map every value of each channel through a table; 16 bits as 8 bits of their root, which is nearly as eyes see."""
    indices = np.arange(256.0)
    if color.dtype == np.uint8:
        values, coded = indices, np.ascontiguousarray(color)
    else:
        top = low + full / gains.min()
        values = (indices / 255) ** 2 * top
        coded = cv2.convertScaleAbs(cv2.sqrt(color.astype(np.float32)), alpha=255 / top**0.5)
    light = np.clip((values[:, None] - low) / full * gains, 0, 1)
    tables = np.rint(255 * (encode_light(light, "srgb") if is_light else light)).astype(np.uint8)
    return np.asarray(cv2.LUT(coded, np.ascontiguousarray(tables[None])))
