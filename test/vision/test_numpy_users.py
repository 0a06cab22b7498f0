# SPDX-License-Identifier: Apache-2.0
"""What those write first who come from numpy, OpenCV or scikit-image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from imgu_ros.errors import ImguError
from imgu_ros.types import Image
from imgu_ros.vision.camera import calibrate, estimate_pose, exp_so3, fit_pose, make_camera
from imgu_ros.vision.descriptors import describe, describe_orb
from imgu_ros.vision.estimation import LineModel, fit_line, ransac
from imgu_ros.vision.formation import demosaic, expose
from imgu_ros.vision.formation.sensor import Sensor
from imgu_ros.vision.keypoints import detect, detect_fast
from imgu_ros.vision.matching import match
from imgu_ros.vision.processing import gamma_corrected, histogram, otsu_threshold, resized, thresholded, warped
from imgu_ros.vision.projective import (
    estimate_homography,
    fit_homography,
    join,
    line_distances,
    meet,
    transform,
    transform_lines,
)  # fmt: skip
from imgu_ros.vision.scale_space import build_pyramid, smooth

H = np.array([[0.96, -0.12, 30.0], [0.1, 1.02, -12.0], [1e-4, 5e-5, 1.0]])
K = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]


@pytest.fixture(scope="module")
def picture() -> Image:
    rng = np.random.default_rng(0)
    blocks = np.kron(rng.integers(20, 235, (24, 32)), np.ones((15, 15))).astype(np.uint8)
    return cv2.GaussianBlur(blocks, (0, 0), 1.0)


def _homography(first: Image, second: Image) -> np.ndarray:
    found = []
    for image in (first, second):
        pyramid = build_pyramid(image)
        found.append(describe(pyramid, detect(pyramid, "harris", 400), "sift"))
    pairs = match(found[0].descriptors, found[1].descriptors)
    src, dst = found[0].keypoints.xy[pairs.index_src], found[1].keypoints.xy[pairs.index_dst]
    return estimate_homography(src, dst, rng=0).H


def test_the_chain_of_a_float64_image_finds_what_that_of_its_bytes_finds(picture: Image) -> None:
    second = warped(picture, H, picture.shape[::-1])
    corners = np.array([[100, 80], [400, 80], [400, 280], [100, 280]])
    for first, other in ((picture, second), (picture / 255, second / 255), (picture.astype(int), second.astype(int))):
        np.testing.assert_allclose(transform(_homography(first, other), corners), transform(H, corners), atol=0.3)


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int64, np.uint32, np.int16, np.longdouble])
def test_single_functions_take_the_same_picture_in_other_types(picture: Image, dtype: type) -> None:
    other = (picture / dtype(255)).astype(dtype) if np.issubdtype(dtype, np.floating) else picture.astype(dtype)
    expected, got = detect_fast(picture, 50), detect_fast(other, 50)
    np.testing.assert_array_equal(got.xy, expected.xy)
    np.testing.assert_array_equal(describe_orb(other, got).descriptors, describe_orb(picture, expected).descriptors)
    assert histogram(other, 16).tolist() == pytest.approx(histogram(picture, 16).tolist(), abs=picture.size / 100)


def test_masks_are_pictures_of_0_and_1(picture: Image) -> None:
    mask = picture > 120
    share = smooth(mask, 3.0)
    assert share.dtype == np.float32
    np.testing.assert_allclose(share, smooth(mask.astype(np.float32), 3.0))
    moved = warped(mask, [[1, 0, 5], [0, 1, 0], [0, 0, 1]], interpolation="nearest")
    np.testing.assert_array_equal(moved[:, 5:] == 1, mask[:, :-5])
    np.testing.assert_array_equal(thresholded(mask, 0.5) == 1, mask)
    assert 0 < otsu_threshold(mask) < 1
    np.testing.assert_array_equal(resized(np.kron(mask, np.ones((2, 2), bool)), mask.shape[::-1], "area") == 1, mask)


def test_points_of_opencv(picture: Image) -> None:
    corners = cv2.goodFeaturesToTrack(picture, 40, 0.01, 10)
    seen = cv2.perspectiveTransform(corners, H)
    np.testing.assert_allclose(transform(H, corners), seen[:, 0], atol=1e-3)
    estimate = fit_homography(corners, seen)
    np.testing.assert_allclose(estimate.H / estimate.H[2, 2], H, atol=1e-4)
    keypoints = [cv2.KeyPoint(float(x), float(y), 7) for x, y in corners[:, 0]]
    np.testing.assert_allclose(fit_homography(keypoints, seen).H, estimate.H)
    drawn = np.zeros((100, 100), np.uint8)
    cv2.line(drawn, (10, 10), (90, 50), 255, 1)
    (contour,), _ = cv2.findContours(drawn, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    assert line_distances([(10, 10), (90, 50)], [fit_line(contour).line]).max() < 0.5


def test_sift_and_orb_of_opencv_and_bits_of_scikit_image(picture: Image) -> None:
    second = warped(picture, H, picture.shape[::-1])
    for detector in (cv2.SIFT.create(300), cv2.ORB.create(300)):
        (a, first), (b, other) = (detector.detectAndCompute(image, None) for image in (picture, second))
        pairs = match(first, other, ratio=0.8)
        estimate = estimate_homography([a[i] for i in pairs.index_src], [b[i] for i in pairs.index_dst], 0)
        np.testing.assert_allclose(transform(estimate.H, [[200, 150]]), transform(H, [[200, 150]]), atol=1.5)
    # scikit-image's ORB and BRIEF: a bool for each bit.
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2, (50, 256)).astype(bool)
    order = rng.permutation(50)
    noisy = bits[order] ^ (rng.random((50, 256)) < 0.05)
    pairs = match(bits, noisy)
    assert len(pairs) == 50
    np.testing.assert_array_equal(order[pairs.index_dst], pairs.index_src)
    expected = (bits[pairs.index_src] != noisy[pairs.index_dst]).sum(axis=1)
    np.testing.assert_array_equal(pairs.distance, expected)


def test_lines_and_points_as_tuples() -> None:
    assert meet([(1, 0, -3)], [(0, 1, -4)]).tolist() == [[3, 4, 1]]
    np.testing.assert_allclose(join([(0, 0)], ((1, 1),)), [[0.5**0.5, -(0.5**0.5), 0]])
    assert line_distances([(3, 4)], [(1, 0, 0)]).tolist() == [3]
    assert transform_lines(((1, 0, 0), (0, 1, 0), (0, 0, 1)), ((1, 0, -3),)).tolist() == [[1, 0, -3]]
    points = [(x, x) for x in range(12)] + [(3, 0), (7, 1)]
    assert ransac(LineModel(tuple(points)), 0.1, 0).inliers.tolist() == 12 * [True] + 2 * [False]


def test_a_seed_is_its_generator() -> None:
    rng = np.random.default_rng(5)
    src = rng.uniform(0, 400, (60, 2))
    dst = np.vstack((transform(H, src[:40]), rng.uniform(0, 400, (20, 2))))
    camera = make_camera(K, (), "plumb_bob", 640, 480)
    space = rng.uniform(-1, 1, (30, 3)) + [0, 0, 4]
    light = np.full((9, 9), 0.5)
    for seed, generator in ((3, np.random.default_rng(3)), (np.int64(3), np.random.default_rng(3))):
        np.testing.assert_array_equal(estimate_homography(src, dst, seed).H, estimate_homography(src, dst, generator).H)
    poses = [estimate_pose(space, camera.project(space), camera, rng).pose.t for rng in (3, np.random.default_rng(3))]
    np.testing.assert_array_equal(*poses)
    exposed = [expose(light, Sensor(12), rng) for rng in (3, np.random.default_rng(3))]
    np.testing.assert_array_equal(*exposed)


def test_calibration_from_the_lists_that_opencv_takes() -> None:
    camera = make_camera(np.array(K), np.zeros((1, 5)), "plumb_bob", 640, 480)
    board = [(0.03 * x, 0.03 * y, 0.0) for y in range(6) for x in range(9)]
    rng = np.random.default_rng(0)
    views = [
        camera.project(np.array(board) @ exp_so3(rng.uniform(-0.5, 0.5, 3)).T + [-0.1, -0.08, 0.5])
        .astype(np.float32)
        .reshape(-1, 1, 2)
        for _ in range(8)
    ]
    np.testing.assert_allclose(calibrate(board, views, 640, 480).camera.K, K, atol=0.1)
    np.testing.assert_allclose(calibrate(board, tuple(v.tolist() for v in views), 640, 480).camera.K, K, atol=0.1)
    space = np.array(board) + [-0.1, 0, 0.5] + [[0, 0, 0.1 * (i % 3)] for i in range(54)]
    np.testing.assert_allclose(fit_pose(space.tolist(), camera.project(space)[:, None], camera).t, 0, atol=1e-6)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: gamma_corrected(p.astype(float), 0.5), r"image: float32 from .* need floats in \[0, 1\]"),
        (lambda p: detect(p), "pyramid: ndarray; need a Pyramid, which build_pyramid makes of an image"),
        (lambda p: describe_orb(p, [cv2.KeyPoint(1, 2, 3)]), "corners: list; need Corners .corners_from_opencv makes"),
        (lambda p: detect_fast(p.astype(np.uint16), 9), "image: data type uint16; need uint8 .stretched_to_8_bit"),
        (lambda p: demosaic(p / 255, "rggb"), "raw: data type float64; need uint8, uint16"),
        (lambda p: smooth(p[..., None], 1.0), r"image: shape .* need \(H, W\) or \(H, W, 3\)"),
        (lambda p: smooth(np.ma.masked_equal(p, 0), 1.0), "image: a masked array; need a plain one"),
        (lambda p: smooth(p, "1"), "sigma: '1'; need a number"),
        (lambda p: detect_fast(p, 10.0), "max_count: 10.0; need an integer"),
        (lambda p: detect_fast(p, True), "max_count: True; need an integer"),
        (lambda p: match(p, p, mutual="no"), "mutual: 'no'; need True or False"),
        (lambda p: estimate_homography([(0, 0)] * 9, [(0, 0)] * 9, None), "rng: None; need a numpy.random.Generator"),
        (lambda p: estimate_homography(None, [], 0), "src: None; need numbers"),
        (lambda p: estimate_homography([], [], 0), "src, dst: 0 correspondences; need at least "),
        (lambda p: transform(np.eye(3), (3, 4)), r"points: shape \(2,\); need \(N >= 0, 2\)"),
        (lambda p: transform(np.eye(3), [(1, 2), (3,)]), "points: .*; need numbers"),
        (lambda p: fit_pose([(0, 0, 1)] * 5, [(1, 2)] * 5, np.array(K)), "camera: ndarray; need a Camera"),
    ],
)  # fmt: skip
def test_what_is_refused_is_named(picture: Image, call: object, message: str) -> None:
    with pytest.raises(ImguError, match=f"^{message}"):
        call(picture)  # type: ignore[operator]
