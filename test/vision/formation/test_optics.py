# SPDX-License-Identifier: Apache-2.0
"""The thin lens against the Gaussian lens formula, ray by ray."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.optics import (
    ThinLens,
    circle_of_confusion,
    depth_of_field,
    disc_kernel,
    hyperfocal_distance,
)

focal_lengths = st.floats(1e-3, 0.5)
f_numbers = st.floats(0.7, 64)
ratios = st.floats(1.5, 1e4)  # of a distance over the focal length


def blur_by_rays(f: float, n: float, s: float, d: float) -> float:
    """Trace the two rays through the lens's rim from a point on the axis to the sensor, and return their distance."""
    rim = f / n / 2
    sensor = 1 / (1 / f - 1 / s)
    # A ray from height 0 at -d meets the rim with slope rim / d; a thin lens turns it by -rim / f.
    slope = rim / d - rim / f
    return 2 * abs(rim + slope * sensor)


@given(focal_lengths, f_numbers, ratios, ratios)
def test_circle_of_confusion_is_where_the_marginal_rays_land(f, n, s, d):
    got = float(circle_of_confusion(ThinLens(f, n, s * f), d * f))
    assert got == pytest.approx(blur_by_rays(f, n, s * f, d * f), rel=1e-6, abs=1e-9 * f / n)


@given(focal_lengths, f_numbers, ratios, st.floats(1e-7, 1e-3))
def test_depth_of_field_ends_where_the_circle_is_the_accepted_one(f, n, s, circle):
    lens = ThinLens(f, n, s * f)
    field = depth_of_field(lens, circle)
    assert 0 < field.near_m < lens.focus_m < field.far_m
    # Where rounding of 1/s would count beside the circle, this is no test.
    if circle > 1e-6 * lens.aperture_m * lens.image_distance_m / lens.focus_m:
        assert blur_by_rays(f, n, s * f, field.near_m) == pytest.approx(circle, rel=1e-5)
        if math.isfinite(field.far_m) and field.far_m < 1e6 * lens.focus_m:
            assert blur_by_rays(f, n, s * f, field.far_m) == pytest.approx(circle, rel=1e-5)


def test_depth_of_field_by_the_photographers_formulae():
    # H = f^2 / (N c) + f; near = s (H - f) / (H + s - 2 f); far = s (H - f) / (H - s)
    f, n, c, s = 0.05, 8.0, 30e-6, 5.0
    h = f**2 / (n * c) + f
    assert hyperfocal_distance(f, n, c) == pytest.approx(h)
    field = depth_of_field(ThinLens(f, n, s), c)
    assert field.near_m == pytest.approx(s * (h - f) / (h + s - 2 * f))
    assert field.far_m == pytest.approx(s * (h - f) / (h - s))


@given(focal_lengths, f_numbers, st.floats(1e-6, 1e-4))
def test_hyperfocal_focus_reaches_from_half_its_distance_to_infinity(f, n, c):
    h = hyperfocal_distance(f, n, c)
    field = depth_of_field(ThinLens(f, n, h), c)
    assert field.far_m > 1e6 * h
    # From the lens: h f / (...) = half the distance, to first order in f / h.
    assert field.near_m == pytest.approx(h / 2, rel=1.01 * f / h + 1e-9)
    assert math.isinf(depth_of_field(ThinLens(f, n, 2 * h), c).far_m)


def test_focus_at_infinity():
    lens = ThinLens(0.05, 2.0)
    assert lens.image_distance_m == 0.05
    assert lens.magnification == 0
    assert float(circle_of_confusion(lens, 10.0)) == pytest.approx(0.05 * 0.025 / 10)
    assert float(circle_of_confusion(lens, math.inf)) == 0
    assert math.isinf(depth_of_field(lens, 1e-5).far_m)


def test_image_distance_and_magnification():
    # At twice the focal length, life size: the image as far behind the lens as the object is before it.
    lens = ThinLens(0.05, 4.0, 0.1)
    assert lens.image_distance_m == pytest.approx(0.1)
    assert lens.magnification == pytest.approx(1)
    assert 1 / lens.image_distance_m + 1 / lens.focus_m == pytest.approx(1 / 0.05)


@given(st.floats(0, 40))
def test_disc_kernel(diameter):
    kernel = disc_kernel(diameter).astype(float)
    reach = len(kernel) // 2
    assert kernel.shape == (2 * reach + 1, 2 * reach + 1)
    assert reach == max(0, math.ceil(diameter / 2 - 0.5))
    assert kernel.sum() == pytest.approx(1, abs=1e-5)
    assert (kernel >= 0).all()
    np.testing.assert_allclose(kernel, kernel[::-1], atol=1e-7)
    np.testing.assert_allclose(kernel, kernel.T, atol=1e-7)
    if diameter > 1:
        # Variance of a uniform disc, D^2 / 16, and of the pixels in which it is counted.
        x = np.arange(-reach, reach + 1)
        boxes = (kernel.sum(axis=0) * x**2).sum()
        y, x = (np.mgrid[-64:64, -64:64] + 0.5) / 64 * (diameter / 2)
        inside = np.hypot(x, y) < diameter / 2
        assert boxes == pytest.approx((np.round(x[inside]) ** 2).mean(), rel=0.03, abs=0.01)


def test_disc_kernel_counts_area():
    diameter = 5.3
    fine = (np.arange(7 * 200) + 0.5) / 200 - 3.5
    inside = np.hypot(fine[:, None], fine) < diameter / 2
    area = inside.reshape(7, 200, 7, 200).mean(axis=(1, 3))
    np.testing.assert_allclose(disc_kernel(diameter), area / area.sum(), atol=2e-5)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ThinLens(0.0, 2.0, 1.0), "focal_length_m: 0; need more than 0 m"),
        (lambda: ThinLens(0.05, -1.0, 1.0), "f_number: -1; need more than 0"),
        (lambda: ThinLens(0.05, 2.0, 0.05), "focus_m: 0.05 m; need more than the focal length, 0.05 m"),
        (lambda: ThinLens(0.05, 2.0, math.nan), "focus_m: nan"),
        (lambda: circle_of_confusion(ThinLens(0.05, 2.0, 1.0), [1.0, 0.0]), "depth_m: a value is 0"),
        (lambda: depth_of_field(ThinLens(0.05, 2.0, 1.0), 0.0), "circle_m: 0"),
        (lambda: hyperfocal_distance(0.05, 2.0, math.inf), "circle_m: inf"),
        (lambda: disc_kernel(-1.0), "diameter_px: -1; need 0 to 1000 px"),
        (lambda: disc_kernel(math.nan), "diameter_px: nan"),
    ],
)
def test_impossible_lenses_are_refused(call, message):
    with pytest.raises(ShapeError) as caught:
        call()
    assert str(caught.value).startswith(message)
