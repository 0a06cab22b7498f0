# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.descriptors.describe import describe
from imgu_ros.vision.keypoints.detect import detect
from imgu_ros.vision.keypoints.dog import detect_dog
from imgu_ros.vision.keypoints.fast import FastParameters, detect_fast
from imgu_ros.vision.keypoints.harris import detect_harris
from imgu_ros.vision.keypoints.keypoints import on_level
from imgu_ros.vision.keypoints.moravec import detect_moravec
from imgu_ros.vision.keypoints.mser import detect_mser
from imgu_ros.vision.keypoints.orb import detect_orb
from imgu_ros.vision.methods import DESCRIPTORS, DETECTORS
from imgu_ros.vision.scale_space.pyramid import build_pyramid

ON_ONE_PICTURE = {
    "fast": detect_fast,
    "harris": detect_harris,
    "moravec": detect_moravec,
    "dog": detect_dog,
    "mser": detect_mser,
    "orb": detect_orb,
}


def texture(height, width, seed=0, smoothing=1.2):
    noise = np.random.default_rng(seed).random((height, width)).astype(np.float32)
    mixed = cv2.GaussianBlur(noise, (0, 0), smoothing) + 2 * cv2.GaussianBlur(noise, (0, 0), 4 * smoothing)
    return cv2.normalize(mixed, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def square(size=120, low=44, high=77, angle_deg=0.0):
    """A bright square on dark ground, its edges anti-aliased; returns the picture and its four corners."""
    factor = 16
    y, x = (np.mgrid[: size * factor, : size * factor] + 0.5) / factor - 0.5
    center = (low + high) / 2
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    u, v = c * (x - center) + s * (y - center), -s * (x - center) + c * (y - center)
    half = (high - low) / 2
    inside = (np.abs(u) <= half) & (np.abs(v) <= half)
    share = inside.reshape(size, factor, size, factor).mean(axis=(1, 3))
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    return np.rint(40 + 160 * share).astype(np.uint8), corners @ np.array([[c, s], [-s, c]]) + center


def angle_between(a, b):
    return np.abs((np.asarray(a) - b + math.pi) % (2 * math.pi) - math.pi)


@pytest.mark.parametrize(("detector", "tolerance"), [("fast", 2.5), ("harris", 2.0), ("moravec", 2.5), ("orb", 2.5)])
@pytest.mark.parametrize("turn", [0, 20, 63])
def test_corners_of_a_square(detector, tolerance, turn):
    picture, corners = square(angle_deg=turn)
    found = detect(build_pyramid(picture, levels=1), detector, 50)
    assert len(found) >= 4
    apart = np.linalg.norm(found.xy[:, None] - corners, axis=2)
    assert (apart.min(axis=0) <= tolerance).all()  # each corner is found,
    if detector != "moravec" or turn == 0:  # Moravec's eight directions take slanted edges for corners.
        assert (apart.min(axis=1) <= tolerance + 1.5).all()  # and nothing else
    # The centroid of a corner's patch lies towards the square's centre.
    inward = picture.shape[0] / 2 + 0.5 - found.xy
    assert angle_between(found.angle, np.arctan2(inward[:, 1], inward[:, 0])).max() < 0.35


@pytest.mark.parametrize("detector", ["fast", "harris", "moravec", "orb"])
def test_scale_follows_the_level(detector):
    picture = texture(300, 400)
    pyramid = build_pyramid(picture, "fine", 7)
    found = detect(pyramid, detector, 2000)
    assert set(found.octave.tolist()) == set(range(len(pyramid.levels)))
    base = found.scale[found.octave == 0][0]
    assert 0.5 <= base <= 3
    for index, level in enumerate(pyramid.levels):
        of_level = found.chosen(found.octave == index)
        np.testing.assert_allclose(of_level.scale, base * level.scale)
        corners = on_level(of_level, level)
        np.testing.assert_allclose(corners.scale, base)
        h, w = level.image.shape
        assert (corners.xy >= 0).all() and (corners.xy <= [w - 1, h - 1]).all()
        assert (np.diff(of_level.response) <= 0).all()


@pytest.mark.parametrize("detector", list(DETECTORS))
def test_count_is_a_limit_and_is_reached(detector):
    pyramid = build_pyramid(texture(240, 320, smoothing=0.8), "fine", 5)
    for count in (1, 7, 100):
        for even in (False, True):
            found = detect(pyramid, detector, count, even)
            assert len(found) <= count
            assert len(found) == count or even
            assert found.octave.dtype == np.int32
            assert ((found.angle >= -math.pi) & (found.angle < math.pi)).all()
            assert len({len(found.xy), len(found.scale), len(found.angle), len(found.response), len(found.octave)}) == 1


def test_shares_follow_area_or_are_even():
    pyramid = build_pyramid(texture(256, 256, smoothing=0.8), "coarse", 3)
    by_area = np.bincount(detect(pyramid, "fast", 210).octave, minlength=3)
    assert by_area.tolist() == [160, 40, 10]
    even = np.bincount(detect(pyramid, "fast", 210, even_scales=True).octave, minlength=3)
    assert even[:2].tolist() == [70, 70] and 0 < even[2] <= 70


@pytest.mark.parametrize("detector", ["fast", "harris", "moravec", "orb"])
def test_a_busy_corner_does_not_get_them_all(detector):
    rng = np.random.default_rng(1)
    picture = texture(256, 256, 2)
    picture = (100 + (picture.astype(float) - 128) * 0.5).clip(0, 255).astype(np.uint8)
    picture[:40, :40] = np.kron(rng.integers(0, 2, (10, 10)), np.ones((4, 4))) * 255
    found = detect(build_pyramid(picture, levels=1), detector, 64)
    inside = ((found.xy < 44).all(axis=1)).mean()
    assert inside < 0.8  # the strongest half may lie anywhere


@pytest.mark.parametrize("detector", ["fast", "harris", "orb"])
@pytest.mark.parametrize("turns", [1, 2, 3])
def test_rotation_by_right_angles_is_exact(detector, turns):
    picture = texture(97, 120, 3)
    plain = ON_ONE_PICTURE[detector](picture, 10_000)
    rotated = ON_ONE_PICTURE[detector](np.rot90(picture, turns).copy(), 10_000)
    assert len(plain.xy) == len(rotated.xy) > 20
    expected, (height, width) = plain.xy, picture.shape
    for _ in range(turns):  # counter-clockwise as seen: x' = y, y' = width - 1 - x
        expected = np.column_stack((expected[:, 1], width - 1 - expected[:, 0]))
        height, width = width, height
    apart = np.linalg.norm(expected[:, None] - rotated.xy, axis=2)
    partner = apart.argmin(axis=1)
    assert apart.min(axis=1).max() < 1e-3
    assert len(set(partner.tolist())) == len(partner)
    np.testing.assert_allclose(rotated.scale[partner], plain.scale)
    np.testing.assert_allclose(rotated.response[partner], plain.response, rtol=1e-3)
    turned = plain.angle - turns * math.pi / 2
    assert angle_between(rotated.angle[partner], turned).max() < (0.02 if detector == "orb" else 1e-6)


@pytest.mark.parametrize("detector", list(DETECTORS))
@pytest.mark.parametrize("angle_deg", [25, 115, 200])
def test_rotation_by_other_angles(detector, angle_deg):
    picture = texture(260, 260, 4, 2.0)
    center = 129.5
    warp = cv2.getRotationMatrix2D((center, center), angle_deg, 1.0)
    turned = cv2.warpAffine(picture, warp, (260, 260), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    a = detect(build_pyramid(picture, levels=1), detector, 400)
    b = detect(build_pyramid(turned, levels=1), detector, 400)
    a = a.chosen(np.linalg.norm(a.xy - center, axis=1) < 95)
    expected = a.xy @ warp[:, :2].T + warp[:, 2]
    apart = np.linalg.norm(expected[:, None] - b.xy, axis=2)
    hit = apart.min(axis=1) < 1.5
    assert hit.mean() > 0.5
    error = angle_between(b.angle[apart.argmin(axis=1)], a.angle - math.radians(angle_deg))[hit]
    assert np.median(error) < 0.1


def test_symmetric_dots_give_one_harris_corner_each():
    # A dot of 2x2 pixels has four equal maxima of the response: one corner, at its centre.
    picture = np.full((60, 60), 50, np.uint8)
    for x, y in ((20, 20), (40, 33)):
        picture[y : y + 2, x : x + 2] = 250
    found = detect_harris(picture, 100)
    apart = np.linalg.norm(found.xy[:, None] - np.array([[20.5, 20.5], [40.5, 33.5]]), axis=2)
    assert (apart.min(axis=0) < 0.51).all()
    pairs = np.linalg.norm(found.xy[:, None] - found.xy, axis=2)[~np.eye(len(found.xy), dtype=bool)]
    assert pairs.min() > 1.0


@pytest.mark.parametrize("detector", list(DETECTORS))
@pytest.mark.parametrize("shape", [(1, 1), (1, 60), (60, 1), (5, 5), (8, 9), (9, 9), (31, 31), (32, 33), (33, 200)])
def test_tiny_and_narrow_pictures(detector, shape):
    picture = np.random.default_rng(5).integers(0, 256, shape, np.uint8)
    found = detect(build_pyramid(picture), detector, 30)
    assert len(found) <= 30
    assert np.isfinite(found.xy).all() and np.isfinite(found.angle).all()


@pytest.mark.parametrize("detector", list(DETECTORS))
def test_flat_pictures_have_none(detector):
    for value in (0, 128, 255):
        found = detect(build_pyramid(np.full((120, 120), value, np.uint8), "fine"), detector, 100)
        assert len(found) == 0 and found.xy.shape == (0, 2) and found.octave.dtype == np.int32


@pytest.mark.parametrize("detector", list(DETECTORS))
def test_read_only_views_and_repeatability(detector):
    wide = texture(100, 200, 6)
    view = wide[:, 50:170]
    view.flags.writeable = False
    first, second = (detect(build_pyramid(p, levels=1), detector, 60) for p in (view, view.copy()))
    np.testing.assert_array_equal(first.xy, second.xy)
    # Where a picture lies in memory decides the order of OpenCV's float sums.
    np.testing.assert_allclose(first.angle, second.angle, atol=1e-8)


@pytest.mark.parametrize("detector", list(DETECTORS))
@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((50, 50), np.uint16),
        np.full((50, 50), 9, np.float32),
        np.full((50, 50), 300),
        np.zeros((50, 50), complex),
        np.zeros((50, 50, 3), np.uint8),
        np.zeros((0, 0), np.uint8),
        None,
    ],
)
def test_bad_pictures_are_refused(detector, picture):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        ON_ONE_PICTURE[detector](picture, 10)


@pytest.mark.parametrize(
    ("dtype", "detector", "count"),
    [
        (np.uint16, "fast", 5),
        (np.uint8, "sift", 5),
        (np.uint8, "fast", 0),
        (np.uint8, "orb", -1),
    ],
)
def test_bad_arguments_are_refused(dtype, detector, count):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        detect(build_pyramid(np.zeros((50, 50), dtype)), detector, count)


@pytest.mark.parametrize("arc", [8, 13, 0])
def test_bad_arcs_are_refused(arc):
    with pytest.raises(ShapeError, match=r"^arc: [^\n]+need 9, 10, 11 or 12$"):
        detect(build_pyramid(np.zeros((50, 50), np.uint8)), "fast", 5, parameters=FastParameters(arc))


def test_longer_arcs_reach_every_level():
    pyramid = build_pyramid(texture(256, 256, 7, 0.8), "coarse", 3)
    nine, twelve = (detect(pyramid, "fast", 10_000, parameters=FastParameters(arc)) for arc in (9, 12))
    assert 0 < len(twelve) < len(nine)
    assert set(twelve.octave.tolist()) == set(nine.octave.tolist())


@pytest.mark.parametrize("detector", ["fast", "harris", "moravec", "dog", "mser"])
def test_faint_corners_far_from_a_crowd_are_not_forgotten(detector):
    """A tenth of the picture holds far more strong structures than are wanted; the rest holds faint ones."""
    rng = np.random.default_rng(8)
    picture = np.full((320, 320), 100, np.uint8)
    for y, x in np.argwhere(np.ones((8, 8))) * 38 + 20:
        cv2.circle(picture, (int(x), int(y)), 5, 130, -1)
    picture[:100, :100] = np.kron(rng.integers(0, 2, (20, 20)), np.ones((5, 5))) * 200
    picture = cv2.GaussianBlur(picture, (0, 0), 1.0)
    found = detect(build_pyramid(picture, levels=1), detector, 40)
    outside = (found.xy > 104).any(axis=1).mean()
    assert outside > 0.25


@pytest.mark.parametrize("descriptor", list(DESCRIPTORS))
@pytest.mark.parametrize("detector", list(DETECTORS))
def test_every_detector_with_every_descriptor(detector, descriptor):
    pyramid = build_pyramid(texture(200, 240, 9, 1.5), "fine", 6)
    found = detect(pyramid, detector, 200)
    described = describe(pyramid, found, descriptor)
    assert len(described.keypoints) > 0.2 * len(found) > 5
    assert np.isfinite(described.descriptors).all()
