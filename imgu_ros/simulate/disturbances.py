# SPDX-License-Identifier: Apache-2.0
"""What spoils a picture before the sensor sees it: things in the way, highlights, blur, uneven and unsteady light.

Everything works on light, before noise and quantisation: float32, 1 saturates the sensor. What hides a part of the
target is bound to the target's plane, so that the share that it hides is known exactly.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Matrix3
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic
from imgu_ros.vision.formation.optics import disc_kernel
from imgu_ros.vision.formation.shutter import motion_kernel

#: Nodes of a field along the target's width and height, and how far it goes beyond the target, in widths and heights.
_NODES = (128, 96)
_BEYOND = 0.35
#: Size of the things in the way, in the target's widths.
_GRAIN = 0.11
#: How fast a highlight fades out at its rim: e-folds for each standard deviation of its field.
_FADING = 6.0
_BRIGHTEST = 3.0


class TargetField:
    """A smooth random function over the target's plane that changes with time; its level sets are blobs.

    Parameters
    ----------
    template_size : width, height of the template, px
    seed : chooses the function
    """

    def __init__(self, template_size: tuple[int, int], seed: int) -> None:
        rng = np.random.default_rng([seed, 0xF1E1])
        columns, rows = (round(n * (1 + 2 * _BEYOND)) for n in _NODES)
        noise = rng.standard_normal((2, rows, columns)).astype(np.float32)
        sigma = _GRAIN * _NODES[0]
        self._parts = [cv2.GaussianBlur(n, (0, 0), sigma) for n in noise]
        self._parts = [part / part.std() for part in self._parts]
        scale = np.array([template_size[0] / _NODES[0], template_size[1] / _NODES[1]])
        first = (np.array([columns, rows]) - _NODES) / 2
        self._template_from_field = np.diag([scale[0], scale[1], 1.0])
        # Node k of the target covers the k-th part of its width: centres at halves.
        self._template_from_field[:2, 2] = scale * (0.5 - first) - 0.5
        # Blobs end before the field does.
        from_edge = [
            np.minimum(np.arange(n), np.arange(n)[::-1]) / (_BEYOND * m)
            for n, m in ((rows, _NODES[1]), (columns, _NODES[0]))
        ]
        self._rim = (12 * (np.minimum(from_edge[0][:, None], from_edge[1][None, :]) - 0.4)).astype(np.float32)
        self._inside = (
            slice(round(first[1]), round(first[1]) + _NODES[1]),
            slice(round(first[0]), round(first[0]) + _NODES[0]),
        )

    def above(self, share: float, phase_rad: float) -> Image:
        """Return the function less its quantile, (rows, columns): positive on `share` of the target's area."""
        if not 0 < share < 1:
            raise ShapeError(f"share: {share:g}; need more than 0 and less than 1")
        field = math.cos(phase_rad) * self._parts[0] + math.sin(phase_rad) * self._parts[1]
        field = field - np.float32(np.quantile(field[self._inside], 1 - share))
        return np.asarray(np.minimum(field, self._rim), np.float32)

    def in_image(self, field: Image, H_image_template: Matrix3, size: tuple[int, int]) -> Image:
        """Return a field as the image shows it, (height, width) float32; far below zero where it does not reach."""
        H = H_image_template @ self._template_from_field
        return cv2.warpPerspective(field, H, size, flags=cv2.INTER_LINEAR, borderValue=-100.0)


def covered(light: Image, field_in_image: Image, cover: Image) -> Image:
    """Return the light with an opaque cover where the field is positive, its edge blended over one pixel.

    Parameters
    ----------
    light, cover : (H, W) or (H, W, 3) float32, both alike
    field_in_image : (H, W)
    """
    slope = np.hypot(cv2.Sobel(field_in_image, -1, 1, 0, scale=1 / 8), cv2.Sobel(field_in_image, -1, 0, 1, scale=1 / 8))
    share = np.clip(np.float32(0.5) + field_in_image / np.maximum(slope, np.float32(1e-6)), 0, 1)
    if light.ndim == 3:
        share = share[:, :, None]
    return np.asarray(light + share * (cover - light), np.float32)


def highlighted(light: Image, field_in_image: Image) -> Image:
    """Return the light with highlights that saturate every pixel where the field is positive, and fade out around."""
    glare = np.minimum(np.exp(np.minimum(_FADING * field_in_image, 2.0)), _BRIGHTEST).astype(np.float32)
    return np.asarray(light + (glare[:, :, None] if light.ndim == 3 else glare), np.float32)


def cover_texture(picture: Image, size: tuple[int, int], angle_rad: float) -> Image:
    """Return the surface of things in the way: a picture, turned, over the whole image: (height, width, 3) linear."""
    height, width = picture.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), math.degrees(angle_rad), 1.0)
    turn[:, 2] += (size[0] / 2 - width / 2, size[1] / 2 - height / 2)
    turned = cv2.warpAffine(picture, turn, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray((turned.astype(np.float32) / 255) ** np.float32(2.2), np.float32)


def motion_blurred(light: Image, length_px: float, angle_rad: float) -> Image:
    """Return the light of a camera that turns evenly while the shutter is open: a line of `length_px`, (H, W, 3)."""
    velocity = np.array([math.cos(angle_rad), math.sin(angle_rad)]) * length_px
    return _filtered(light, motion_kernel(velocity, 1.0))


def defocused(light: Image, diameter_px: float) -> Image:
    """Return the light of a defocused lens: every point becomes a disc, (H, W, 3)."""
    return _filtered(light, disc_kernel(diameter_px))


def vignetting(size: tuple[int, int], lost: float) -> Image:
    """Return the share of the light that each pixel gets, (height, width): 1 in the middle, 1 - `lost` in corners."""
    width, height = size
    x, y = (np.arange(n, dtype=np.float32) - np.float32((n - 1) / 2) for n in (width, height))
    r2 = (x[None, :] ** 2 + y[:, None] ** 2) / np.float32(((width - 1) ** 2 + (height - 1) ** 2) / 4)
    return np.asarray(1 - np.float32(lost) * r2, np.float32)


def flicker(height: int, amplitude: float, phase_rad: float, periods: float = 1.5) -> Image:
    """Return the brightness of each row under a lamp that follows the mains, (height, 1), mean about 1."""
    rows = np.linspace(0, 2 * math.pi * periods, height, endpoint=False)
    return np.asarray(1 + amplitude * np.sin(rows + phase_rad), np.float32)[:, None]


def electrons_for_snr(snr: float, read_noise_e: float) -> float:
    """Return how many electrons have this mean over standard deviation: m / sqrt(m + read^2)."""
    half = snr**2 / 2
    return half + math.hypot(half, snr * read_noise_e)


def as_mosaic(light: Image, pattern: BayerPattern) -> Image:
    """Return what the sites of a Bayer sensor see of colours, (H, W); light that is mosaicked already stays."""
    return light if light.ndim == 2 else mosaic(light, pattern)


def _filtered(light: Image, kernel: Image) -> Image:
    return cv2.filter2D(light, -1, np.asarray(kernel, np.float32), borderType=cv2.BORDER_REFLECT)
