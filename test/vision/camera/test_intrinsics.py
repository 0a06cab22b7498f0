# SPDX-License-Identifier: Apache-2.0
"""The camera model: against hand-computed values, OpenCV's projection (stable over versions), and its own inverse."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imgu_ros.errors import ShapeError
from imgu_ros.vision.camera.intrinsics import Camera, make_camera

K = np.array([[900.0, 0, 641.5], [0, 880.0, 350.25], [0, 0, 1]])
LENSES = {
    "plumb_bob": (-0.26, 0.09, 0.0008, -0.0005, -0.01),
    "rational_polynomial": (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01),
    "equidistant": (-0.03, 0.008, -0.004, 0.001),
}


def camera(model: str, scale: float = 1.0) -> Camera:
    return make_camera(K, np.array(LENSES[model]) * scale, model, 1280, 720)


def points(count: int = 200) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.column_stack((rng.uniform(-0.65, 0.65, count), rng.uniform(-0.35, 0.35, count), np.ones(count))) * (
        rng.uniform(0.3, 5, (count, 1))
    )


def test_pinhole_by_hand() -> None:
    pinhole = make_camera(K, (), "plumb_bob", 1280, 720)
    assert not pinhole.is_distorted
    assert_allclose(pinhole.project([[1.0, -0.5, 2.0]]), [[1091.5, 130.25]])


def test_plumb_bob_by_hand() -> None:
    # x = 0.5, y = 0: r2 = 0.25; radial 1 + 0.1 * 0.25 = 1.025; x' = 0.5125 + p2 (r2 + 2 x^2) = 0.5125 + 0.02 * 0.75
    lens = make_camera(K, (0.1, 0, 0.01, 0.02, 0), "plumb_bob", 1280, 720)
    assert_allclose(lens.project([[0.5, 0, 1]]), [[900 * 0.5275 + 641.5, 880 * (0.01 * 0.25) + 350.25]])


def test_rational_by_hand() -> None:
    # x = 0.5, y = 0: r2 = 1/4, r4 = 1/16, r6 = 1/64.
    lens = make_camera(K, (0.1, 0.2, 0, 0, 0.4, 0.3, 0.8, 1.6), "rational_polynomial", 1280, 720)
    radial = (1 + 0.025 + 0.0125 + 0.00625) / (1 + 0.075 + 0.05 + 0.025)
    assert_allclose(lens.project([[0.5, 0, 1]]), [[900 * 0.5 * radial + 641.5, 350.25]])


def test_equidistant_by_hand() -> None:
    lens = make_camera(K, (0, 0, 0, 0), "equidistant", 1280, 720)
    assert lens.is_distorted
    assert_allclose(lens.project([[1, 0, 1], [0, 0, 2]]), [[900 * np.pi / 4 + 641.5, 350.25], [641.5, 350.25]])


@pytest.mark.parametrize("model", LENSES)
def test_projection_agrees_with_opencv(model: str) -> None:
    P = points()
    zero = np.zeros(3)
    if model == "equidistant":
        expected = cv2.fisheye.projectPoints(P[:, None], zero, zero, K, np.array(LENSES[model]))[0]
    else:
        expected = cv2.projectPoints(P, zero, zero, K, np.array(LENSES[model]))[0]
    assert_allclose(camera(model).project(P), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("model", LENSES)
def test_jacobian_is_the_derivative(model: str) -> None:
    P = np.concatenate((points(50), [[0, 0, 1.5], [1e-8, 0, 1.0]]))
    pixels, jacobian = camera(model).project_with_jacobian(P)
    assert_allclose(pixels, camera(model).project(P), atol=1e-9)
    for axis in range(3):
        step = np.eye(3)[axis] * 1e-6
        numeric = (camera(model).project(P + step) - camera(model).project(P - step)) / 2e-6
        assert_allclose(jacobian[:, :, axis], numeric, rtol=1e-6, atol=2e-4)


@pytest.mark.parametrize("model", LENSES)
@given(scale=st.floats(0, 1.2), seed=st.integers(0, 1000))
def test_unprojection_inverts_projection(model: str, scale: float, seed: int) -> None:
    lens = camera(model, scale)
    normalized = np.random.default_rng(seed).uniform((-0.7, -0.4), (0.7, 0.4), (60, 2))
    back, valid = lens.undistort(lens.distort(normalized))
    assert valid.all()
    assert_allclose(back, normalized, atol=1e-10)
    pixels = lens.distort(normalized)
    ideal, _ = lens.ideal_pixels(pixels)
    assert_allclose(lens.raw_pixels(ideal), pixels, atol=1e-9)


def test_wide_equidistant_lens() -> None:
    lens = make_camera(np.diag([300.0, 300, 1]) + [[0, 0, 640], [0, 0, 480], [0, 0, 0]], (), "equidistant", 1280, 960)
    theta = np.radians([10, 45, 80, 85])
    normalized = np.column_stack((np.tan(theta), np.zeros(4)))
    back, valid = lens.undistort(lens.distort(normalized))
    assert valid.all()
    assert_allclose(back, normalized, rtol=1e-9)
    # More than 90 degrees off the axis there is no x / z.
    _, valid = lens.undistort([[640 + 300 * 1.7, 480]])
    assert not valid.any()


def test_a_lens_model_that_folds_has_no_inverse_beyond_the_fold() -> None:
    lens = make_camera(K, (-0.5, 0, 0, 0, 0), "plumb_bob", 1280, 720)
    # r (1 - 0.5 r^2) is largest, 0.5443, at r = 0.8165.
    outside, valid = lens.undistort([[641.5 + 900 * 0.6, 350.25], [641.5 + 900 * 0.5, 350.25]])
    assert valid.tolist() == [False, True]
    assert np.isfinite(outside).all()
    r = outside[1, 0]
    assert r * (1 - 0.5 * r * r) == pytest.approx(0.5, abs=1e-12)
    assert r < 0.8165


@pytest.mark.parametrize(
    ("matrix", "lens", "model", "size", "message"),
    [
        (np.zeros((3, 3)), (), "plumb_bob", (10, 10), "K"),
        (np.eye(2), (), "plumb_bob", (10, 10), "K: shape"),
        (K * np.nan, (), "plumb_bob", (10, 10), "finite"),
        (np.diag([-1.0, 1, 1]), (), "plumb_bob", (10, 10), "fx > 0"),
        (K, (0,) * 6, "plumb_bob", (10, 10), "at most 5"),
        (K, (np.nan,), "plumb_bob", (10, 10), "finite"),
        (K, (), "fisheye", (10, 10), "equidistant"),
        (K, (), "plumb_bob", (0, 10), "size"),
    ],
)
def test_bad_intrinsics(matrix: np.ndarray, lens: tuple, model: str, size: tuple, message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        make_camera(matrix, lens, model, *size)


def test_points_behind_the_camera_and_hostile_points() -> None:
    with pytest.raises(ShapeError, match="in front"):
        camera("plumb_bob").project([[0, 0, -1.0]])
    with pytest.raises(ShapeError, match="finite"):
        camera("plumb_bob").project([[0, 0, np.nan]])
    with pytest.raises(ShapeError, match="shape"):
        camera("plumb_bob").project([[0, 0]])
    assert camera("plumb_bob").project(np.zeros((0, 3))).shape == (0, 2)
    assert camera("equidistant").undistort(np.zeros((0, 2)))[0].shape == (0, 2)
