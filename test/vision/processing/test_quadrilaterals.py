# SPDX-License-Identifier: Apache-2.0
"""Quadrilaterals by their sides: drawn ones, with parts hidden, out of the image, or of another colour alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.processing import find_quadrilaterals

CORNERS = np.array([[70.0, 50.0], [240.0, 72.0], [222.0, 190.0], [58.0, 168.0]])


def drawn(corners: np.ndarray = CORNERS, dark: int = 60, bright: int = 180) -> np.ndarray:
    """A quadrilateral on a ground, its edges blurred by a pixel."""
    image = np.full((240, 320), dark, np.uint8)
    cv2.fillConvexPoly(image, np.rint(corners * 16).astype(np.int32), bright, cv2.LINE_AA, 4)
    return image


def nearest_px(found: np.ndarray, corners: np.ndarray) -> float:
    """Return the largest distance of the corners of the nearest of some quadrilaterals, whichever comes first."""
    away = [np.abs(np.roll(found, -k, axis=1) - corners).max(axis=(1, 2)) for k in range(4)]
    return float(np.min(away, initial=np.inf))


def test_a_drawn_one_is_the_first() -> None:
    found = find_quadrilaterals([drawn()])
    assert nearest_px(found[:1], CORNERS) < 1.5


@pytest.mark.parametrize("corner", range(4))
def test_a_corner_may_be_hidden(corner: int) -> None:
    image = drawn()
    x, y = np.rint(CORNERS[corner]).astype(int).tolist()
    cv2.circle(image, (x, y), 28, 110, -1, cv2.LINE_AA)
    assert nearest_px(find_quadrilaterals([image]), CORNERS) < 3


def test_a_corner_may_be_outside() -> None:
    corners = CORNERS + (90.0, 0.0)
    assert (corners[:, 0] > 320).sum() == 1
    assert nearest_px(find_quadrilaterals([drawn(corners)]), corners) < 3


def test_an_edge_may_be_in_any_channel() -> None:
    """On a ground that is brighter than it on the left, and of its brightness on the right, as a colour is there."""
    flat = np.full((240, 320), 120, np.uint8)
    ground = np.tile(np.where(np.arange(320) < 150, 60, 180).astype(np.uint8), (240, 1))
    brightness = np.where(drawn() > 120, 180, ground).astype(np.uint8)
    colour = np.where(drawn() > 120, 160, np.tile(np.where(np.arange(320) < 140, 160, 90), (240, 1))).astype(np.uint8)
    assert nearest_px(find_quadrilaterals([brightness, colour]), CORNERS) < 3
    for channel in (brightness, colour, flat):
        assert nearest_px(find_quadrilaterals([channel, flat]), CORNERS) > 3


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(-14, 14), min_size=8, max_size=8), st.integers(0, 3), st.booleans(), st.integers(0, 2**32 - 1)
)
def test_any_is_found_however_the_image_is_turned(moves: list[float], turns: int, dark: bool, seed: int) -> None:
    corners = CORNERS + np.reshape(moves, (4, 2))
    image = drawn(corners, *((180, 60) if dark else (60, 180)))
    noisy = np.clip(image + np.random.default_rng(seed).normal(0, 3, image.shape), 0, 255).astype(np.uint8)
    turned = np.ascontiguousarray(np.rot90(noisy, turns))
    expected = corners
    for k in range(turns):
        width = (320, 240)[k % 2]
        expected = np.column_stack((expected[:, 1], width - 1 - expected[:, 0]))
    found = find_quadrilaterals([turned])
    assert nearest_px(found, expected) < 2.5
    edges = np.roll(found, -1, axis=1) - found
    following = np.roll(edges, -1, axis=1)
    assert (edges[..., 0] * following[..., 1] - edges[..., 1] * following[..., 0] > 0).all()


def test_many_lines_are_bounded() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (480, 640)).astype(np.uint8)
    grid = np.zeros((480, 640), np.uint8)
    grid[::12], grid[:, ::12] = 255, 255
    for image in (noise, grid):
        found = find_quadrilaterals([image, image], 50)
        assert len(found) <= 50 and np.isfinite(found).all()


def test_a_plain_or_tiny_image_has_none() -> None:
    for shape in ((240, 320), (1, 1), (2, 300)):
        assert find_quadrilaterals([np.full(shape, 90, np.uint8)]).shape == (0, 4, 2)


def test_bad_input() -> None:
    image = drawn()
    with pytest.raises(ShapeError, match="channels: none; need images"):
        find_quadrilaterals([])
    with pytest.raises(ShapeError, match="of one size"):
        find_quadrilaterals([image, image[1:]])
    with pytest.raises(ShapeError, match="channels"):
        find_quadrilaterals([image.astype(np.float32)])
    with pytest.raises(ShapeError, match="most: 0; need at least 1"):
        find_quadrilaterals([image], 0)
