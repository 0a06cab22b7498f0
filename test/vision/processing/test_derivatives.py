# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.processing.derivatives import Derivative, gradient
from imgu_ros.vision.processing.edges import canny, edge_map, edge_strength

coefficient = st.floats(-2, 2)


@given(st.sampled_from(list(Derivative)), st.lists(coefficient, min_size=6, max_size=6), st.floats(0.5, 2.0))
def test_exact_on_polynomials_of_degree_2(operator, c, sigma):
    y, x = np.mgrid[-20:21, -20:21] / 10.0
    image = (c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y).astype(np.float32)
    slope = gradient(image, operator, sigma)
    inside = np.s_[9:-9, 9:-9]
    # A pixel is a tenth of a unit.
    np.testing.assert_allclose(10 * slope.dx[inside], (c[1] + 2 * c[3] * x + c[4] * y)[inside], atol=1e-4)
    np.testing.assert_allclose(10 * slope.dy[inside], (c[2] + c[4] * x + 2 * c[5] * y)[inside], atol=1e-4)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("operator", Derivative)
def test_integer_ramps_have_exact_slopes_of_either_sign(dtype, operator):
    ramp = np.tile(np.arange(200, 0, -5), (20, 1)).astype(dtype)
    for image, negative, zero in ((ramp, "dx", "dy"), (ramp.T, "dy", "dx")):
        slope = gradient(image, operator)
        np.testing.assert_allclose(getattr(slope, negative)[6:-6, 6:-6], -5, rtol=1e-5)
        np.testing.assert_allclose(getattr(slope, zero)[6:-6, 6:-6], 0, atol=1e-5)


@pytest.mark.parametrize(("operator", "scale"), [("sobel", 8), ("scharr", 32)])
def test_agrees_with_opencv_but_for_the_scale(operator, scale):
    image = np.random.default_rng(0).integers(0, 256, (20, 30)).astype(np.uint8)
    function = {"sobel": cv2.Sobel, "scharr": cv2.Scharr}[operator]
    slope = gradient(image, operator)
    np.testing.assert_allclose(scale * slope.dx, function(image, cv2.CV_32F, 1, 0), atol=1e-3)
    np.testing.assert_allclose(scale * slope.dy, function(image, cv2.CV_32F, 0, 1), atol=1e-3)


def test_direction_and_magnitude_of_a_plane_wave():
    y, x = np.mgrid[:64, :64]
    for degrees in range(0, 360, 15):
        a = math.radians(degrees)
        image = (0.5 + 0.01 * ((x - 32) * math.cos(a) + (y - 32) * math.sin(a))).astype(np.float32)
        slope = gradient(image, "scharr")
        assert slope.magnitude[32, 32] == pytest.approx(0.01, rel=1e-4)
        difference = (float(slope.direction[32, 32]) - a + math.pi) % (2 * math.pi) - math.pi
        assert abs(difference) < 1e-3


def test_scharr_keeps_directions_better_than_sobel():
    y, x = np.mgrid[:64, :64]
    worst = {}
    for operator in ("sobel", "scharr"):
        errors = []
        for degrees in range(0, 90, 5):
            a = math.radians(degrees)
            image = np.sin(0.9 * (x * math.cos(a) + y * math.sin(a))).astype(np.float32)
            slope = gradient(image, operator)
            strong = slope.magnitude[5:-5, 5:-5] > 0.3
            got = np.arctan2(slope.dy, slope.dx)[5:-5, 5:-5][strong] % math.pi
            errors.append(np.abs((got - a + math.pi / 2) % math.pi - math.pi / 2).max())
        worst[operator] = math.degrees(max(errors))
    assert worst["scharr"] < 0.3 and worst["sobel"] > 0.8


def test_gaussian_derivative_of_a_blurred_step():
    """The derivative of an edge of blur b by sigma s is a Gaussian of variance b^2 + s^2."""
    x = np.arange(-40, 41)
    image = np.tile([0.5 * (1 + math.erf(v / (2.0 * math.sqrt(2)))) for v in x], (31, 1)).astype(np.float32)
    got = gradient(image, "gaussian", 1.5).dx[15]
    np.testing.assert_allclose(got, np.exp(-(x**2) / (2 * 6.25)) / math.sqrt(2 * math.pi * 6.25), atol=2e-4)


# ---------------------------------------------------------------------------------------------------------------------
# Edges


def test_edge_strength_is_the_squared_magnitude():
    image = np.random.default_rng(1).integers(0, 256, (20, 30)).astype(np.uint8)
    slope = gradient(image)
    np.testing.assert_allclose(edge_strength(image), slope.dx**2 + slope.dy**2)
    np.testing.assert_array_equal(edge_map(image, 20), np.hypot(slope.dx, slope.dy) >= 20)
    assert edge_map(image, 0).all() and not edge_map(image, 1e300).any()


def disc(radius, low, high, dtype):
    y, x = np.mgrid[:120, :120]
    covered = np.clip(radius + 0.5 - np.hypot(x - 60.3, y - 58.9), 0, 1)
    return (low + (high - low) * covered).astype(dtype)


@pytest.mark.parametrize(("dtype", "full"), [(np.uint8, 255), (np.uint16, 65535), (np.float32, 1)])
def test_canny_finds_the_outline_of_a_disc_one_pixel_wide(dtype, full):
    edges = canny(disc(35, 0.2 * full, 0.8 * full, dtype), 0.05 * full, 0.1 * full)
    y, x = np.nonzero(edges)
    assert np.abs(np.hypot(x - 60.3, y - 58.9) - 35).max() < 1.2
    # Every direction is there, and nothing is thick: a closed curve of 8-connected pixels.
    angles = np.sort(np.arctan2(y - 58.9, x - 60.3))
    assert np.diff(angles).max() < 0.08
    assert 0.85 * 2 * math.pi * 35 < len(x) < 1.25 * 2 * math.pi * 35
    count, _ = cv2.connectedComponents(edges.astype(np.uint8), connectivity=8)
    assert count == 2


def test_canny_links_weak_edges_to_strong_ones_and_drops_the_others():
    image = np.zeros((80, 100), np.float32)
    image[:, 30:60] = np.linspace(0.8, 0.15, 80)[:, None]
    image[10:70, 85:] = 0.15
    edges = canny(image, 0.03, 0.15)
    assert edges[:, 28:32].any(axis=1).all()  # the weak end hangs on the strong one
    assert not edges[:, 80:90].any()  # as weak, but alone
    assert canny(image, 0.03, 0.03)[20:60, 80:90].any(axis=1).all()
    assert not canny(image, 2.0, 3.0).any()


def test_canny_is_blind_to_brightness_and_polarity():
    image = disc(30, 60, 160, np.uint8)
    expected = canny(image, 5, 12)
    np.testing.assert_array_equal(canny(image + np.uint8(40), 5, 12), expected)
    assert np.count_nonzero(canny(255 - image, 5, 12) != expected) <= 0.05 * np.count_nonzero(expected)


@pytest.mark.parametrize(
    "call",
    [
        lambda: gradient(np.zeros((4, 4, 3), np.uint8)),
        lambda: gradient(np.zeros((4, 4), np.uint8), "prewitt"),
        lambda: gradient(np.zeros((4, 4), np.uint8), "gaussian", 0.1),
        lambda: edge_strength(np.full((4, 4), 1e30, np.float32)),
        lambda: edge_map(np.zeros((4, 4), np.uint8), -1),
        lambda: canny(np.zeros((4, 4), np.uint8), 5, 4),
        lambda: canny(np.zeros((4, 4), np.uint8), np.nan, 4),
        lambda: canny(np.zeros((4, 4), np.uint8), 1, 4, -1),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        call()
