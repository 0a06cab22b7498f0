# SPDX-License-Identifier: Apache-2.0
"""Exposure, motion blur and rolling rows against their definitions."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.shutter import Exposure, motion_kernel, rolling_shutter_points, row_times


def test_exposure_values_of_the_tables():
    # EV 0: 1 s at f/1, ISO 100. "Sunny 16": 1/125 s at f/16 is nearly EV 15.
    assert Exposure(1.0, 1.0).value == 0
    assert Exposure(1 / 125, 16.0).value == pytest.approx(15, abs=0.04)
    assert Exposure(1 / 60, 2.8).value == pytest.approx(8.88, abs=0.01)
    assert Exposure(1.0, 1.0, 400).value == -2


@given(st.floats(1e-6, 10), st.floats(0.7, 64), st.floats(50, 1e5), st.floats(1e-6, 10), st.floats(0.7, 64))
def test_brightness_is_time_times_area_times_sensitivity(t1, n1, iso, t2, n2):
    # The aperture's area goes with 1 / N^2.
    expected = t1 * iso / n1**2 / (t2 * 100 / n2**2)
    assert Exposure(t1, n1, iso).brightness_over(Exposure(t2, n2)) == pytest.approx(expected)


speeds = st.just(0.0) | st.floats(1e-6, 900) | st.floats(-900, -1e-6)
velocities = st.tuples(speeds, speeds)


@given(velocities, st.just(0.0) | st.floats(1e-9, 0.02))
def test_motion_kernel_has_the_lines_moments(velocity, time):
    kernel = motion_kernel(velocity, time).astype(float)
    reach_y, reach_x = kernel.shape[0] // 2, kernel.shape[1] // 2
    y, x = np.mgrid[-reach_y : reach_y + 1, -reach_x : reach_x + 1]
    assert kernel.sum() == pytest.approx(1, abs=1e-5)
    assert (kernel >= 0).all()
    np.testing.assert_allclose(kernel, kernel[::-1, ::-1], atol=1e-7)
    dx, dy = 2 * (np.array(velocity) * (time / 2))
    assert (reach_x, reach_y) == (math.ceil(abs(dx / 2)), math.ceil(abs(dy / 2)))
    # Linear interpolation keeps products of x and y; to squares it adds the mean of f (1 - f), at most 1/4.
    assert (kernel * x * y).sum() == pytest.approx(dx * dy / 12, abs=1e-3)
    for axis, d in ((x, dx), (y, dy)):
        added = (kernel * axis**2).sum() - d**2 / 12
        s = np.linspace(-0.5, 0.5, 20_001)[1::2] * d
        fraction = s - np.floor(s)
        assert added == pytest.approx((fraction * (1 - fraction)).mean(), abs=1e-3)


def test_motion_kernel_is_the_mean_of_shifted_images():
    rng = np.random.default_rng(0)
    image = rng.random((40, 50))
    velocity, time = np.array([311.0, -173.0]), 0.02
    blurred = cv2.filter2D(image, -1, motion_kernel(velocity, time).astype(float), borderType=cv2.BORDER_REFLECT_101)
    padded = np.pad(image, 8, "reflect")
    total = np.zeros_like(image)
    steps = (np.arange(4000) + 0.5) / 4000 - 0.5
    for dx, dy in (steps[:, None] * velocity * time).tolist():
        ix, iy = math.floor(dx), math.floor(dy)
        fx, fy = dx - ix, dy - iy
        for oy, wy in ((iy, 1 - fy), (iy + 1, fy)):
            for ox, wx in ((ix, 1 - fx), (ix + 1, fx)):
                total += wy * wx * padded[8 + oy : 48 + oy, 8 + ox : 58 + ox]
    np.testing.assert_allclose(blurred, total / 4000, atol=1e-5)


@pytest.mark.parametrize(
    ("velocity", "time", "expected"),
    [
        ([0.0, 0.0], 0.01, [[1.0]]),
        ([500.0, 0.0], 0.0, [[1.0]]),
        ([0.0, 200.0], 0.01, [[0.25], [0.5], [0.25]]),  # from -1 to 1: a hat's own integral
        ([100.0, 0.0], 0.01, [[0.125, 0.75, 0.125]]),
    ],
)
def test_motion_kernels_by_hand(velocity, time, expected):
    np.testing.assert_allclose(motion_kernel(velocity, time), expected, atol=1e-6)


def test_row_times():
    times = row_times(480, 30e-6)
    assert len(times) == 480
    assert times.mean() == pytest.approx(0, abs=1e-18)
    np.testing.assert_allclose(np.diff(times), 30e-6)
    assert not row_times(480, 0.0).any()


@given(
    st.lists(st.tuples(st.floats(0, 640), st.floats(0, 480)), min_size=1, max_size=5),
    st.tuples(st.floats(-5000, 5000), st.floats(-5000, 5000)),
    st.floats(-1e-4, 1e-4),
)
def test_rolling_points_are_seen_when_their_row_is_read(points, velocity, row_time):
    points = np.array(points)
    seen = rolling_shutter_points(points, velocity, row_time, 480)
    # At the time of the row on which it is seen, the point is there.
    time = row_time * (seen[:, 1] - 479 / 2)
    np.testing.assert_allclose(points + time[:, None] * np.array(velocity), seen, atol=1e-9)
    np.testing.assert_allclose(
        rolling_shutter_points(points, np.tile(velocity, (len(points), 1)), row_time, 480), seen, atol=1e-12
    )


def test_vertical_line_leans_and_horizontal_motion_keeps_rows():
    line = np.column_stack((np.full(480, 100.0), np.arange(480)))
    seen = rolling_shutter_points(line, [3000.0, 0.0], 20e-6, 480)
    np.testing.assert_allclose(seen[:, 1], line[:, 1])
    np.testing.assert_allclose(np.diff(seen[:, 0]), 3000 * 20e-6)
    assert seen[:, 0].mean() == pytest.approx(100)
    np.testing.assert_array_equal(rolling_shutter_points(line, [3000.0, 50.0], 0.0, 480), line)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Exposure(0.0, 8.0), "time_s: 0"),
        (lambda: Exposure(0.01, math.nan), "f_number: nan"),
        (lambda: Exposure(0.01, 8.0, -100), "iso: -100"),
        (lambda: motion_kernel([1.0], 0.1), "velocity_px_s: shape (1,); need (2,)"),
        (lambda: motion_kernel([1.0, 2.0], -0.1), "time_s: -0.1; need 0 s or more"),
        (lambda: motion_kernel([1e6, 0.0], 0.1), "motion: [1000000.0, 0.0] px/s x 0.1 s; need at most 1000 px"),
        (lambda: row_times(0, 1e-5), "height, row_time_s: 0"),
        (lambda: row_times(10, math.inf), "height, row_time_s: 10, inf"),
        (lambda: rolling_shutter_points([[0.0, 0.0]], [0.0, 2e5], 1e-5, 480), "velocity_px_s: 2 px down"),
        (lambda: rolling_shutter_points([[0.0, 0.0]], np.zeros((2, 2)), 1e-5, 480), "velocity_px_s: shape (2, 2)"),
    ],
)
def test_impossible_values_are_refused(call, message):
    with pytest.raises(ShapeError) as caught:
        call()
    assert str(caught.value).startswith(message)
