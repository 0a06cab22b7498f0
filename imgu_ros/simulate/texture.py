# SPDX-License-Identifier: Apache-2.0
"""Procedural textures: detail at every scale, colourful, the same for the same seed."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import fft

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image

_SUPERSAMPLING = 2
_SHAPES_PER_MEGAPIXEL = 6000
_SMALLEST_PX = 2.5
_DISC_CORNERS = 24


def procedural_texture(width: int = 1280, height: int = 960, seed: int = 0) -> Image:
    """Return a colourful texture with edges and corners at every scale.

    Dead leaves: opaque shapes whose sizes follow a power law hide each other, which gives the statistics of natural
    scenes under any magnification (Lee, Mumford & Huang 2001); fractal noise modulates them.

    Parameters
    ----------
    width, height : px, at least 16
    seed : chooses the texture

    Returns
    -------
    (height, width, 3) uint8, RGB as a screen or printer expects it (sRGB)

    Raises
    ------
    ShapeError
        If the size is too small.
    """
    if min(width, height) < 16:
        raise ShapeError(f"texture size: {width} x {height}; need at least 16 x 16 px")
    rng = np.random.default_rng([seed, 0x7E87])
    canvas = _base_colors(width, height, rng)
    canvas = cv2.resize(canvas, (width * _SUPERSAMPLING, height * _SUPERSAMPLING), interpolation=cv2.INTER_LINEAR)
    for polygon, color in _shapes(width, height, rng):
        cv2.fillPoly(canvas, [np.round(polygon * (_SUPERSAMPLING * 16)).astype(np.int32)], color, cv2.LINE_8, 4)
    leaves = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA).astype(np.float64)
    shade = fractal_noise(width, height, 1.0, rng)
    return np.clip(np.round(leaves * (1 + 0.16 * shade[:, :, None])), 0, 255).astype(np.uint8)


def wall_texture(side: int = 1024, seed: int = 0) -> Image:
    """Return a plain rough wall, (side, side) float32 around 1, that repeats without a seam."""
    rng = np.random.default_rng([seed, 0x3A11])
    noise = fractal_noise(side, side, 1.3, rng)
    return np.clip(1 + 0.2 * noise, 0.3, 1.7).astype(np.float32)


def fractal_noise(width: int, height: int, exponent: float, rng: np.random.Generator) -> Floats:
    """Return periodic noise with amplitude 1 / frequency^exponent, (height, width), mean 0, variance 1."""
    frequency = np.hypot(fft.fftfreq(height)[:, None], fft.rfftfreq(width)[None, :])
    frequency[0, 0] = np.inf
    real, imaginary = rng.standard_normal((2, *frequency.shape))
    noise: Floats = fft.irfft2((real + 1j * imaginary) / frequency**exponent, s=(height, width))
    return np.asarray(noise / noise.std(), np.float64)


def _base_colors(width: int, height: int, rng: np.random.Generator) -> Image:
    # So smooth that a fourth of the resolution is enough.
    channels = [128 + 45 * fractal_noise(width // 4, height // 4, 1.5, rng) for _ in range(3)]
    return np.clip(np.stack(channels, axis=2), 0, 255).astype(np.uint8)


def _shapes(width: int, height: int, rng: np.random.Generator) -> list[tuple[Floats, tuple[float, ...]]]:
    """Return polygons, (N, 2) px, with colours, in the order of drawing."""
    count = max(40, round(_SHAPES_PER_MEGAPIXEL * width * height / 1e6))
    largest = 0.22 * min(width, height)
    # Radii with density r^-2.5, a little more area in each larger octave, because the large ones are drawn first: in
    # random order they would hide the small ones.
    ends = np.array([_SMALLEST_PX, max(largest, 2 * _SMALLEST_PX)]) ** -1.5
    radii = np.sort((ends[0] - rng.random(count) * (ends[0] - ends[1])) ** (-1 / 1.5))[::-1]
    radii = radii * np.exp(rng.normal(0, 0.25, count))
    centres = rng.random((count, 2)) * (width, height)
    corners = rng.integers(3, 8, count)
    corners[corners == 7] = _DISC_CORNERS
    turn, stretch = (
        rng.uniform(0, 2 * np.pi, count),
        np.where(corners == _DISC_CORNERS, 1.0, rng.uniform(0.4, 1.0, count)),
    )
    jitter = np.where((corners == _DISC_CORNERS)[:, None], 0.0, rng.uniform(-0.3, 0.3, (count, _DISC_CORNERS)))
    angles = 2 * np.pi * (np.arange(_DISC_CORNERS) + jitter) / corners[:, None]
    x, y = radii[:, None] * np.cos(angles), (radii * stretch)[:, None] * np.sin(angles)
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    rings = np.stack((c * x - s * y + centres[:, :1], s * x + c * y + centres[:, 1:]), axis=2)
    colors = _colors(count, rng).tolist()
    return [(ring[:n], tuple(color)) for ring, n, color in zip(rings, corners, colors, strict=True)]


def _colors(count: int, rng: np.random.Generator) -> Floats:
    """Return (count, 3) colours: any hue, from pastel to vivid, brightness spread wide."""
    hue, saturation, value = rng.random(count), rng.beta(1.3, 1.3, count), rng.uniform(30, 250, count)
    phase = 6 * hue[:, None] + np.array([0.0, 4.0, 2.0])
    pure = np.clip(np.abs(phase % 6 - 3) - 1, 0, 1)
    colors: Floats = np.round(value[:, None] * (1 - saturation[:, None] * (1 - pure)))
    return colors
