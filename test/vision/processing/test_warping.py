# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.processing.interpolation import resized, sampled
from imgu_ros.vision.processing.remapping import remapped
from imgu_ros.vision.processing.warping import rotated, rotation_about, warped, whole_picture

#: OpenCV before version 5 rounds places to 1/32 px.
STEP_PX = 1 / 64


def smooth_picture(height=90, width=110):
    """Slopes up to 0.05 a px."""
    y, x = np.mgrid[:height, :width]
    return (0.5 + 0.2 * np.sin(x / 8 + 0.3) * np.cos(y / 10) + 0.2 * np.sin((x + y) / 14)).astype(np.float32)


def mapped(H, xy):
    xyw = np.column_stack([xy, np.ones(len(xy))]) @ np.asarray(H).T
    return xyw[:, :2] / xyw[:, 2:]


# ---------------------------------------------------------------------------------------------------------------------
# Interpolation


def test_nearest_enlarges_as_in_the_notes():
    image = np.array([[10, 4], [2, 8]], np.uint8)
    assert resized(image, (4, 4), "nearest").tolist() == [[10, 10, 4, 4]] * 2 + [[2, 2, 8, 8]] * 2
    # Reduced by 3: the middle pixel of each three holds the new centre.
    assert resized(np.arange(9, dtype=np.uint8)[None], (3, 1), "nearest").tolist() == [[1, 4, 7]]


def test_linear_and_area_by_hand():
    row = np.array([[0, 100]], np.float32)
    np.testing.assert_allclose(resized(row, (4, 1))[0], [0, 25, 75, 100], atol=1e-4)
    image = np.arange(24, dtype=np.float32).reshape(4, 6)
    expected = image.reshape(2, 2, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(resized(image, (2, 2), "area"), expected, rtol=1e-6)
    # 5 -> 2 pixels: each covers 2.5
    got = resized(np.array([[0, 10, 20, 30, 40]], np.float32), (2, 1), "area")
    np.testing.assert_allclose(got, [[(0 + 10 + 0.5 * 20) / 2.5, (0.5 * 20 + 30 + 40) / 2.5]], rtol=1e-5)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_ramps_are_kept(interpolation, dtype):
    scale = 1 if dtype != np.float32 else 1 / 255
    ramp = (np.tile(np.arange(20, 60, 2), (6, 1)) * scale).astype(dtype)
    got = resized(ramp, (50, 6), interpolation)
    x = (np.arange(50) + 0.5) * 20 / 50 - 0.5
    inside = (x > 2) & (x < 17)
    np.testing.assert_allclose(got[3, inside], (20 + 2 * x[inside]) * scale, atol=0.51 * scale)


@given(st.floats(1, 7), st.floats(1, 5), st.sampled_from(["linear", "cubic"]))
def test_samples_of_planes_are_exact(x, y, interpolation):
    v, u = np.mgrid[:8, :10]
    image = (3 * u + 5 * v + 7).astype(np.uint8)
    assert sampled(image, [[x, y]], interpolation)[0] == pytest.approx(3 * x + 5 * y + 7, abs=1e-9)


def test_bilinear_by_the_formula():
    image = np.array([[10, 20], [40, 80]], np.uint8)
    a, b = 0.3, 0.6
    expected = (1 - a) * (1 - b) * 10 + a * (1 - b) * 20 + (1 - a) * b * 40 + a * b * 80
    assert sampled(image, [[a, b]])[0] == pytest.approx(expected)
    assert sampled(image, [[0.49, 0.51], [0.5, 0]], "nearest").tolist() == [40, 20]


def test_cubic_by_keys_kernel():
    row = np.zeros((1, 9), np.float32)
    row[0, 4] = 1

    def keys(d, a=-0.5):
        d = abs(d)
        return (a + 2) * d**3 - (a + 3) * d**2 + 1 if d <= 1 else a * (d**3 - 5 * d**2 + 8 * d - 4) if d < 2 else 0

    x = np.linspace(1.5, 6.5, 41)
    got = sampled(row, np.column_stack([x, np.zeros(41)]), "cubic")
    np.testing.assert_allclose(got, [keys(v - 4) for v in x], atol=1e-12)


@pytest.mark.parametrize("border", ["constant", "periodic", "reflected", "mirrored", "replicated"])
def test_samples_outside_are_those_of_a_padded_picture(border):
    from imgu_ros.vision.processing.borders import padded

    rng = np.random.default_rng(0)
    image = rng.random((7, 9), np.float32)
    xy = rng.uniform(-5, 14, (200, 2))
    for interpolation in ("nearest", "linear", "cubic"):
        expected = sampled(padded(image, 9, 9, border, 0.5), xy + 9, interpolation)
        np.testing.assert_allclose(sampled(image, xy, interpolation, border, 0.5), expected, atol=1e-9)


# ---------------------------------------------------------------------------------------------------------------------
# Warps

MAPS = {
    "translation": [[1, 0, 3.25], [0, 1, -2.5], [0, 0, 1]],
    "similarity": rotation_about(0.4, (50, 40), 1.2),
    "affine": [[1.1, 0.2, -6], [-0.1, 0.9, 8], [0, 0, 1]],
    "projective": [[1.05, 0.1, -4], [-0.05, 1.1, 3], [4e-4, -3e-4, 1]],
}


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize(("interpolation", "blur"), [("nearest", 0.05), ("linear", 0.004), ("cubic", 0.003)])
def test_every_pixel_lies_where_the_map_says(name, interpolation, blur):
    image = smooth_picture()
    H = np.array(MAPS[name])
    got = warped(image, H, (120, 100), interpolation, value=-1)
    v, u = np.mgrid[:100, :120]
    xy = mapped(np.linalg.inv(H), np.column_stack([u.ravel(), v.ravel()]).astype(float))
    inside = ((xy > 2) & (xy < np.array([107, 87]))).all(axis=1)
    # The picture is a formula: its values between pixels are known.
    x, y = xy[inside].T
    truth = 0.5 + 0.2 * np.sin(x / 8 + 0.3) * np.cos(y / 10) + 0.2 * np.sin((x + y) / 14)
    assert np.count_nonzero(inside) > 3000
    assert np.abs(got.ravel()[inside] - truth).max() < blur
    far = ((xy < -2) | (xy > np.array([111, 91]))).any(axis=1)
    np.testing.assert_allclose(got.ravel()[far], -1, atol=1e-6)


@pytest.mark.parametrize("name", MAPS)
def test_inverse_warps_return(name):
    image, H = smooth_picture(), np.array(MAPS[name])
    there = warped(image, H, (160, 140), "cubic")
    back = warped(there, np.linalg.inv(H), (110, 90), "cubic")
    v, u = np.mgrid[:90, :110]
    seen = mapped(H, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    inside = ((seen > 3) & (seen < np.array([156, 136]))).all(axis=1).reshape(90, 110)
    inside[:5] = inside[-5:] = inside[:, :5] = inside[:, -5:] = False
    assert np.count_nonzero(inside) > 4000
    assert np.abs(back - image)[inside].max() < 0.004


def test_whole_pixel_shifts_are_exact_with_every_border():
    image = np.random.default_rng(1).integers(0, 256, (8, 9, 3)).astype(np.uint8)
    H = [[1, 0, 2], [0, 1, 1], [0, 0, 1]]
    for border, mode in (
        ("periodic", "wrap"),
        ("reflected", "reflect"),
        ("mirrored", "symmetric"),
        ("replicated", "edge"),
    ):
        expected = np.pad(image, [(1, 0), (2, 0), (0, 0)], mode=mode)[:8, :9]
        for interpolation in ("nearest", "linear", "cubic"):
            np.testing.assert_array_equal(warped(image, H, None, interpolation, border), expected)
    constant = warped(image, H, None, "linear", "constant", 17)
    assert (constant[0] == 17).all() and (constant[:, :2] == 17).all()
    np.testing.assert_array_equal(constant[1:, 2:], image[:-1, :-2])


@pytest.mark.parametrize("turns", range(-3, 6))
@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic"])
def test_quarter_turns_lose_nothing(turns, interpolation):
    """Clockwise as seen, as `numpy.rot90` with negative turns; odd and even sides alike."""
    image = np.random.default_rng(2).integers(0, 256, (5, 8, 3)).astype(np.uint8)
    got = rotated(image, turns * math.pi / 2, whole=True, interpolation=interpolation)
    np.testing.assert_array_equal(got, np.rot90(image, -turns))


@given(st.floats(-4, 4), st.floats(-50, 50), st.floats(-50, 50), st.floats(0.1, 5))
def test_the_centre_stays_and_distances_scale(angle, x, y, scale):
    H = rotation_about(angle, (x, y), scale)
    np.testing.assert_allclose(mapped(H, [[x, y]]), [[x, y]], atol=1e-9)
    step = mapped(H, [[x + 1, y]])[0] - (x, y)
    np.testing.assert_allclose(step, [scale * math.cos(angle), scale * math.sin(angle)], atol=1e-9)


@given(st.floats(-4, 4), st.integers(1, 60), st.integers(1, 60))
def test_the_whole_picture_is_in_view_and_no_more(angle, width, height):
    canvas = whole_picture(rotation_about(angle, (7, -3)), (width, height))
    corners = np.array([[x, y] for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
    seen = mapped(canvas.H, corners)
    low, high = seen.min(axis=0) + 0.5, np.array(canvas.size) - 0.5 - seen.max(axis=0)
    # As much room on either side, less than half a pixel each: nothing is cut off, nothing wasted.
    np.testing.assert_allclose(low, high, atol=1e-9)
    assert (low > -1e-6).all() and (low < 0.5 + 1e-9).all()
    expected = width * abs(math.cos(angle)) + height * abs(math.sin(angle))
    assert canvas.size[0] - 1 < expected + 1e-6 and expected < canvas.size[0] + 1e-5


def test_rotation_about_a_point_moves_the_picture_as_said():
    image = np.zeros((61, 81), np.uint8)
    image[30, 60] = 255
    assert rotated(image, math.pi / 2, (40, 30))[50, 40] == 255  # from x towards y: down
    assert rotated(image, math.pi / 2)[50, 40] == 255  # (40, 30) is its centre
    assert rotated(image, math.pi, (60, 30))[30, 60] == 255
    turned = rotated(smooth_picture(), 0.7, whole=True)
    canvas = whole_picture(rotation_about(0.7, (54.5, 44.5)), (110, 90))
    assert turned.shape == canvas.size[::-1]
    at = mapped(canvas.H, [[30, 40]])
    assert sampled(turned, at)[0] == pytest.approx(float(smooth_picture()[40, 30]), abs=0.005)


def test_precision_of_linear_warps():
    """Within 1/64 px on every OpenCV."""
    ramp = np.tile(np.arange(100, dtype=np.float32) / 100, (5, 1))
    for shift in np.linspace(0, 1, 37):
        got = warped(ramp, [[1, 0, shift], [0, 1, 0], [0, 0, 1]])
        assert np.abs(100 * got[2, 5:95] - (np.arange(5, 95) - shift)).max() <= STEP_PX + 1e-4


@pytest.mark.parametrize(
    "call",
    [
        lambda: warped(np.zeros((4, 4), np.uint8), np.zeros((3, 3))),
        lambda: warped(np.zeros((4, 4), np.uint8), np.diag([1, 0, 1])),
        lambda: warped(np.zeros((4, 4), np.uint8), np.diag([1, 1e-200, 1])),
        lambda: warped(np.zeros((4, 4), np.uint8), np.eye(3), (0, 4)),
        lambda: warped(np.zeros((4, 4), np.uint8), np.eye(3), (4, 32767)),
        lambda: warped(np.zeros((4, 4), np.uint8), np.eye(3), (30000, 30000)),
        lambda: warped(np.zeros((4, 4), np.uint8), np.eye(3), (4.0, 4.0)),
        lambda: warped(np.zeros((4, 4), np.uint8), np.eye(3), 4),
        lambda: warped(np.zeros((4, 4), np.uint8), np.eye(3), None, "area"),
        lambda: warped(np.zeros((1, 40000), np.uint8), np.eye(3), (4, 4)),
        lambda: warped(np.zeros((4, 4), np.uint8), np.eye(3), value=300),
        lambda: rotated(np.zeros((4, 4), np.uint8), np.nan),
        lambda: rotation_about(0, (1e10, 0)),
        lambda: rotation_about(0, (1, 0), 0),
        lambda: whole_picture(np.diag([1e5, 1, 1]), (4, 4)),
        lambda: whole_picture([[1, 0, 0], [0, 1, 0], [-0.5, 0, 1]], (5, 5)),
        lambda: whole_picture(np.diag([1, 1, 1e-12]), (4, 4)),
        lambda: resized(np.zeros((4, 4), np.uint8), (0, 1)),
        lambda: resized(np.zeros((4, 4), np.uint8), (1, 1), "lanczos"),
        lambda: sampled(np.zeros((4, 4), np.uint8), [[0, 1e10]]),
        lambda: sampled(np.zeros((4, 4), np.uint8), [[0, 1]], "area"),
        lambda: sampled(np.zeros((4, 4), np.uint8), [0, 1]),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        call()


@pytest.mark.parametrize("way", ["nearest", "linear", "cubic"])
def test_a_map_of_a_homography_is_its_warp(way: str) -> None:
    H = np.array([[1.1, 0.2, -3], [-0.1, 0.9, 4], [1e-3, 2e-3, 1]])
    y, x = np.mgrid[0:30, 0:40].astype(float)
    mapped = np.stack((x, y, np.ones_like(x)), axis=-1) @ np.linalg.inv(H).T
    picture = np.random.default_rng(2).integers(0, 256, (30, 40, 3), np.uint8)
    smooth = np.asarray(np.cumsum(np.cumsum(picture // 64, axis=0), axis=1) % 65536, np.uint16)
    got = remapped(smooth, mapped[..., :2] / mapped[..., 2:], way, "replicated").astype(int)
    assert (np.abs(got - warped(smooth, H, None, way, "replicated")) > 40).mean() < 0.01


def test_a_map_by_hand_and_bad_ones() -> None:
    row = np.array([[10, 20, 40]], np.uint8)
    assert remapped(row, [[[0.5, 0], [1.75, 0], [7, 0]]], value=3).tolist() == [[15, 35, 3]]
    for xy in ([[0.0, 0.0]], np.zeros((0, 3, 2)), [[[np.nan, 0]]], [[[1e5, 0]]]):
        with pytest.raises(ShapeError, match="xy"):
            remapped(row, xy)
    with pytest.raises(ShapeError, match="area"):
        remapped(row, [[[0, 0]]], "area")
