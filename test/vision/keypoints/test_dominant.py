# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.keypoints.dominant import dominant_orientations

CENTER = np.array([60.0, 57.0])


def blob(center, sigma, contrast, ramp=(0.0, 0.0), oblong=1.0, turn=0.0, size=(121, 115)):
    """A Gaussian blob, longer across `turn` when `oblong` exceeds 1, on a ramp."""
    x, y = np.meshgrid(np.arange(size[0]) - center[0], np.arange(size[1]) - center[1])
    along, across = math.cos(turn) * x + math.sin(turn) * y, math.cos(turn) * y - math.sin(turn) * x
    light = contrast * np.exp(-(along**2 * oblong + across**2 / oblong) / (2 * sigma**2))
    return np.rint(128 + light + ramp[0] * x + ramp[1] * y).clip(0, 255).astype(np.uint8)


def difference(angle, expected, period=2 * math.pi):
    return (angle - expected + period / 2) % period - period / 2


def scale_of(sigma):
    """Return the scale at which the difference of Gaussians sees a blob of sigma."""
    return np.array([math.sqrt((sigma**2 - 0.25) / 2 ** (1 / 3))])


@pytest.mark.parametrize("sigma", [2.0, 2.5, 3.0, 4.2, 5.0, 6.3, 8.0])
def test_blobs_on_slopes_and_oblong_blobs_to_two_degrees(sigma):
    """By symmetry the one points up the slope, the others across their length, both ways."""
    rng = np.random.default_rng(int(10 * sigma))
    slopes, oblongs = [], []
    for turn in rng.uniform(-math.pi, math.pi, 25):
        center = CENTER + rng.uniform(-0.5, 0.5, 2)
        ramp = 15 / sigma * np.array([math.cos(turn), math.sin(turn)])
        found = dominant_orientations(blob(center, sigma, 30, ramp), center[None], scale_of(sigma))
        assert found.index.tolist() == [0]
        slopes.append(difference(found.angle[0], turn))
        found = dominant_orientations(blob(center, sigma, 100, oblong=1.5, turn=turn), center[None], scale_of(sigma))
        assert len(found.angle) == 2
        oblongs.extend(difference(found.angle, turn, math.pi))
    assert np.degrees(np.abs(slopes)).max() < 1
    assert np.degrees(np.sqrt(np.mean(np.square(oblongs)))) < 1
    assert np.degrees(np.abs(oblongs)).max() < 2


def by_definition(smooth, x, y, sigma):
    """Return the histogram of gradient directions in the fine picture about a whole pixel, sample by sample."""
    bins = np.zeros(360)
    reach = int(4.5 * sigma)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            gx = float(smooth[y + dy, x + dx + 1]) - float(smooth[y + dy, x + dx - 1])
            gy = float(smooth[y + dy + 1, x + dx]) - float(smooth[y + dy - 1, x + dx])
            weight = math.exp(-(dx * dx + dy * dy) / (2 * (1.5 * sigma) ** 2)) * (dx * dx + dy * dy <= reach * reach)
            bins[round(math.degrees(math.atan2(gy, gx))) % 360] += weight * math.hypot(gx, gy)
    return bins


def test_histogram_by_definition():
    """On waves at random: where a histogram of 360 bins, smoothed as wide as ours, is highest."""
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.arange(161.0), np.arange(161.0))
    sigma = 6.0
    width = np.exp(-(np.minimum(np.arange(360), 360 - np.arange(360)) ** 2) / (2 * 11.0**2))
    for _ in range(6):
        light = np.zeros_like(x)
        for direction, phase, length in zip(*rng.uniform([[0], [0], [30]], [[7], [7], [80]], (3, 5)), strict=True):
            light += np.sin((math.cos(direction) * x + math.sin(direction) * y) * 2 * math.pi / length + phase)
        bins = by_definition(cv2.GaussianBlur(light, (0, 0), math.sqrt(sigma**2 - 0.25)), 80, 80, sigma)
        smooth = np.fft.irfft(np.fft.rfft(bins) * np.fft.rfft(width), 360)
        found = dominant_orientations(light.astype(np.float32), np.array([[80.0, 80.0]]), np.array([sigma]))
        assert smooth[round(math.degrees(found.angle[0])) % 360] > 0.97 * smooth.max()


def test_peaks_of_eighty_percent_are_directions_too():
    picture = np.full((120, 120), 60, np.uint8)
    picture[60:, 60:] = picture[:60, :60] = 180
    found = dominant_orientations(picture, np.array([[59.5, 59.5], [59.5, 20.0]]), np.array([3.0, 3.0]))
    assert found.index.tolist() == [0, 0, 0, 0, 1]
    assert np.sort(np.degrees(found.angle[:4]).round() % 360).tolist() == [0, 90, 180, 270]
    assert abs(np.degrees(difference(found.angle[4], math.pi))) < 0.1


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.floats(1.0, 12.0))
def test_right_angles_gain_and_offset(seed, scale):
    rng = np.random.default_rng(seed)
    picture = rng.uniform(0, 100, (65, 65)).astype(np.float32)
    middle, scale = np.array([[32.0, 32.0]]), np.array([scale])
    plain = dominant_orientations(picture, middle, scale)
    brighter = dominant_orientations(7 * picture + 300, middle, scale)
    np.testing.assert_allclose(difference(brighter.angle[0], plain.angle[0]), 0, atol=2e-3)
    assert (np.diff(plain.index) >= 0).all()
    assert ((plain.angle >= -math.pi) & (plain.angle < math.pi)).all()


def test_twice_as_large_is_the_same():
    rng = np.random.default_rng(7)
    centers, directions = CENTER + rng.uniform(-9, 9, (20, 2)), rng.uniform(-3, 3, 20)
    for center, direction in zip(centers, directions, strict=True):
        ramp = np.array([math.cos(direction), math.sin(direction)])
        small = blob(center, 3.0, 40, 4 * ramp)
        large = blob(2 * center + 0.5, 6.0, 40, 2 * ramp, size=(242, 230))
        one = dominant_orientations(small, center[None], scale_of(3.0)).angle[0]
        two = dominant_orientations(large, 2 * center[None] + 0.5, scale_of(6.0)).angle[0]
        assert abs(difference(one, two)) < math.radians(1)


def test_no_contrast_is_zero_and_no_points_none():
    flat = np.full((40, 50), 0.1, np.float32)
    found = dominant_orientations(flat, np.array([[20.2, 30.0], [0.0, 0.0]]), np.array([2.0, 30.0]))
    assert found.index.tolist() == [0, 1]
    assert found.angle.tolist() == [0.0, 0.0]
    assert len(dominant_orientations(flat, np.zeros((0, 2)), np.zeros(0)).angle) == 0


def test_extremes_are_finite():
    picture = (np.random.default_rng(0).random((30, 40)) * 3e38).astype(np.float32)
    xy = np.array([[-1e5, 5.0], [0.0, 0.0], [39.0, 29.0], [20.0, 15.0]])
    found = dominant_orientations(picture, xy, np.array([1e-3, 1e5, 0.5, 3.0]))
    assert np.isfinite(found.angle).all()
    assert np.isfinite(dominant_orientations(np.full((1, 1), 7, np.uint8), xy, np.full(4, 2.0)).angle).all()


def test_bad_input_is_refused():
    picture = np.zeros((20, 20), np.uint8)
    for xy, scale in (
        ([[3.0, 4.0]], [0.0]),
        ([[3.0, 4.0]], [-1.0]),
        ([[3.0, 4.0]], [math.inf]),
        ([[3.0, 4.0]], [1.0, 2.0]),
        ([[1e9, 4.0]], [1.0]),
        ([[math.nan, 4.0]], [1.0]),
    ):
        with pytest.raises(ShapeError):
            dominant_orientations(picture, np.array(xy), np.array(scale))
