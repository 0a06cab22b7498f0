# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.descriptors.brief import describe_brief
from imgu_ros.vision.descriptors.describe import describe, empty_descriptors
from imgu_ros.vision.descriptors.orb import describe_orb
from imgu_ros.vision.descriptors.patch import describe_patch
from imgu_ros.vision.descriptors.sift import describe_rootsift, describe_sift
from imgu_ros.vision.keypoints.detect import detect
from imgu_ros.vision.keypoints.keypoints import Corners, Keypoints
from imgu_ros.vision.matching.metrics import metric_for
from imgu_ros.vision.matching.nearest import match
from imgu_ros.vision.methods import DESCRIPTORS
from imgu_ros.vision.scale_space.pyramid import build_pyramid

KINDS = list(DESCRIPTORS)
TURNING = [kind for kind in KINDS if kind != "brief"]  # BRIEF is upright
FORM = {
    "orb": (32, np.uint8),
    "sift": (128, np.float32),
    "rootsift": (128, np.float32),
    "brief": (32, np.uint8),
    "patch": (169, np.float32),
}


def texture(height, width, seed=0, smoothing=1.5):
    noise = np.random.default_rng(seed).random((height, width)).astype(np.float32)
    mixed = cv2.GaussianBlur(noise, (0, 0), smoothing) + 2 * cv2.GaussianBlur(noise, (0, 0), 3 * smoothing)
    return cv2.normalize(mixed, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def keypoints_at(*xy, scale=2.0, angle=0.0, octave=0):
    points = np.array(xy, float).reshape(-1, 2)
    n = len(points)
    return Keypoints(points, np.full(n, scale), np.full(n, angle), np.ones(n), np.full(n, octave, np.int32))


def turned(picture, degrees, scale=1.0):
    """The picture, rotated about its centre, and the points' map; sampled four times as finely for little error."""
    center = ((picture.shape[1] - 1) / 2, (picture.shape[0] - 1) / 2)
    warp = cv2.getRotationMatrix2D(center, degrees, scale)
    out = cv2.warpAffine(picture, warp, picture.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return out, warp


@pytest.mark.parametrize("kind", TURNING)
@pytest.mark.parametrize("degrees", range(15, 360, 15))
def test_noise_free_correspondences_are_kept_at_every_rotation(kind, degrees):
    # The same points, mapped, with their angles turned: at least 80 % find their partner among all.
    picture = texture(241, 241)
    other, warp = turned(picture, degrees)
    a = detect(build_pyramid(picture, levels=1), "orb", 500)
    a = a.chosen(np.linalg.norm(a.xy - 120, axis=1) < 85)
    b = Keypoints(a.xy @ warp[:, :2].T + warp[:, 2], a.scale, a.angle - math.radians(degrees), a.response, a.octave)
    described_a = describe(build_pyramid(picture, levels=1), a, kind)
    described_b = describe(build_pyramid(other, levels=1), b, kind)
    assert len(described_a.descriptors) == len(described_b.descriptors) == len(a) > 60
    found = match(described_a.descriptors, described_b.descriptors, metric_for(kind), ratio=0.85)
    right = found.index_src == found.index_dst
    assert right.sum() >= 0.8 * len(a)
    assert right.mean() >= 0.97


@pytest.mark.parametrize("kind", TURNING)
@pytest.mark.parametrize("degrees", [35, 140])
def test_detected_and_described_points_match_right(kind, degrees):
    picture = texture(241, 241, 1)
    other, warp = turned(picture, degrees)
    described = [
        describe(pyramid, detect(pyramid, "orb", 400), kind)
        for pyramid in (build_pyramid(picture, "fine", 4), build_pyramid(other, "fine", 4))
    ]
    found = match(described[0].descriptors, described[1].descriptors, metric_for(kind), ratio=0.8)
    expected = described[0].keypoints.xy[found.index_src] @ warp[:, :2].T + warp[:, 2]
    error = np.linalg.norm(described[1].keypoints.xy[found.index_dst] - expected, axis=1)
    assert len(found) >= 40
    assert (error < 4).mean() > 0.8


@pytest.mark.parametrize("kind", KINDS)
def test_offset_and_gain_hardly_matter(kind):
    picture = texture(160, 160, 2)
    points = detect(build_pyramid(picture, levels=1), "orb", 100)
    plain = describe(build_pyramid(picture, levels=1), points, kind).descriptors
    darker = np.rint(picture * 0.7 + 40).astype(np.uint8)
    changed = describe(build_pyramid(darker, levels=1), points, kind).descriptors
    found = match(plain, changed, metric_for(kind))
    assert (found.index_src == found.index_dst).all() and len(found) > 0.95 * len(plain) > 70


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_right_angles_change_few_bits(turns):
    picture = texture(101, 101, 3)
    points = np.array([[x, y] for x in range(25, 80, 9) for y in range(25, 80, 9)], float)
    angle = np.linspace(-3, 3, len(points))
    expected = points
    for _ in range(turns):
        expected = np.column_stack((expected[:, 1], 100 - expected[:, 0]))
    ones = np.ones(len(points))
    a = describe_orb(picture, Corners(points, ones, angle, ones))
    b = describe_orb(np.rot90(picture, turns).copy(), Corners(expected, ones, angle - turns * math.pi / 2, ones))
    assert a.index.tolist() == b.index.tolist() == list(range(len(points)))
    differing = [
        sum((int(x) ^ int(y)).bit_count() for x, y in zip(p, q, strict=True))
        for p, q in zip(a.descriptors, b.descriptors, strict=True)
    ]
    assert np.mean(differing) < 6  # of 256: rounding of rotated positions


@pytest.mark.parametrize("kind", KINDS)
def test_levels_are_described_alone(kind):
    # A point on level k gets what the same point gets on a pyramid of that level's picture alone.
    pyramid = build_pyramid(texture(200, 240, 4), "coarse", 3)
    points = [(100.5, 90.5), (140.5, 120.5)]
    mixed = Keypoints(
        np.array([points[0], points[1], points[0]]),
        np.array([8.0, 2.0, 4.0]),
        np.zeros(3),
        np.ones(3),
        np.array([2, 0, 1], np.int32),
    )
    described = describe(pyramid, mixed, kind)
    assert described.keypoints.octave.tolist() == [0, 1, 2]
    for level in (0, 1, 2):
        alone = build_pyramid(pyramid.levels[level].image, levels=1)
        step = pyramid.levels[level].step
        row = int(np.flatnonzero(mixed.octave == level)[0])
        xy = (mixed.xy[row] + 0.5) / step - 0.5
        expected = describe(alone, keypoints_at(xy, scale=2.0), kind)
        np.testing.assert_array_equal(described.descriptors[level], expected.descriptors[0])
        np.testing.assert_array_equal(described.keypoints.xy[level], mixed.xy[row])


def test_sift_rows_have_their_norm():
    picture = texture(150, 150, 5)
    points = detect(build_pyramid(picture), "dog", 60)
    pyramid = build_pyramid(picture)
    sift = describe(pyramid, points, "sift").descriptors
    assert sift.min() >= 0 and sift.max() <= 255
    np.testing.assert_allclose(np.linalg.norm(sift, axis=1), 512, rtol=0.02)
    root = describe(pyramid, points, "rootsift").descriptors
    np.testing.assert_allclose(np.linalg.norm(root, axis=1), 1, rtol=1e-5)
    np.testing.assert_allclose(root**2, sift / sift.sum(axis=1, keepdims=True), atol=1e-6)


def test_sift_of_a_ramp_points_one_way():
    # A plane has one gradient direction: every histogram of 8 bins holds it in one bin, relative to the angle.
    picture = np.tile(np.arange(0, 240, 2, dtype=np.uint8), (120, 1))
    for angle in (0.0, math.pi / 2):
        row = describe_sift(picture, Corners(np.array([[60.0, 60]]), np.array([2.0]), np.array([angle]), np.ones(1)))
        bins = row.descriptors.reshape(16, 8).sum(axis=0)
        assert bins.max() > 0.95 * bins.sum()


@pytest.mark.parametrize("kind", KINDS)
def test_borders(kind):
    picture = texture(100, 120, 6)
    pyramid = build_pyramid(picture, levels=1)
    for x in np.arange(0, 120, 4.7 if "sift" in kind else 0.7):
        for y in (15.6, 50.0, 83.4, 83.6, 84.0):
            described = describe(pyramid, keypoints_at((x, y)), kind)
            columns, dtype = FORM[kind]
            assert described.descriptors.shape == (len(described.keypoints), columns)
            assert described.descriptors.dtype == dtype
            inside = {
                "orb": min(x, y) >= 16 and round(x) < 104 and round(y) < 84,
                "brief": min(round(x), round(y)) >= 15 and round(x) < 105 and round(y) < 85,
                "patch": min(x, y, 119 - x, 99 - y) >= 6 * 1.75 * 2,
            }.get(kind)
            if inside is not None:
                assert len(described.keypoints) == inside


@pytest.mark.parametrize("kind", KINDS)
def test_none_to_describe(kind):
    columns, dtype = FORM[kind]
    assert empty_descriptors(kind).shape == (0, columns) and empty_descriptors(kind).dtype == dtype
    for shape in ((1, 1), (40, 40)):
        got = describe(build_pyramid(np.zeros(shape, np.uint8)), keypoints_at(), kind)
        assert got.descriptors.shape == (0, columns) and got.descriptors.dtype == dtype
        assert len(got.keypoints) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_flat_and_tiny_pictures(kind):
    for picture in (np.full((90, 90), 77, np.uint8), np.zeros((3, 3), np.uint8), np.zeros((1, 1), np.uint8)):
        got = describe(build_pyramid(picture), keypoints_at((1.0, 1.0), (45.0, 45.0)), kind)
        assert np.isfinite(got.descriptors.astype(float)).all()


@pytest.mark.parametrize("describing", [describe_sift, describe_rootsift])
def test_sift_windows_too_small_for_opencv_are_refused(describing):
    picture, at = texture(40, 40, 1), np.array([[20.0, 20.0]])
    assert len(describing(picture, Corners(at, np.array([0.5]), np.zeros(1), np.ones(1))).index) == 1
    with pytest.raises(ShapeError, match=r"need at least 0.5 px"):
        describing(picture, Corners(at, np.array([0.1]), np.zeros(1), np.ones(1)))


@pytest.mark.parametrize("kind", KINDS)
def test_read_only_views(kind):
    wide = texture(90, 180, 7)
    view = wide[:, 40:140]
    view.flags.writeable = False
    points = keypoints_at((50.0, 45.0), (40.0, 40.0))
    np.testing.assert_array_equal(
        describe(build_pyramid(view, levels=1), points, kind).descriptors,
        describe(build_pyramid(view.copy(), levels=1), points, kind).descriptors,
    )


NAN = math.nan


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "points",
    [
        keypoints_at((NAN, 50.0)),
        keypoints_at((math.inf, 50.0)),
        keypoints_at((1e12, 50.0)),
        keypoints_at((50.0, 50.0), scale=NAN),
        keypoints_at((50.0, 50.0), scale=0.0),
        keypoints_at((50.0, 50.0), scale=-1.0),
        keypoints_at((50.0, 50.0), scale=1e12),
        keypoints_at((50.0, 50.0), angle=NAN),
        keypoints_at((50.0, 50.0), octave=9),
        keypoints_at((50.0, 50.0), octave=-1),
    ],
)
def test_absurd_keypoints_are_refused(kind, points):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        describe(build_pyramid(np.zeros((100, 100), np.uint8)), points, kind)


@pytest.mark.parametrize("function", [describe_orb, describe_sift, describe_rootsift, describe_brief, describe_patch])
@pytest.mark.parametrize("picture", [np.zeros((80, 80), np.uint16), np.zeros((80, 80, 3), np.uint8), None])
def test_bad_pictures_are_refused(function, picture):
    corners = Corners(np.array([[40.0, 40.0]]), np.ones(1), np.zeros(1), np.ones(1))
    with pytest.raises(ShapeError):
        function(picture, corners)


def test_unknown_kinds_are_refused():
    with pytest.raises(ShapeError, match="need one of orb, sift, rootsift"):
        describe(build_pyramid(np.zeros((80, 80), np.uint8)), keypoints_at((40.0, 40.0)), "surf")
    with pytest.raises(ShapeError):
        empty_descriptors("brisk")
