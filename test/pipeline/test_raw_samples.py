# SPDX-License-Identifier: Apache-2.0
"""Means of a picture over a point spread, against those of a wave, which are known exactly."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from imgu_ros.image.raw_samples import SITE_VARIANCE, light_levels, spread_samples

SIDE = 480


def wave(period: float, angle: float) -> np.ndarray:
    """Return a wave of amplitude 1, by its period in px and its direction, and its slope along x, as arrays of px."""
    y, x = np.mgrid[:SIDE, :SIDE]
    return np.cos(2 * math.pi * (x * math.cos(angle) + y * math.sin(angle)) / period).astype(np.float32)


@pytest.mark.parametrize("texel_px", [0.13, 0.2, 0.36])
@pytest.mark.parametrize("variances", [(0.05, 0.05), (0.25, 0.25), (0.2, 1.2), (1.5, 1.5)])
@pytest.mark.parametrize("period_px", [2.4, 3.5, 6.0])
def test_the_mean_of_a_wave_is_that_over_a_gaussian(
    texel_px: float, variances: tuple[float, float], period_px: float
) -> None:
    """The image is the picture reduced; details of few px of the image have many px of the picture."""
    total = np.array(variances) + SITE_VARIANCE
    rng = np.random.default_rng(7)
    centres = rng.uniform(SIDE * 0.35, SIDE * 0.65, (200, 2))
    for angle in (0.0, 0.6):
        picture = wave(period_px / texel_px, angle)
        levels = light_levels(picture)
        texels_px = [texel_px * float(level.scaling.step[0]) for level in levels]
        level, (values,), taps = spread_samples(levels, texels_px, (float(total[0]), float(total[1])))
        at = (centres[:, None] + taps.offsets / texel_px) / level.scaling.step + (0.5 / level.scaling.step - 0.5)
        sampled = cv2.remap(values, *np.moveaxis(at, 2, 0).astype(np.float32), cv2.INTER_LINEAR)
        frequency = np.array((math.cos(angle), math.sin(angle))) / period_px
        phase = 2 * math.pi * (centres * texel_px) @ frequency
        amplitude = math.exp(-2 * math.pi**2 * float(frequency**2 @ total))
        assert np.abs(sampled @ taps.means[5] - amplitude * np.cos(phase)).max() < 0.035
        # The slopes only tell where to go: of details near the sampling limit they are low.
        slope = -amplitude * 2 * math.pi * frequency[:, None] * np.sin(phase)
        steepest = amplitude * 2 * math.pi / period_px
        assert np.abs(taps.means[:2] @ sampled.T - slope).max() < (0.4 if period_px < 3 else 0.2) * steepest + 0.06


def test_a_blurred_picture_is_kept_and_few_are() -> None:
    (level, *_) = light_levels(np.random.default_rng(1).random((60, 80, 3), np.float32))
    assert level.blurred(0.1)[0] == 0 and len(level.blurred(0.1)[1]) == 3
    for most in (0.4, 0.8, 1.1, 3.0, 100.0):
        variance, channels = level.blurred(most)
        assert 0 < variance <= most
        assert level.blurred(most)[1] is channels
        sharp = level.blurred(0.0)[1]
        assert all(a.var() < b.var() for a, b in zip(channels, sharp, strict=True))
    first = level.blurred(0.4)[1]
    for most in (0.8, 3.0):
        level.blurred(most)
    assert level.blurred(0.4)[1] is not first
