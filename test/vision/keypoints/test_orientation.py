# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.keypoints.orientation import centroid_orientation, scaled_orientation


def by_definition(image, x, y, radius):
    m10 = m01 = 0.0
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            if dx * dx + dy * dy <= radius * radius:
                m10 += dx * float(image[y + dy, x + dx])
                m01 += dy * float(image[y + dy, x + dx])
    return math.atan2(m01, m10)


def test_moments_by_definition():
    rng = np.random.default_rng(0)
    for dtype in (np.uint8, np.uint16, np.float32):
        image = (rng.random((40, 50)) * 250).astype(dtype)
        xy = np.array([[20.0, 18.0], [15.4, 24.4], [30.6, 15.0]])
        expected = [by_definition(image, round(x), round(y), 15) for x, y in xy]
        np.testing.assert_allclose(centroid_orientation(image, xy), expected, atol=1e-6)
        np.testing.assert_allclose(
            centroid_orientation(image, xy, 4), [by_definition(image, round(x), round(y), 4) for x, y in xy], atol=1e-6
        )


@pytest.mark.parametrize("degrees", range(-180, 180, 30))
def test_ramps_point_upwards(degrees):
    y, x = np.mgrid[:41, :41]
    direction = math.radians(degrees)
    ramp = 1000 + 10 * (math.cos(direction) * x + math.sin(direction) * y)
    (got,) = centroid_orientation(ramp.astype(np.float32), np.array([[20.0, 20.0]]))
    assert abs((got - direction + math.pi) % (2 * math.pi) - math.pi) < 1e-4
    assert -math.pi <= got < math.pi


@given(st.integers(0, 2**32))
def test_right_angles_are_exact(seed):
    image = np.random.default_rng(seed).integers(0, 256, (41, 41), np.uint8)
    middle = np.array([[20.0, 20.0]])
    plain = centroid_orientation(image, middle)[0]
    turned = centroid_orientation(np.rot90(image), middle)[0]
    assert abs((turned - plain + math.pi / 2 + math.pi) % (2 * math.pi) - math.pi) < 1e-9


def test_towards_minus_x_is_minus_pi():
    ramp = np.tile(np.arange(40, 0, -1, dtype=np.uint8), (40, 1))
    assert centroid_orientation(ramp, np.array([[20.0, 20.0]])).tolist() == [-math.pi]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_no_contrast_is_zero(dtype):
    flat = np.full((60, 70), 0.1 if dtype == np.float32 else 201, dtype)
    xy = np.array([[0.0, 0.0], [30.2, 20.9], [69.0, 59.0]])
    assert centroid_orientation(flat, xy).tolist() == [0.0, 0.0, 0.0]


def test_many_points_and_tiny_pictures():
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (50, 60), np.uint8)
    xy = np.column_stack((rng.uniform(0, 59, 9000), rng.uniform(0, 49, 9000)))
    got = centroid_orientation(image, xy)
    np.testing.assert_array_equal(got[[0, 4095, 4096, 8999]], centroid_orientation(image, xy[[0, 4095, 4096, 8999]]))
    assert centroid_orientation(image, np.zeros((0, 2))).shape == (0,)
    assert centroid_orientation(np.full((1, 1), 9, np.uint8), np.array([[0.0, 0.0]])).tolist() == [0.0]
    assert np.isfinite(centroid_orientation(image[:3, :2], np.array([[1e300, -1e300]]))).all()


def test_bad_input_is_refused():
    image = np.zeros((9, 9), np.uint8)
    for picture, xy in (
        (image, [[np.nan, 1]]),
        (image, [[1, 2, 3]]),
        (image[:0], [[1, 2]]),
        (image.astype(complex), [[1, 2]]),
        (np.full((9, 9), np.nan, np.float32), [[1, 2]]),
    ):
        with pytest.raises(ShapeError):
            centroid_orientation(picture, np.array(xy))


@pytest.mark.parametrize("scale", [1.0, 2.5, 4.0, 9.0, 23.0])
def test_scaled_discs_follow_the_structure(scale):
    """A half-plane of light through each point: its direction is the normal, at every size."""
    y, x = np.mgrid[:400, :440]
    for degrees in (-160, -75, 0, 20, 110):
        direction = math.radians(degrees)
        step = np.where(math.cos(direction) * (x - 220.3) + math.sin(direction) * (y - 200.4) > 0, 200, 40)
        (got,) = scaled_orientation(step.astype(np.uint8), np.array([[220.3, 200.4]]), np.array([scale]))
        assert abs((got - direction + math.pi) % (2 * math.pi) - math.pi) < math.radians(4)


def test_scaled_orientation_of_an_enlarged_picture():
    picture = np.random.default_rng(2).integers(0, 256, (60, 70), np.uint8)
    xy = np.array([[20.0, 20.0], [40.2, 30.1], [33.0, 45.0]])
    enlarged = np.kron(picture, np.ones((4, 4), np.uint8))
    plain = scaled_orientation(picture, xy, np.full(3, 2.5))
    larger = scaled_orientation(enlarged, (xy + 0.5) * 4 - 0.5, np.full(3, 10.0))
    np.testing.assert_allclose(larger, plain, atol=1e-9)


def test_scaled_orientation_checks_its_input():
    image = np.zeros((40, 40), np.uint8)
    for scale in ([0.0], [-1.0], [math.nan], [1.0, 2.0]):
        with pytest.raises(ShapeError, match=r"^scale: [^\n]+need[^\n]+$"):
            scaled_orientation(image, np.array([[3.0, 4.0]]), np.array(scale))
    assert np.isfinite(scaled_orientation(image, np.array([[3.0, 4.0]]), np.array([1e300]))).all()
