# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from imgu_ros.errors import ShapeError
from imgu_ros.vision.descriptors.patch import SIDE, STEP_PER_SIGMA, describe_patch, sample_patches
from imgu_ros.vision.keypoints.keypoints import Corners
from imgu_ros.vision.matching.patches import ncc

seeds = st.integers(0, 2**32).map(np.random.default_rng)


def texture(seed, height=140, width=150):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(height, width)), 2.5)
    return np.clip(128 + 300 * noise, 0, 255).astype(np.uint8)


@given(seeds, st.integers(1, 9))
def test_samples_of_a_plane_are_exact(rng, side):
    # Bilinear interpolation reproduces a plane; where a sample lies follows from the definition alone.
    y, x = np.mgrid[:80, :90]
    gx, gy = rng.uniform(-3, 3, 2)
    picture = (gx * x + gy * y).astype(np.float32)
    xy, step, angle = rng.uniform(30, 50, (4, 2)), rng.uniform(0.2, 4, 4), rng.uniform(-7, 7, 4)
    got = sample_patches(picture, xy, step, angle, side)
    for k in range(4):
        for row in range(side):
            for column in range(side):
                u, v = (column - (side - 1) / 2) * step[k], (row - (side - 1) / 2) * step[k]
                c, s = np.cos(angle[k]), np.sin(angle[k])
                expected = gx * (xy[k, 0] + c * u - s * v) + gy * (xy[k, 1] + s * u + c * v)
                assert got[k, row, column] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_whole_pixels_are_themselves_and_borders_go_on(dtype):
    picture = np.random.default_rng(1).integers(0, 200, (20, 30)).astype(dtype)
    centre, one, zero = np.array([[10.0, 7.0]]), np.ones(1), np.zeros(1)
    np.testing.assert_array_equal(sample_patches(picture, centre, one, zero, 5)[0], picture[5:10, 8:13])
    quarter = sample_patches(picture, centre, one, np.full(1, np.pi / 2), 5)[0]
    np.testing.assert_allclose(quarter, np.rot90(picture[5:10, 8:13].astype(float)), atol=1e-3)
    padded = np.pad(picture, 2, mode="edge")
    np.testing.assert_array_equal(sample_patches(picture, np.zeros((1, 2)), one, zero, 5)[0], padded[:5, :5])
    far = sample_patches(picture, np.array([[900.0, -900.0]]), one, zero, 2)
    assert (far == picture[0, -1]).all()


def test_half_way_between_pixels():
    got = sample_patches(np.array([[0, 10], [20, 50]], np.uint8), np.array([[0.5, 0.5]]), np.ones(1), np.zeros(1), 1)
    assert got.tolist() == [[[20.0]]]


def test_smoothing_of_the_descriptor():
    # A smoothed plane is the same plane; a single bright pixel is spread out before it is sampled so sparsely.
    picture = np.zeros((81, 81), np.uint8)
    picture[40, 41] = 255
    corner = Corners(np.array([[40.0, 40.0]]), np.array([2.0]), np.zeros(1), np.ones(1))
    patch = describe_patch(picture, corner).descriptors.reshape(SIDE, SIDE)
    assert 2 < patch.max() == patch[SIDE // 2, SIDE // 2] < 60


@pytest.mark.parametrize("degrees", range(15, 360, 30))
@pytest.mark.parametrize("scale", [0.7, 1.0, 1.5])
def test_turned_and_scaled_patches_correlate(degrees, scale):
    size = 201
    picture = texture(2, size, size)
    c, s = np.cos(np.radians(degrees)) * scale, np.sin(np.radians(degrees)) * scale
    A = np.array([[c, -s], [s, c]])
    centre = np.full(2, (size - 1) / 2)
    xy = centre + np.array([[x, y] for x in (-20, 0, 15) for y in (-15, 0, 20)], float)
    inverse = np.linalg.inv(A)[::-1, ::-1]  # rows first
    other = ndimage.affine_transform(picture.astype(float), inverse, centre - inverse @ centre, order=3, mode="reflect")
    n = len(xy)
    sigma = np.full(n, 2.0)
    a = describe_patch(picture, Corners(xy, sigma, np.full(n, 0.3), np.ones(n)))
    moved = Corners((xy - centre) @ A.T + centre, scale * sigma, np.full(n, 0.3 + np.radians(degrees)), np.ones(n))
    b = describe_patch(np.clip(np.rint(other), 0, 255).astype(np.uint8), moved)
    assert len(a.index) == len(b.index) == n
    for p, q in zip(a.descriptors, b.descriptors, strict=True):
        assert ncc(p, q) > 0.97


def test_offset_and_gain_are_kept():
    # The picture's arithmetic is the samples': no rounding beyond float32's.
    picture = texture(3) // 3
    corner = Corners(np.array([[70.3, 71.8]]), np.array([2.1]), np.array([0.4]), np.ones(1))
    plain, other = (describe_patch(p, corner).descriptors for p in (picture, 2 * picture + 40))
    np.testing.assert_allclose(other, 2 * plain + 40, atol=1e-3)


def test_which_corners_are_described():
    picture = texture(4, 100, 100)
    reach = (SIDE - 1) / 2 * STEP_PER_SIGMA * 2.0
    xy = np.array([[reach, 50], [reach - 0.01, 50], [50, 99 - reach], [50, 99.01 - reach], [reach, reach]])
    n = len(xy)
    upright = describe_patch(picture, Corners(xy, np.full(n, 2.0), np.zeros(n), np.ones(n)))
    assert upright.index.tolist() == [0, 2, 4]
    assert upright.descriptors.dtype == np.float32 and upright.descriptors.shape == (3, 169)
    turned = describe_patch(picture, Corners(xy, np.full(n, 2.0), np.full(n, np.pi / 4), np.ones(n)))
    assert turned.index.tolist() == []
    huge = describe_patch(picture, Corners(xy, np.full(n, 9e5), np.zeros(n), np.ones(n)))
    assert huge.descriptors.shape == (0, 169)


def test_the_order_of_corners_is_kept():
    picture, rng = texture(5), np.random.default_rng(5)
    xy, scale, angle = rng.uniform(50, 90, (9, 2)), rng.uniform(0.6, 3, 9), rng.uniform(-3, 3, 9)
    together = describe_patch(picture, Corners(xy, scale, angle, np.ones(9)))
    assert together.index.tolist() == list(range(9))
    for k in range(9):
        one = slice(k, k + 1)
        alone = describe_patch(picture, Corners(xy[one], scale[one], angle[one], np.ones(1)))
        np.testing.assert_array_equal(together.descriptors[k], alone.descriptors[0])


@pytest.mark.parametrize(
    "change",
    [
        {"side": 0},
        {"side": 2.5},
        {"side": True},
        {"side": 10_000},
        {"step_px": np.zeros(1)},
        {"step_px": np.full(1, 1e9)},
        {"step_px": np.ones(2)},
        {"angle": np.full(1, np.nan)},
        {"xy": np.full((1, 2), 1e300)},
        {"image": np.zeros((4, 4, 3), np.uint8)},
    ],
)
def test_bad_arguments_are_refused(change):
    good = {"image": np.zeros((9, 9)).astype(np.uint8), "xy": np.ones((1, 2)), "step_px": np.ones(1)}
    with pytest.raises(ShapeError, match="need"):
        sample_patches(**(good | {"angle": np.zeros(1), "side": 3} | change))
