# SPDX-License-Identifier: Apache-2.0
"""Alignment of patches against pictures that were moved by known amounts."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.matching.patch_atlas import PatchAtlas
from imgu_ros.vision.matching.patch_bank import LocalDistortion, PatchBank
from imgu_ros.vision.projective.transform import transform

SIDE = 160
GRID = np.array([[x, y] for y in range(30, 131, 20) for x in range(30, 131, 20)], np.float64)


def waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth picture that is known between its pixels, about 100 +- 60."""
    return (
        100
        + 25 * np.sin(0.31 * x + 0.12 * y)
        + 20 * np.cos(0.07 * x - 0.27 * y + 1)
        + 15 * np.sin(0.19 * x + 0.23 * y + 2)
    )


def picture(H: np.ndarray, gain: float = 1.0, offset: float = 0.0) -> np.ndarray:
    """What a camera sees at whose pixels H maps those of `waves`, float32."""
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    at = transform(np.linalg.inv(H), np.column_stack((x.ravel(), y.ravel())))
    return ((gain * waves(*at.T) + offset).reshape(SIDE, SIDE) / 255).astype(np.float32)


@pytest.fixture(scope="module")
def bank() -> PatchBank:
    return PatchBank(picture(np.eye(3)) * 255, GRID, 11)


EVERY = np.arange(len(GRID))


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.2), (-0.8, 0.5)])
@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.4, 30.0), (1.6, -40.0)])
def test_displacements_are_those_of_the_picture_whatever_the_light(
    bank: PatchBank, shift: tuple[float, float], gain: float, offset: float
) -> None:
    moved = np.array([[1, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1]])
    patches = bank.select(EVERY)
    seen = patches.displacements(patches.sampled(picture(moved, gain, offset) * 255, np.eye(3)))
    # The picture at x shows x - shift: what is sought is there.
    assert_allclose(seen.xy, np.tile([-shift[0], -shift[1]], (len(GRID), 1)), atol=0.06 * np.hypot(*shift) + 1e-3)
    assert seen.similarity.min() > (0.8 if any(shift) else 0.999)


def test_samples_follow_the_homography(bank: PatchBank) -> None:
    H = np.array([[0.8, -0.35, 40.0], [0.3, 0.85, -10.0], [4e-4, -3e-4, 1.0]])
    patches = bank.select(EVERY)
    seen = patches.displacements(patches.sampled(picture(H) * 255, H))
    assert np.abs(seen.xy).max() < 0.05
    assert_allclose(patches.sampled(picture(H), 3 * H), patches.sampled(picture(H), H), atol=1e-5)


def test_a_negative_is_unlike_and_noise_is_little_alike(bank: PatchBank) -> None:
    patches = bank.select(EVERY)
    negative = patches.displacements(patches.sampled(255 - picture(np.eye(3)) * 255, np.eye(3)))
    assert negative.similarity.max() < -0.97
    noise = np.random.default_rng(3).normal(100, 20, (SIDE, SIDE)).astype(np.float32)
    assert np.abs(patches.displacements(patches.sampled(noise, np.eye(3))).similarity).mean() < 0.3


def test_flat_and_straight_patches_cannot_be_compared(bank: PatchBank) -> None:
    stripes = np.tile((np.arange(SIDE) // 8 % 2 * 100).astype(np.uint8), (SIDE, 1))
    for image in (np.full((SIDE, SIDE), 90, np.uint8), stripes):
        patches = PatchBank(image, GRID, 11).select(EVERY)
        seen = patches.displacements(patches.sampled(image, np.eye(3)))
        assert (seen.similarity == 0).all() and (seen.xy == 0).all()
    patches = bank.select(EVERY)
    seen = patches.displacements(patches.sampled(np.full((SIDE, SIDE), 90, np.uint8), np.eye(3)))
    assert (seen.similarity == 0).all()


def test_the_first_patches_alone_and_a_selection_give_the_same(bank: PatchBank) -> None:
    seen_in = picture(np.array([[1, 0, 0.4], [0, 1, 0.1], [0, 0, 1]])) * 255
    full = bank.select(EVERY)
    everything = full.displacements(full.sampled(seen_in, np.eye(3)))
    first = full.displacements(full.sampled(seen_in, np.eye(3), first=7))
    assert_allclose(first.xy, everything.xy[:7], atol=1e-6)
    some = bank.select(np.array([3, 20, 11]))
    assert bank.select(np.array([3, 20, 11])) is some
    few = some.displacements(some.sampled(seen_in, np.eye(3)))
    assert_allclose(few.xy, everything.xy[[3, 20, 11]], atol=1e-6)
    assert_allclose(some.overlap, np.eye(3))


def test_distortion_moves_the_samples(bank: PatchBank) -> None:
    """A lens that enlarges by 1.1 about (80, 80), told point by point."""
    zoom = np.array([[1.1, 0, -8.0], [0, 1.1, -8.0], [0, 0, 1]])
    patches = bank.select(EVERY)
    distortion = LocalDistortion(GRID, transform(zoom, GRID), np.tile(1.1 * np.eye(2), (len(GRID), 1, 1)))
    distorted = patches.sampled(picture(zoom), np.eye(3), distortion)
    assert_allclose(distorted, patches.sampled(picture(zoom), zoom), atol=2e-3)


def test_an_atlas_of_squares_gives_the_same_samples_as_the_picture(bank: PatchBank) -> None:
    H = np.array([[0.95, -0.1, 8.0], [0.1, 0.95, -6.0], [0, 0, 1]])
    seen_in = np.rint(picture(H) * 255).astype(np.uint8)
    atlas = PatchAtlas(np.clip(np.rint(transform(H, GRID)) - 12, 0, SIDE - 24), 24)
    cut = atlas.cut(seen_in)
    assert cut.shape == (24 * len(GRID), 24)
    x, y = atlas.origins[5]
    assert np.array_equal(cut[5 * 24 : 6 * 24], seen_in[y : y + 24, x : x + 24])
    patches = bank.select(EVERY)
    assert np.abs(patches.sampled(cut, H, atlas=atlas) - patches.sampled(seen_in, H).astype(np.float64)).max() <= 1


def test_patches_at_the_rim_are_left_out() -> None:
    image = np.zeros((40, 60), np.uint8)
    corners = np.array([[5.0, 20.0], [6.0, 6.0], [53.0, 33.0], [54.0, 20.0], [30.2, 19.7]])
    assert PatchBank(image, corners, 11).centres.tolist() == [[6, 6], [53, 33], [30, 20]]


def test_what_makes_no_sense_is_refused(bank: PatchBank) -> None:
    with pytest.raises(ShapeError, match="odd"):
        PatchBank(np.zeros((40, 40), np.uint8), GRID, 10)
    patches = bank.select(EVERY)
    with pytest.raises(DegenerateConfiguration, match="behind the camera"):
        patches.sampled(picture(np.eye(3)), np.array([[1, 0, 0], [0, 1, 0], [0.02, 0, -1.0]]))
    with pytest.raises(ShapeError, match="samples"):
        patches.displacements(np.zeros((3, 9), np.uint8))
    with pytest.raises(ShapeError, match="whole px"):
        PatchAtlas([[0.5, 2.0]], 8)
    with pytest.raises(ShapeError, match="holds every square"):
        PatchAtlas([[30, 30]], 8).cut(np.zeros((32, 60), np.uint8))
    with pytest.raises(ShapeError, match="at most"):
        PatchAtlas(np.zeros((5000, 2)), 8)
    assert bank.select(np.zeros(0, np.intp)).sampled(cv2.blur(picture(np.eye(3)), (3, 3)), np.eye(3)).shape == (0, 121)
