# SPDX-License-Identifier: Apache-2.0
"""Lens distortion: the derivative by the coefficients, the fold, and the inverse up to it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imgu_ros.errors import ShapeError
from imgu_ros.vision.camera.distortion import distort, distort_with_derivatives, fold_radius, undistort
from imgu_ros.vision.camera.distortion_model import COEFFICIENT_NAMES, COEFFICIENTS, DistortionModel
from imgu_ros.vision.camera.intrinsics import make_camera

LENSES = {
    "plumb_bob": (-0.26, 0.09, 0.0008, -0.0005, -0.01),
    "rational_polynomial": (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01),
    "thin_prism": (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01, 0.004, -0.002, 0.003, 0.001),
    "tilted": (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01, 0.004, -0.002, 0.003, 0.001, 0.06, -0.04),
    "equidistant": (-0.03, 0.008, -0.004, 0.001),
}
#: Focal length and lens: strong ones, of 70 to 120 degrees, barrel, pincushion and tangential.
STRONG = [
    (900, "plumb_bob", (-0.35, 0.14, 0.004, -0.003, -0.025)),
    (620, "plumb_bob", (0.5, 0.2, -0.003, 0.004, 0.1)),
    (750, "plumb_bob", (-0.28, 0.07, 0.01, 0.01, 0.0)),
    (620, "rational_polynomial", (5.2, 2.6, 0.0003, 0.0002, 0.11, 5.5, 4.4, 0.7)),
    (620, "thin_prism", (*LENSES["rational_polynomial"], 0.03, -0.01, -0.02, 0.01)),
    (700, "tilted", (*LENSES["thin_prism"], 0.2, -0.15)),
    (700, "tilted", (-0.28, 0.07, 0.01, 0.01, *[0.0] * 8, -0.1, 0.25)),
    (620, "equidistant", (0.05, -0.02, 0.01, -0.003)),
    (900, "equidistant", (-0.2, 0.02, 0.0, 0.0)),
]


@pytest.mark.parametrize("model", LENSES)
def test_derivatives_by_finite_differences(model: str) -> None:
    xy = np.concatenate((np.random.default_rng(0).uniform(-0.7, 0.7, (40, 2)), [[0, 0], [1e-9, 0]]))
    k = np.array(LENSES[model])
    distorted = distort_with_derivatives(model, k, xy)
    assert_allclose(distorted.xy, distort(model, k, xy)[0])
    for index in range(len(k)):
        step = np.eye(len(k))[index] * 1e-6
        numeric = (distort(model, k + step, xy)[0] - distort(model, k - step, xy)[0]) / 2e-6
        assert_allclose(distorted.by_coefficients[:, :, index], numeric, atol=1e-9)
    for axis in range(2):
        step = np.eye(2)[axis] * 1e-6
        numeric = (distort(model, k, xy + step)[0] - distort(model, k, xy - step)[0]) / 2e-6
        assert_allclose(distorted.by_xy[:, :, axis], numeric, atol=1e-8)


@pytest.mark.parametrize(("focal", "model", "k"), STRONG)
def test_strong_lenses_are_inverted_to_a_billionth_of_a_pixel_up_to_the_corners(
    focal: float, model: str, k: tuple[float, ...]
) -> None:
    camera = make_camera([[focal, 0, 639.5], [0, focal, 359.5], [0, 0, 1]], k, model, 1280, 720)
    x, y = np.meshgrid(np.linspace(0, 1279, 33), np.linspace(0, 719, 19))
    pixels = np.column_stack((x.ravel(), y.ravel()))
    normalized, valid = camera.undistort(pixels)
    assert valid.all()
    assert_allclose(camera.distort(normalized), pixels, atol=1e-9, rtol=0)
    assert np.hypot(*normalized.T).max() < fold_radius(model, k)


@pytest.mark.parametrize("model", LENSES)
@given(seed=st.integers(0, 10_000))
def test_every_ray_within_the_fold_comes_back(model: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = np.array(LENSES[model]) * rng.uniform(-1.5, 1.5, COEFFICIENTS[DistortionModel(model)])
    if model != "equidistant":
        k[2:4] = k[8:] = 0  # the fold is a circle
    fold = min(fold_radius(model, k), 3.0)
    angle, r = rng.uniform(-np.pi, np.pi, 50), rng.uniform(0, 0.97 * fold, 50)
    xy = np.column_stack((r * np.cos(angle), r * np.sin(angle)))
    back, valid = undistort(model, k, distort(model, k, xy)[0])
    assert valid.all()
    assert_allclose(back, xy, atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_fold_is_where_the_radius_stops_growing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for model, size in (("plumb_bob", 5), ("rational_polynomial", 8), ("equidistant", 4)):
        k = rng.uniform(-0.4, 0.4, size)
        if model != "equidistant":
            k[2:4] = 0
        fold = fold_radius(model, k)
        theta = np.linspace(1e-4, np.pi / 2 - 1e-3, 40_000)
        distorted = distort(model, k, np.column_stack((np.tan(theta), np.zeros_like(theta))))[0][:, 0]
        falling = np.flatnonzero(np.diff(distorted) <= 0)
        if falling.size:
            assert np.arctan(fold) == pytest.approx(theta[falling[0]], abs=1e-4)
        else:
            assert fold > np.tan(theta[-1])


def test_a_root_beyond_the_fold_is_no_inverse() -> None:
    # r (1 - 0.6 r^2 + 0.15 r^4) grows, falls, and grows again; what lies above its first top is reached far out only.
    k = (-0.6, 0.15, 0, 0, 0)
    fold = fold_radius("plumb_bob", k)
    top = distort("plumb_bob", k, [[fold, 0.0]])[0][0, 0]
    _, valid = undistort("plumb_bob", k, [[top * 0.99, 0], [top * 1.01, 0], [0, -top * 1.2], [3.0, 0]])
    assert valid.tolist() == [True, False, False, False]


def test_newton_that_leaves_the_range_is_helped() -> None:
    # From the distorted point itself Newton would start beyond the fold.
    k = (-0.9, 0.0, 0.0, 0.0, 0.0)
    r = np.linspace(0.01, 0.99, 60) * fold_radius("plumb_bob", k)
    distorted = distort("plumb_bob", k, np.column_stack((r, np.zeros_like(r))))[0]
    back, valid = undistort("plumb_bob", k, distorted)
    assert valid.all()
    assert_allclose(back[:, 0], r, atol=1e-9)
    # A pincushion so strong that the point lies far outside.
    k = (8.0, 4.0, 0.0, 0.0, 0.0)
    xy = np.array([[0.9, 0.3], [-1.2, 0.1]])
    back, valid = undistort("plumb_bob", k, distort("plumb_bob", k, xy)[0])
    assert valid.all()
    assert_allclose(back, xy, atol=1e-9)


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_long_models_are_those_of_opencv(count: int) -> None:
    """Points and their derivatives by cv2.projectPoints, the way back by cv2.undistortPoints."""
    names = {4: "plumb_bob", 5: "plumb_bob", 8: "rational_polynomial", 12: "thin_prism", 14: "tilted"}
    model = names[count]
    rng = np.random.default_rng(count)
    for strength in (0.2, 1.0, -0.5):
        k = np.array(LENSES["tilted"][:count]) * strength
        xy = rng.uniform(-0.7, 0.7, (100, 2))
        rays = np.column_stack((xy, np.ones(100)))
        expected, jacobian = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), k)
        distorted = distort_with_derivatives(model, k, xy)
        assert_allclose(distorted.xy, expected[:, 0], atol=1e-14)
        # OpenCV's columns: rvec, tvec, f, c, then the coefficients.
        by_k = distorted.by_coefficients[:, :, :count].reshape(200, -1)
        assert_allclose(by_k, jacobian[:, 10 : 10 + count], atol=1e-12)
        back = _undistorted(expected, k)
        ours, valid = undistort(model, k, expected[:, 0])
        assert valid.all()
        assert_allclose(ours, xy, atol=1e-10)
        assert_allclose(ours, back, atol=1e-6)


def _undistorted(distorted: np.ndarray, k: np.ndarray) -> np.ndarray:
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    if hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
        return cv2.undistortPointsIter(distorted, np.eye(3), k, np.eye(3), np.eye(3), criteria)[:, 0]
    return cv2.undistortPoints(distorted, np.eye(3), k, R=np.eye(3), P=np.eye(3), criteria=criteria)[:, 0]


def test_a_tilted_sensor_sees_no_light_from_behind() -> None:
    k = np.zeros(14)
    k[12] = 1.2
    xy, valid = undistort("tilted", k, [[0.1, 0.1], [0.0, 5.0], [0.0, -5.0]])
    assert valid.tolist() in ([True, True, False], [True, False, True])
    assert np.isfinite(xy).all()
    with pytest.raises(ShapeError, match="faces the lens"):
        distort("tilted", [*[0.0] * 12, 2.0, 0.0], [[0.0, 0.0]])


def test_names_and_bad_input() -> None:
    assert {model: len(names) for model, names in COEFFICIENT_NAMES.items()} == COEFFICIENTS
    with pytest.raises(ShapeError, match="at most 4"):
        distort("equidistant", np.zeros(5), [[0, 0]])
    with pytest.raises(ShapeError, match="plumb_bob, rational"):
        distort("fisheye", np.zeros(5), [[0, 0]])
    with pytest.raises(ShapeError, match="nearer the axis"):
        distort("plumb_bob", (1, 1, 0, 0, 1), [[1e60, 0]])
    assert undistort("plumb_bob", (0.1,), np.zeros((0, 2)))[0].shape == (0, 2)
