# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import itertools
import math

import cv2
import numpy as np
import pytest

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.keypoints import repeatability
from imgu_ros.vision.projective import similarity, transform

SIZE = (640, 480)
H = np.array([[0.9, -0.2, 60.0], [0.15, 1.05, -30.0], [1e-4, -5e-5, 1.0]])


def _inside(xy: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return ((xy >= 0) & (xy <= np.array(size) - 1)).all(axis=1)


@pytest.mark.parametrize(("lost", "invented"), [(0, 0), (30, 0), (0, 50), (40, 70)])
def test_share_of_known_points(lost: int, invented: int) -> None:
    rng = np.random.default_rng(lost + invented)
    # A grid: no two points can be mistaken for each other.
    src = np.stack(np.meshgrid(np.arange(10.0, 630, 20), np.arange(10.0, 470, 20)), axis=-1).reshape(-1, 2)
    seen = transform(H, src)
    common = np.flatnonzero(_inside(seen, SIZE))
    kept = rng.permutation(common)[lost:]
    jitter = rng.uniform(-0.5, 0.5, (len(kept), 2))
    jitter[~_inside(seen[kept] - 2, (SIZE[0] - 4, SIZE[1] - 4))] = 0  # what is near the border stays inside
    outside = np.array([[-5.0, 3.0], [700.0, 100.0]])
    # Invented points lie half-way between others, far from all.
    other = transform(H, src[common[:invented]] + [10, 10])
    other = other[_inside(other, SIZE)]
    found = repeatability(src, np.vstack((seen[kept] + jitter, other, outside)), H, SIZE)
    in_dst = len(kept) + len(other)
    assert found.common_src.nonzero()[0].tolist() == common.tolist()
    assert len(found.index_src) == len(kept)
    assert found.share == pytest.approx(len(kept) / min(len(common), in_dst))
    np.testing.assert_array_equal(kept[found.index_dst], found.index_src)
    assert not found.common_dst[-2:].any()


def test_against_all_pairs_one_after_the_other() -> None:
    rng = np.random.default_rng(3)
    src, dst = rng.uniform(0, 640, (120, 2)) * [1, 0.75], rng.uniform(0, 640, (150, 2)) * [1, 0.75]
    found = repeatability(src, dst, H, SIZE, SIZE, 25.0)
    back = np.linalg.inv(H)
    a = [i for i in range(120) if _inside(src, SIZE)[i] and _inside(transform(H, src[i : i + 1]), SIZE)[0]]
    b = [j for j in range(150) if _inside(dst, SIZE)[j] and _inside(transform(back, dst[j : j + 1]), SIZE)[0]]
    apart = {
        (i, j): max(math.dist(transform(H, [src[i]])[0], dst[j]), math.dist(src[i], transform(back, [dst[j]])[0]))
        for i, j in itertools.product(a, b)
    }
    pairs: list[tuple[int, int]] = []
    for (i, j), distance in sorted(apart.items(), key=lambda item: item[1]):
        if distance <= 25 and all(i != k and j != m for k, m in pairs):
            pairs.append((i, j))
    assert 20 < len(pairs) == len(found.index_src)
    assert list(zip(found.index_src.tolist(), found.index_dst.tolist(), strict=True)) == pairs
    assert found.share == len(pairs) / min(len(a), len(b))


def test_a_zoom_helps_nobody() -> None:
    src = np.array([[100.0, 100.0], [300.0, 200.0]])
    half = similarity(0.5, 0.0, [0, 0])
    off = np.array([[2.0, 0.0]])
    # 1 px off in the smaller picture is 2 px off in the larger one.
    assert repeatability(src, src / 2 + off / 2, half, SIZE).share == 0
    assert repeatability(src, src / 2 + off / 3, half, SIZE).share == 1
    assert repeatability(src / 2 + off / 2, src, np.linalg.inv(half), SIZE).share == 0


def test_each_keypoint_counts_once() -> None:
    found = repeatability([[50, 50], [51, 50]], [[50.4, 50]], np.eye(3), (100, 100))
    assert found.index_src.tolist() == [0] and found.share == 1


def test_mirrored_and_scaled_homographies_are_homographies() -> None:
    flip = np.array([[-1.0, 0, 99], [0, 1, 0], [0, 0, 1]])
    src = np.array([[10.0, 20.0], [70.0, 80.0]])
    for factor in (1, -3):
        assert repeatability(src, [[89, 20], [29, 80]], factor * flip, (100, 100)).share == 1


def test_what_lies_beyond_the_horizon_is_not_in_the_common_part() -> None:
    steep = np.array([[1.0, 0, 0], [0, 1, 0], [0, -0.015, 1]])
    found = repeatability([[10.0, 10.0], [10.0, 90.0]], transform(steep, [[10.0, 10.0]]), steep, (100, 100), (900, 900))
    assert found.common_src.tolist() == [True, False] and found.share == 1


def test_no_keypoints_and_lists_as_opencv_has_them() -> None:
    assert repeatability([], [], np.eye(3), SIZE).share == 0
    assert repeatability([[1, 2]], [], np.eye(3), SIZE).share == 0
    keypoints = [cv2.KeyPoint(5, 6, 7), cv2.KeyPoint(50, 60, 7)]
    assert repeatability(keypoints, np.array([[[5, 6]], [[50, 60]]], np.float32), np.eye(3), SIZE).share == 1


def test_bad_arguments() -> None:
    points = [[1.0, 2.0]]
    for call in (
        lambda: repeatability(points, points, np.eye(3), (0, 5)),
        lambda: repeatability(points, points, np.eye(3), (5, 5, 5)),
        lambda: repeatability(points, points, np.eye(3), SIZE, None, 0),
        lambda: repeatability([[1e300, 0]], points, np.eye(3), SIZE),
    ):
        with pytest.raises(ShapeError, match=r"^[a-z_]+: [^\n]+; need [^\n]+$"):
            call()
    for singular in (np.zeros((3, 3)), np.diag([1.0, 0, 1]), np.array([[1, 0, 0], [0, 1, 0], [2, 0, -639.0]])):
        with pytest.raises(DegenerateConfiguration, match="H_dst_src"):
            repeatability(points, points, singular, SIZE)
