# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.keypoints.dog import detect_dog
from imgu_ros.vision.keypoints.dog_centres import refined_centres

#: Ratio of the blurs of two successive scales, three an octave.
STEP = 2 ** (1 / 3)


def blob(center, sigma, contrast, ramp=(0.0, 0.0), size=(200, 180)):
    """A Gaussian blob on a ramp, rounded to grey values."""
    x, y = np.meshgrid(np.arange(size[0]) - center[0], np.arange(size[1]) - center[1])
    light = 128 + contrast * np.exp(-(x**2 + y**2) / (2 * sigma**2)) + ramp[0] * x + ramp[1] * y
    return np.rint(light).clip(0, 255).astype(np.uint8)


def blob_sigma(scale):
    """Sigma of the Gaussian blob that is an extremum at a scale.

    A blob of variance S under blurs of variance u and k^2 u differs at its centre by S / (S + k^2 u) - S / (S + u),
    which is extremal where u = S / k; blurs are counted from that of half a pixel that pictures are taken to have.
    """
    return math.sqrt(STEP * scale**2 + 0.25)


@pytest.mark.parametrize("sigma", [2.0, 2.5, 3.0, 4.2, 5.0, 6.3, 8.0])
@pytest.mark.parametrize("contrast", [100, -100])
@pytest.mark.parametrize("center", [(100.3, 90.6), (99.72, 88.13)])
def test_blobs_to_a_tenth_of_a_pixel_and_five_percent(sigma, contrast, center):
    found = detect_dog(blob(center, sigma, contrast), 20)
    assert found.response[0] == found.response.max()
    assert np.hypot(*(found.xy[0] - center)) < 0.1
    assert blob_sigma(found.scale[0]) == pytest.approx(sigma, rel=0.05)


@pytest.mark.parametrize("sigma", [12.0, 20.0, 32.0])
def test_large_blobs_to_a_tenth_of_a_pixel_too(sigma):
    rng = np.random.default_rng(int(sigma))
    side = int(16 * sigma + 60)
    for center in side / 2 + rng.uniform(-4, 4, (3, 2)):
        found = detect_dog(blob(center, sigma, 100, size=(side, side)), 20)
        assert np.hypot(*(found.xy[0] - center)) < 0.1
        assert blob_sigma(found.scale[0]) == pytest.approx(sigma, rel=0.05)


@pytest.mark.parametrize("sigma", [2.0, 6.0, 25.0])
@pytest.mark.parametrize("stretch", [1.0, 1.5])
def test_centres_are_found_from_a_tenth_of_the_scale_off(sigma, stretch):
    rng = np.random.default_rng(3)
    side = int(14 * sigma + 41)  # odd: no whole number of reduced pixels
    center = side / 2 + rng.uniform(-3, 3, 2)
    x, y = np.meshgrid(np.arange(side) - center[0], np.arange(side) - center[1])
    light = 128 - 90 * np.exp(-((x / stretch) ** 2 + y**2) / (2 * sigma**2)) + rng.normal(0, 1, x.shape)
    start = center + 0.1 * sigma * rng.normal(size=(20, 2))
    found = refined_centres(np.rint(light).astype(np.uint8), start, np.full(20, sigma / STEP**0.5))
    assert np.abs(found - center).max() < 0.05
    assert np.ptp(found, axis=0).max() < 0.01  # wherever they started


def test_points_that_are_no_extrema_stay():
    # A saddle, a flat picture, a place far from the blob, one outside.
    x, y = np.meshgrid(np.arange(101.0) - 50, np.arange(101.0) - 50)
    saddle = np.rint(128 + 60 * np.sin(x / 9) * np.sin(y / 9)).astype(np.uint8)
    assert refined_centres(saddle, [[50.2, 50.1]], [4.0]).tolist() == [[50.2, 50.1]]
    flat = np.full((101, 101), 9, np.uint8)
    assert refined_centres(flat, [[50.2, 50.1], [0, 0]], [4.0, 30.0]).tolist() == [[50.2, 50.1], [0, 0]]
    one = blob((50, 50), 4, 100, size=(101, 101))
    assert refined_centres(one, [[56.0, 50], [200, 50]], [3.6, 3.6]).tolist() == [[56.0, 50], [200, 50]]
    assert refined_centres(one, np.zeros((0, 2)), []).shape == (0, 2)


@pytest.mark.parametrize("scale", [[1.0], [0.0, 1.0], [1.0, np.nan], [1.0, 1e5], [[1.0, 1.0]]])
def test_scales_of_centres_are_checked(scale):
    with pytest.raises(ShapeError, match="scale"):
        refined_centres(np.zeros((9, 9), np.uint8), [[1, 1], [2, 2]], scale)


@pytest.mark.parametrize("sigma", [2.0, 3.0, 5.0, 8.0])
def test_orientation_to_two_degrees(sigma):
    # The gradients of a round blob point everywhere alike: the direction is that of the steep ramp below it.
    rng = np.random.default_rng(int(sigma))
    errors = []
    for direction in np.radians(np.arange(-180, 180, 29)):
        center = (100, 90) + rng.uniform(-0.5, 0.5, 2)
        ramp = (15 / sigma * math.cos(direction), 15 / sigma * math.sin(direction))
        found = detect_dog(blob(center, sigma, 30, ramp), 20)
        near = np.hypot(*(found.xy - center).T) < sigma / 2
        assert np.count_nonzero(near) == 1
        assert -math.pi <= found.angle[near][0] < math.pi
        errors.append((found.angle[near][0] - direction + math.pi) % (2 * math.pi) - math.pi)
    assert np.abs(errors).max() < math.radians(2)


def test_several_directions_make_several_keypoints():
    # The corner of four fields has four strong directions at one place.
    picture = np.full((120, 120), 60, np.uint8)
    picture[60:, 60:] = picture[:60, :60] = 180
    found = detect_dog(picture, 100)
    places = {tuple(xy) for xy in found.xy.round(3).tolist()}
    assert len(places) < len(found.xy)


def test_edges_and_faint_structures_are_rejected():
    edge = np.full((120, 120), 60, np.uint8)
    edge[:, 60:] = 180
    away = np.abs(detect_dog(edge, 100).xy[:, 1] - 59.5) < 40  # the picture's own border bends the edge
    assert not away.any()
    assert len(detect_dog(blob((60.2, 60.4), 4.0, 6, size=(120, 120)), 100).xy) == 0


@pytest.mark.parametrize("count", [0, -3])
def test_counts_are_positive(count):
    with pytest.raises(ShapeError, match=r"^max_count: [^\n]+need[^\n]+$"):
        detect_dog(np.zeros((40, 40), np.uint8), count)
