# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from imgu_ros.errors import ShapeError
from imgu_ros.vision.descriptors.brief import brief_pairs, describe_brief
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.matching.nearest import match


def corners_at(xy):
    ones = np.ones(len(xy))
    return Corners(np.asarray(xy, float), 1.5 * ones, 0 * ones, ones)


def bits_of(picture, xy, pairs):
    """The definition: which of two pixels is darker, pair by pair."""
    rows = []
    for x, y in xy:
        rows.append([picture[y + ay, x + ax] < picture[y + by, x + bx] for (ax, ay), (bx, by) in pairs.tolist()])
    return np.array(rows)


def texture(seed, height=120, width=140):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(height, width)), 2)
    return np.clip(128 + 250 * noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("gradient", [(1, 0), (0, 1), (1, 1), (2, -1)])
def test_bits_of_a_ramp_by_the_definition(gradient):
    # Smoothing leaves a plane as it is: bit k tells on which side of the gradient the second place lies.
    y, x = np.mgrid[:60, :60]
    picture = (gradient[0] * x + gradient[1] * y + 60).astype(np.uint8)
    pairs = brief_pairs()
    got = np.unpackbits(describe_brief(picture, corners_at([[30, 30]])).descriptors)
    np.testing.assert_array_equal(got, (pairs[:, 1] - pairs[:, 0]) @ np.array(gradient) > 0)


def test_bits_of_a_texture_by_the_definition():
    picture = texture(1)
    xy = [(x, y) for x in range(20, 120, 9) for y in range(20, 100, 9)]
    smoothed = ndimage.gaussian_filter(picture.astype(float), 2.0, truncate=2.0)
    expected = bits_of(smoothed, xy, brief_pairs())
    got = np.unpackbits(describe_brief(picture, corners_at(xy)).descriptors, axis=1)
    assert (got == expected).mean() > 0.99  # ties after rounding to whole numbers


def test_pairs():
    pairs = brief_pairs()
    assert pairs.shape == (256, 2, 2) and np.abs(pairs).max() <= 15
    assert (pairs[:, 0] != pairs[:, 1]).any(axis=1).all()
    np.testing.assert_array_equal(pairs, brief_pairs(0))
    assert (brief_pairs(1) != pairs).any()
    many = brief_pairs(3, 20_000)
    # A normal distribution cut off at 2.5 sigma keeps some nine tenths of its variance, (31 / 5)^2.
    assert many.mean(axis=(0, 1)) == pytest.approx([0, 0], abs=0.1)
    assert many.std(axis=(0, 1)) == pytest.approx([5.9, 5.9], abs=0.15)
    assert np.corrcoef(many[:, 0, 0], many[:, 1, 0])[0, 1] == pytest.approx(0, abs=0.03)


def test_a_shift_changes_nothing_but_the_place():
    picture = texture(2)
    xy = np.array([[40, 40], [70, 50], [90, 80]])
    a = describe_brief(picture, corners_at(xy))
    b = describe_brief(np.roll(picture, (3, -5), axis=(0, 1)), corners_at(xy + (-5, 3)))
    np.testing.assert_array_equal(a.descriptors, b.descriptors)
    # Half a pixel is rounded away; angle and scale are not used.
    c = describe_brief(picture, Corners(xy + 0.3, np.full(3, 9.0), np.array([1.0, 2, 3]), np.ones(3)))
    np.testing.assert_array_equal(a.descriptors, c.descriptors)


def test_offset_and_gain():
    picture = texture(3) // 2
    xy = corners_at([(x, y) for x in range(20, 120, 9) for y in range(20, 100, 9)])
    plain = np.unpackbits(describe_brief(picture, xy).descriptors, axis=1)
    brighter = np.unpackbits(describe_brief(picture + 100, xy).descriptors, axis=1)
    np.testing.assert_array_equal(plain, brighter)
    gained = np.unpackbits(describe_brief(picture * 2, xy).descriptors, axis=1)
    assert (plain == gained).mean() > 0.97


@pytest.mark.parametrize("degrees", [-10, 5, 10])
def test_small_turns_keep_correspondences(degrees):
    picture = texture(4, 200, 200)
    turned = ndimage.rotate(picture.astype(float), degrees, reshape=False, order=3, mode="reflect")
    xy = np.array([(x, y) for x in range(50, 150, 9) for y in range(50, 150, 9)], float)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    moved = (xy - 99.5) @ np.array([[c, -s], [s, c]]) + 99.5
    a = describe_brief(picture, corners_at(xy)).descriptors
    b = describe_brief(np.clip(turned, 0, 255).astype(np.uint8), corners_at(moved)).descriptors
    found = match(a, b, ratio=0.9)
    assert (found.index_src == found.index_dst).sum() > 0.8 * len(xy)


def test_descriptors_of_other_seeds_do_not_match():
    picture = texture(5)
    xy = corners_at([(x, y) for x in range(20, 120, 9) for y in range(20, 100, 9)])
    a, b = (np.unpackbits(describe_brief(picture, xy, seed).descriptors, axis=1) for seed in (0, 1))
    assert (a != b).mean() == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize(("seed", "count"), [(-1, 256), (0.5, 256), (None, 256), (0, 0), (0, 10**9), (0, "many")])
def test_bad_pairs_are_refused(seed, count):
    with pytest.raises(ShapeError, match="need"):
        brief_pairs(seed, count)
