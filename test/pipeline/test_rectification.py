# SPDX-License-Identifier: Apache-2.0
"""Rectified pictures against the target's own picture, and against counting by hand."""

from __future__ import annotations

import functools

import cv2
import numpy as np
import pytest

from imgu_ros.image.rectification import rectified
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.types import Choice
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.processing.interpolation import Interpolation

TEMPLATE = (200, 150)
K = np.array([[420.0, 0, 309], [0, 430, 243], [0, 0, 1]])
H = np.array([[1.9, -0.5, 150], [0.4, 2.1, 40], [1e-4, 3e-4, 1]])
LENSES = {
    "plumb_bob": (-0.3, 0.08, 0.001, -0.002, 0.0),
    "equidistant": (-0.02, 0.003, 0.0, 0.0),
}


def smooth_texture() -> np.ndarray:
    return cv2.GaussianBlur(procedural_texture(*TEMPLATE, seed=5), (0, 0), 1.5)


def camera_with(lens: str | None) -> Camera | None:
    return None if lens is None else make_camera(K, LENSES[lens], lens, 640, 480)


@functools.cache
def seen_through(lens: str | None) -> np.ndarray:
    """The picture as H and the lens show it: each raw pixel's ray is undistorted, and H inverted."""
    camera, picture = camera_with(lens), smooth_texture()
    y, x = np.mgrid[0:480, 0:640].reshape(2, -1).astype(float)
    raw = np.column_stack((x, y))
    ideal = raw if camera is None else camera.ideal_pixels(raw)[0]
    template = np.column_stack((ideal, np.ones(len(ideal)))) @ np.linalg.inv(H).T
    places = (template[:, :2] / template[:, 2:]).astype(np.float32).reshape(480, 640, 2)
    return cv2.remap(picture, places, None, cv2.INTER_CUBIC, borderValue=(90, 90, 90))


@pytest.mark.parametrize("lens", [None, *LENSES])
@pytest.mark.parametrize("way", [*Interpolation])
def test_the_targets_own_picture_comes_back(lens: str | None, way: Choice) -> None:
    picture = smooth_texture()
    back = rectified(seen_through(lens), H, TEMPLATE, camera_with(lens), way)
    assert back.shape == picture.shape and back.dtype == picture.dtype
    error = np.abs(back.astype(float) - picture)[4:-4, 4:-4]
    assert error.mean() < (2.5 if way == "nearest" else 1.0)


def test_a_lens_that_is_left_out_shows() -> None:
    picture = smooth_texture()
    assert np.abs(rectified(seen_through("plumb_bob"), H, TEMPLATE).astype(float) - picture)[4:-4, 4:-4].mean() > 5


def test_area_is_the_mean_over_a_pixel() -> None:
    scene = np.random.default_rng(0).integers(0, 65536, (40, 60), np.uint16)
    four = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]])  # a pixel covers 4 x 4 of the scene's
    means = scene.reshape(10, 4, 15, 4).mean(axis=(1, 3))
    assert np.abs(rectified(scene, four, (15, 10)).astype(float) - means).max() <= 1
    assert np.array_equal(rectified(scene, four, (15, 10), interpolation="nearest"), scene[2::4, 2::4])


def test_strips_do_not_show() -> None:
    scene = np.tile(np.arange(0, 250, dtype=np.uint8), (1200, 1))
    assert np.array_equal(rectified(scene, np.eye(3), (250, 1200)), scene)
    tall = rectified(scene, np.diag([0.1, 1.0, 1.0]), (2500, 1200))
    assert (tall == tall[:1]).all()


def test_outside_and_behind_the_camera_is_black() -> None:
    scene = np.full((30, 40), 200, np.uint8)
    shifted = rectified(scene, np.array([[1, 0, 20], [0, 1, 0], [0, 0, 1.0]]), (40, 30))
    assert (shifted[:, :20] == 200).all() and (shifted[:, 20:] == 0).all()
    # w = 1 - x / 10: the right part lies behind the camera, where (x, y) / w would lie in the picture again.
    behind = rectified(scene, np.array([[1, 0, -20], [0, 1, -15], [-0.1, 0, 1.0]]), (40, 30))
    assert (behind[:, 10:] == 0).all()


def test_beyond_the_range_of_the_lens_is_black() -> None:
    # r (1 - r^2 / 2) folds at r = 0.816: the ray of r = 1.2 would land at 0.336 f, inside the picture.
    camera = make_camera([[100, 0, 50], [0, 100, 50], [0, 0, 1]], [-0.5], "plumb_bob", 101, 101)
    scene = np.full((101, 101), 200, np.uint8)
    row = rectified(scene, np.array([[10, 0, 50], [0, 1, 50], [0, 0, 1.0]]), (20, 1), camera, "nearest")[0]
    # Pixel x looks along r = x / 10; within the picture up to r (1 - r^2 / 2) = 0.5.
    assert (row[:6] == 200).all() and (row[9:] == 0).all()


@pytest.mark.parametrize("lens", [None, *LENSES])
@pytest.mark.parametrize("steepness", [0.0, 2e-3, 2e-2])
def test_places_are_as_exact_as_their_pixels(lens: str | None, steepness: float) -> None:
    # Values that are places: 90 x and 90 y, so that a hundredth of a pixel shows.
    y, x = np.mgrid[0:480, 0:640]
    camera = camera_with(lens)
    steep = np.array([[1.5, 0.1, 90], [0.2, 1.4, 60], [steepness, steepness / 2, 1]])
    u, v = np.mgrid[0:150, 0:200][::-1].reshape(2, -1).astype(float)
    ideal = np.column_stack((u, v, np.ones_like(u))) @ steep.T
    raw = ideal[:, :2] / ideal[:, 2:]
    raw = raw if camera is None else camera.raw_pixels(raw)
    inside = ((raw >= 1) & (raw <= (638, 478))).all(axis=1)
    assert inside.mean() > 0.5
    for values, truth in ((x, raw[:, 0]), (y, raw[:, 1])):
        got = rectified((90 * values).astype(np.uint16), steep, TEMPLATE, camera, "linear").ravel()
        # OpenCV 4 looks up at 1/32 px.
        assert np.abs(got / 90 - truth)[inside].max() < 0.03
