# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.keypoints.mser import detect_mser, find_regions


def discs(seed, ground, sign, blur, noise, size=(480, 360), count=10):
    """Blurred discs of radius 9 to 40 and contrast 50 to 150, apart from each other: picture, (N, 3) x y radius."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    light = np.full(x.shape, float(ground))
    placed: list[tuple[float, float, float]] = []
    while len(placed) < count:
        radius = rng.uniform(9, 40)
        cx, cy = rng.uniform(radius + 12, np.array(size) - radius - 12)
        if all(math.hypot(cx - a, cy - b) > radius + r + 12 for a, b, r in placed):
            placed.append((cx, cy, radius))
            light[(x - cx) ** 2 + (y - cy) ** 2 <= radius**2] += sign * rng.uniform(50, 150)
    light = cv2.GaussianBlur(light, (0, 0), blur) + noise * rng.standard_normal(x.shape)
    return np.rint(light).clip(0, 255).astype(np.uint8), np.array(placed)


@pytest.mark.parametrize(("ground", "sign"), [(60, 1), (200, -1)])
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_blurred_discs_are_found_with_their_area(ground, sign, noise):
    hits = []
    for seed, blur in enumerate((1.0, 1.5, 2.0)):
        picture, placed = discs(seed, ground, sign, blur, noise)
        regions = find_regions(picture)
        for cx, cy, radius in placed:
            near = np.hypot(*(regions.xy - (cx, cy)).T) < 0.5
            hits.append(bool((np.abs(regions.area[near] / (math.pi * radius**2) - 1) < 0.05).any()))
    assert np.mean(hits) >= 0.95


def test_scale_is_that_of_a_blob_detector():
    picture, placed = discs(7, 60, 1, 1.5, 1.0, count=6)
    found = detect_mser(picture, 100)
    for cx, cy, radius in placed:
        near = np.hypot(*(found.xy - (cx, cy)).T) < 0.5
        assert np.abs(found.scale[near] * math.sqrt(2) / radius - 1).min() < 0.03


def test_each_edge_gives_one_region():
    # Counting whole pixels makes the variation ripple; nested ripples are one family.
    picture, placed = discs(3, 60, 1, 2.0, 1.0)
    regions = find_regions(picture)
    for cx, cy, radius in placed:
        alike = (np.hypot(*(regions.xy - (cx, cy)).T) < 2) & (np.abs(regions.area / (math.pi * radius**2) - 1) < 0.15)
        assert np.count_nonzero(alike) == 1


def test_regions_of_a_picture_by_the_definition():
    """Areas and stability of isolated cones against sums over the picture: A(t) is the disc above the threshold."""
    y, x = np.mgrid[:121, :161]
    edge = 128 + 60 * np.tanh((20.3 - np.hypot(x - 80.2, y - 60.4)) / 3)
    picture = np.rint(edge).astype(np.uint8)
    regions = find_regions(picture, delta=4)
    areas = {int(a) for a in regions.area}
    thresholds = {int(np.count_nonzero(picture >= t)): t for t in range(60, 195)}
    bright = np.array([int(a) in thresholds for a in regions.area])
    assert bright.any() and areas
    best = int(np.argmax(np.where(bright, regions.stability, 0)))
    t = thresholds[int(regions.area[best])]
    variation = (np.count_nonzero(picture >= t - 4) - np.count_nonzero(picture >= t + 4)) / regions.area[best]
    assert regions.stability[best] == pytest.approx(1 / (1 + variation), rel=0.01)
    assert abs(t - 128) < 12


def test_flat_discs_with_sharp_edges_are_found():
    picture = np.full((100, 120), 60, np.uint8)
    cv2.circle(picture, (50, 40), 12, 180, -1)
    cv2.circle(picture, (90, 70), 9, 10, -1)
    regions = find_regions(picture)
    order = np.argsort(regions.xy[:, 0])
    np.testing.assert_allclose(regions.xy[order], [[50, 40], [90, 70]], atol=0.01)
    assert regions.area[order].tolist() == [np.count_nonzero(picture == 180), np.count_nonzero(picture == 10)]
    assert regions.stability.tolist() == [1.0, 1.0]


def test_light_and_dark_change_places_in_the_negative():
    picture, _ = discs(5, 60, 1, 1.5, 2.0)
    plain, negative = find_regions(picture), find_regions(255 - picture)
    assert len(plain.xy) == len(negative.xy)
    for name in ("area", "stability"):
        np.testing.assert_allclose(np.sort(getattr(plain, name)), np.sort(getattr(negative, name)))


def test_the_gain_of_the_picture_does_not_move_regions():
    # Thresholds that move with the contrast: the same sets of pixels.
    picture, _ = discs(6, 40, 1, 1.5, 1.0)
    half = (picture // 2).astype(np.uint8)
    whole, halved = find_regions(2 * half, delta=6), find_regions(half, delta=3)
    near = [np.hypot(*(whole.xy - xy).T).min() for xy in halved.xy]
    assert np.mean(np.array(near) < 0.5) > 0.9


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_right_angles_keep_nearly_all_regions(turns):
    # OpenCV's flood visits pixels of one value in another order, which decides between equal minima.
    picture = cv2.GaussianBlur(np.random.default_rng(3).integers(0, 256, (97, 120), np.uint8), (0, 0), 2.0)
    picture = cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX)
    plain, turned = find_regions(picture), find_regions(np.rot90(picture, turns))
    expected, (height, width) = plain.xy, picture.shape
    for _ in range(turns):  # counter-clockwise as seen: x' = y, y' = width - 1 - x
        expected = np.column_stack((expected[:, 1], width - 1 - expected[:, 0]))
        height, width = width, height
    apart = np.linalg.norm(expected[:, None] - turned.xy, axis=2)
    kept = (apart < 0.5) & (np.abs(plain.area[:, None] / turned.area - 1) < 0.05)
    assert len(plain.xy) > 40
    assert kept.any(axis=1).mean() > 0.9


def test_nothing_is_found_where_nothing_can_be():
    for picture in (np.zeros((1, 1), np.uint8), np.full((60, 60), 9, np.uint8), np.zeros((2, 400), np.uint8)):
        regions = find_regions(picture)
        assert regions.xy.shape == (0, 2) and regions.area.shape == regions.stability.shape == (0,)


@pytest.mark.parametrize(
    "wrong",
    [{"delta": 0}, {"delta": 61}, {"min_area": 0}, {"max_share": 0.0}, {"max_share": 1.5}, {"max_share": math.nan},
     {"max_variation": 0.0}, {"max_variation": math.nan}],
)  # fmt: skip
def test_bad_parameters_are_refused(wrong):
    with pytest.raises(ShapeError, match=r"^delta, [^\n]+need[^\n]+$"):
        find_regions(np.zeros((40, 40), np.uint8), **wrong)
