# SPDX-License-Identifier: Apache-2.0
"""SIFT against its definition (Lowe 2004, section 6), written down once more."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage

from imgu_ros.vision.descriptors.sift import describe_rootsift, describe_sift
from imgu_ros.vision.keypoints.keypoints import Corners


def texture(seed, size=121):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(size, size)), 2.5)
    return np.clip(128 + 300 * noise, 0, 255).astype(np.uint8)


def histograms(picture, x, y, sigma, angle):
    """4x4 histograms of 8 directions with trilinear weights, [row, column, direction], neither clipped nor scaled."""
    smoothed = ndimage.gaussian_filter(picture.astype(float), math.sqrt(1.6**2 - 0.5**2))
    rows, columns = np.mgrid[1 : picture.shape[0] - 1, 1 : picture.shape[1] - 1]
    dx = (smoothed[1:-1, 2:] - smoothed[1:-1, :-2]).ravel()
    dy = (smoothed[2:, 1:-1] - smoothed[:-2, 1:-1]).ravel()
    c, s, width = math.cos(angle), math.sin(angle), 3 * sigma
    u = ((columns - x) * c + (rows - y) * s).ravel() / width
    v = (-(columns - x) * s + (rows - y) * c).ravel() / width
    near = (np.abs(u) < 2.5) & (np.abs(v) < 2.5)
    u, v, dx, dy = u[near], v[near], dx[near], dy[near]
    weight = np.hypot(dx, dy) * np.exp(-(u**2 + v**2) / 8)
    # Directions run against the clock as seen, from the keypoint's own.
    direction = (-(np.arctan2(dy, dx) - angle) % (2 * math.pi)) * 8 / (2 * math.pi)
    table = np.zeros((7, 7, 8))
    places = (v + 2.5, u + 2.5, direction)
    lower = [np.floor(p).astype(int) for p in places]
    part = [p - low for p, low in zip(places, lower, strict=True)]
    for a in (0, 1):
        for b in (0, 1):
            for o in (0, 1):
                share = math.prod([p if bit else 1 - p for p, bit in zip(part, (a, b, o), strict=True)])
                np.add.at(table, (lower[0] + a, lower[1] + b, (lower[2] + o) % 8), weight * share)
    return table[1:5, 1:5]


def by_definition(picture, x, y, sigma, angle):
    row = histograms(picture, x, y, sigma, angle).ravel()
    row = np.minimum(row / np.linalg.norm(row), 0.2)
    return row / np.linalg.norm(row)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.5])
@pytest.mark.parametrize("sigma", [1.6, 2.4])
def test_descriptor_is_that_of_the_definition(angle, sigma):
    picture = texture(1)
    xy = np.array([[60.0, 60.0], [55.0, 68.0], [66.0, 52.0]])
    n = len(xy)
    got = describe_sift(picture, Corners(xy, np.full(n, sigma), np.full(n, angle), np.ones(n))).descriptors
    for row, (x, y) in zip(got, xy, strict=True):
        expected = by_definition(picture, x, y, sigma, angle)
        unit = row / np.linalg.norm(row)
        assert unit @ expected > 0.995
        assert np.abs(unit - expected).max() < 0.03


def test_clipped_at_a_fifth_and_normalised_again():
    # One edge: few bins hold nearly all, and are cut to 0.2 before the second normalisation, so that they are equal.
    picture = np.full((121, 121), 40, np.uint8)
    picture[:, 60:] = 200
    corner = Corners(np.array([[59.5, 60.0]]), np.array([2.0]), np.zeros(1), np.ones(1))
    row = describe_sift(picture, corner).descriptors[0]
    plain = histograms(picture, 59.5, 60.0, 2.0, 0.0).ravel()
    plain /= np.linalg.norm(plain)
    clipped = plain > 0.25
    assert 4 <= clipped.sum() <= 8
    assert np.ptp(row[clipped]) <= 2 and row[clipped].min() == pytest.approx(row.max(), abs=2)
    assert np.linalg.norm(row) == pytest.approx(512, abs=8)


@pytest.mark.parametrize("describing", [describe_sift, describe_rootsift])
@pytest.mark.parametrize("turns", [1, 2, 3])
def test_quarter_turns(describing, turns):
    picture = texture(2)
    xy, angle = np.array([[60.0, 60.0], [50.0, 66.0]]), np.array([0.3, -1.2])
    turned = xy
    for _ in range(turns):
        turned = np.column_stack((turned[:, 1], 120 - turned[:, 0]))
    size, ones = np.full(2, 2.0), np.ones(2)
    a = describing(picture, Corners(xy, size, angle, ones)).descriptors
    b = describing(
        np.rot90(picture, turns).copy(), Corners(turned, size, angle - turns * math.pi / 2, ones)
    ).descriptors
    np.testing.assert_allclose(a, b, atol=0.01 * a.max())


def test_offset_changes_nothing_and_gain_hardly():
    picture = texture(3) // 3
    corner = Corners(np.array([[60.0, 60.0]]), np.array([2.0]), np.array([0.5]), np.ones(1))
    plain, brighter, gained = (describe_sift(p, corner).descriptors for p in (picture, picture + 90, picture * 3))
    np.testing.assert_array_equal(plain, brighter)
    np.testing.assert_allclose(plain, gained, atol=4)


def test_twice_the_size():
    # The same structure at twice the scale; the definition's smoothing is relative to a picture's own pixels.
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:161, :161] - 80.0
    waves = [(rng.uniform(-0.4, 0.4, 2), rng.uniform(0, 6)) for _ in range(12)]
    small, large = (
        np.clip(128 + 12 * sum(np.cos(k[0] * x / s + k[1] * y / s + phase) for k, phase in waves), 0, 255)
        for s in (1.0, 2.0)
    )
    rows = [
        describe_rootsift(
            np.rint(picture).astype(np.uint8),
            Corners(np.array([[80.0, 80.0]]), np.array([sigma]), np.array([0.2]), np.ones(1)),
        ).descriptors[0]
        for picture, sigma in ((small, 3.0), (large, 6.0))
    ]
    assert float(rows[0] @ rows[1]) > 0.97


def test_rootsift_distances_are_hellinger_distances():
    picture = texture(5)
    xy = np.array([[60.0, 60.0], [45.0, 70.0]])
    corners = Corners(xy, np.full(2, 2.0), np.zeros(2), np.ones(2))
    sift = describe_sift(picture, corners).descriptors.astype(float)
    root = describe_rootsift(picture, corners).descriptors.astype(float)
    shares = sift / sift.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(root, axis=1), 1, atol=1e-6)
    expected = math.sqrt(2 - 2 * float(np.sqrt(shares[0] * shares[1]).sum()))
    assert float(np.linalg.norm(root[0] - root[1])) == pytest.approx(expected, abs=1e-6)
