# SPDX-License-Identifier: Apache-2.0
"""Prints that are found by their outlines, and other things with outlines that are not taken for them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from imgu_ros.config.components import DevelopmentParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.detect.outlines import OutlineSearch
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import develop_frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

WIDTH, HEIGHT = 640, 480
DETECTING = parameters_from({"tracking.enabled": False, "raw.transfer": "srgb"})


def tiles(seed: int) -> np.ndarray:
    """A board of equal tiles, one of them dark: keypoints tell hardly where one is."""
    rng = np.random.default_rng(seed)
    tile = np.full((60, 60), 215, np.uint8)
    cv2.fillConvexPoly(tile, rng.integers(8, 52, (4, 2)).astype(np.int32)[[0, 1, 3]], 60, cv2.LINE_AA)
    board = np.tile(tile, (6, 6))
    row, column = rng.integers(0, 3, 2) * 60
    board[row : row + 60, column : column + 60] = 40
    return board


def seen(picture: np.ndarray, corners: np.ndarray, ground: int = 90, seed: int = 0) -> Frame:
    """A print on an even ground, noise over all."""
    height, width = picture.shape
    outline = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32) - 0.5
    H = cv2.getPerspectiveTransform(outline, corners.astype(np.float32))
    small = cv2.warpPerspective(picture, H, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
    inside = cv2.warpPerspective(np.full_like(picture, 255), H, (WIDTH, HEIGHT), flags=cv2.INTER_AREA) / 255
    image = ground * (1 - inside) + small + np.random.default_rng(seed).normal(0, 2, (HEIGHT, WIDTH))
    pixels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return Frame(RawImage(pixels, PixelLayout(ColorModel.LUMA)), 1, "camera", None)


def places(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    angle, size = rng.uniform(0, 2 * np.pi), rng.uniform(150, 210)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2 + rng.uniform(-14, 14, (4, 2))
    c, s = np.cos(angle), np.sin(angle)
    return square @ np.array([[c, s], [-s, c]]) + rng.uniform((190, 190), (450, 290))


def localizer(*pictures: np.ndarray) -> Localizer:
    images = [TargetImage(f"target_{index}", picture, 0.2) for index, picture in enumerate(pictures)]
    return Localizer(DETECTING, prepare_references(images, DETECTING))


@pytest.mark.parametrize("ground", [20, 120])
def test_a_board_of_equal_tiles_is_found_where_it_is(ground: int) -> None:
    found = 0
    for seed in range(8):
        picture, corners = tiles(seed), places(seed)
        result = localizer(picture).process(seen(picture, corners, ground, seed)).first
        if result.outline is not None:
            assert np.abs(result.outline - corners).max() < 1.0, seed
            found += 1
    assert found >= 6


def test_another_print_of_that_outline_is_not_taken_for_it() -> None:
    for seed in range(6):
        known, other = tiles(seed), cv2.resize(procedural_texture(360, 360, seed)[..., 0], (360, 360))
        for picture in (other, tiles(seed + 50), np.full((360, 360), 200, np.uint8)):
            result = localizer(known).process(seen(picture, places(seed), 30, seed)).first
            assert result.homography is None


def test_of_many_targets_the_likeliest_are_compared() -> None:
    pictures = [tiles(seed) for seed in range(9)]
    chain = localizer(*pictures)
    corners = places(3)
    frame = seen(pictures[4], corners, 30)
    context = FrameContext(frame, develop_frame(frame, DevelopmentParameters.of(DETECTING)), lambda *_: None)  # type: ignore[arg-type, return-value]
    places_by_name = OutlineSearch(chain.references).places(context, chain.references)
    assert 1 <= len(places_by_name) <= 3 and "target_4" in places_by_name
    at = places_by_name["target_4"][0] @ np.array([-0.5, -0.5, 1])
    assert np.abs(at[:2] / at[2] - corners[0]).max() < 4


def test_an_image_too_small_to_be_halved_has_none() -> None:
    frame = Frame(RawImage(np.zeros((1, 5), np.uint8), PixelLayout(ColorModel.LUMA)), 1, "camera", None)
    context = FrameContext(frame, develop_frame(frame, DevelopmentParameters.of(Parameters())), lambda *_: None)  # type: ignore[arg-type, return-value]
    references = localizer(tiles(1)).references
    assert OutlineSearch(references).places(context, references) == {}
