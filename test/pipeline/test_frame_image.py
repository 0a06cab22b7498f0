# SPDX-License-Identifier: Apache-2.0
"""Halved pictures and cut squares, against the raw values and the whole grey picture."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.errors import ShapeError
from imgu_ros.image.frame_image import FrameImage, develop
from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.matching.patch_atlas import PatchAtlas

#: Odd and even sides, top left and bottom right corner, and in between.
SHAPES = [(46, 62), (47, 61)]
SIDE = 12


def developed(pixels: Image, color: ColorModel, pattern: BayerPattern | None = None, **raw: object) -> FrameImage:
    method = raw.pop("method", "bilinear")
    layout = PixelLayout(color, pattern)
    return develop(RawImage(pixels, layout), RawParameters(**raw), DemosaicParameters(method))


def noise(shape: tuple[int, ...], dtype: type = np.uint8, most: int = 255) -> Image:
    return np.random.default_rng(5).integers(0, most, shape, dtype, endpoint=True)


def mean_of_blocks(values: Image, side: int) -> np.ndarray:
    height, width = values.shape[0] // side, values.shape[1] // side
    blocks = values[: height * side, : width * side].reshape(height, side, width, side)
    return blocks.astype(np.float64).mean(axis=(1, 3))


def origins(shape: tuple[int, int]) -> list[list[int]]:
    height, width = shape
    return [[0, 0], [4, 20], [(width - SIDE) // 2 * 2, (height - SIDE) // 2 * 2], [20, 10]]


def without_rim(squares: Image) -> Image:
    return squares.reshape(-1, SIDE, SIDE)[:, 1:-1, 1:-1]


def squares_of(grey: Image, at: list[list[int]]) -> Image:
    return np.stack([grey[y : y + SIDE, x : x + SIDE] for x, y in at])


def require_nearly_the_same(a: Image, b: Image) -> None:
    """OpenCV 4.6 rounds a mosaic's grey differently here and there in a row."""
    assert_allclose(a.astype(int), b.astype(int), atol=1)


@pytest.mark.parametrize("pattern", list(BayerPattern))
@pytest.mark.parametrize("shape", SHAPES)
def test_mosaic_halved_and_cut(pattern: BayerPattern, shape: tuple[int, int]) -> None:
    raw = noise(shape)
    frame = developed(raw, ColorModel.BAYER, pattern)
    pictures = frame
    squares = pictures.cut(PatchAtlas(origins(shape), SIDE))
    # The mean of the four of a quad, rounded; then of those.
    assert_allclose(pictures.halved(1), mean_of_blocks(raw, 2), atol=0.51)
    assert_allclose(pictures.halved(2), mean_of_blocks(raw, 4), atol=1.01)
    assert pictures.halved(2).shape == (shape[0] // 4, shape[1] // 4)
    require_nearly_the_same(without_rim(squares), squares_of(frame.grey, origins(shape))[:, 1:-1, 1:-1])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    "raw",
    [
        {"white_level": 4000.0, "black_level": 200.0},
        {"significant_bits": 12},
        {"significant_bits": 12, "black_level": 64.0},
    ],
)
def test_deep_mosaic_of_known_levels(order: str, raw: dict[str, float]) -> None:
    values = noise((46, 62), np.uint16, 4095)
    frame = developed(values.astype(f"{order}u2"), ColorModel.BAYER, BayerPattern.GBRG, **raw)
    pictures = frame
    squares = pictures.cut(PatchAtlas(origins((46, 62)), SIDE))
    black, white = raw.get("black_level", 0.0), raw.get("white_level", 4095.0)
    exact = np.clip((mean_of_blocks(values, 2) - black) / (white - black) * 255, 0, 255)
    assert_allclose(pictures.halved(1), exact, atol=0.6)
    require_nearly_the_same(without_rim(squares), squares_of(frame.grey, origins((46, 62)))[:, 1:-1, 1:-1])


@pytest.mark.parametrize("shape", SHAPES)
def test_mono_is_the_same_to_the_last_pixel(shape: tuple[int, int]) -> None:
    grey = noise(shape)
    pictures = developed(grey, ColorModel.MONO)
    odd = [[1, 3], [shape[1] - SIDE, shape[0] - SIDE]]
    assert_array_equal(pictures.cut(PatchAtlas(odd, SIDE)).reshape(-1, SIDE, SIDE), squares_of(grey, odd))
    assert_allclose(pictures.halved(1), mean_of_blocks(grey, 2), atol=0.51)
    deep = noise(shape, np.uint16, 1023)
    frame = developed(deep, ColorModel.MONO, significant_bits=10)
    squares = frame.cut(PatchAtlas(odd, SIDE))
    assert_array_equal(squares.reshape(-1, SIDE, SIDE), squares_of(frame.grey, odd))


@pytest.mark.parametrize(
    ("pixels", "color", "pattern", "raw"),
    [
        (noise((46, 62, 3)), ColorModel.RGB, None, {}),
        (noise((46, 62, 3)), ColorModel.BGR, None, {}),
        (noise((46, 62), np.uint16, 9000), ColorModel.MONO, None, {}),
        (noise((46, 62), np.uint16, 9000), ColorModel.BAYER, BayerPattern.RGGB, {}),
        (noise((46, 62)), ColorModel.BAYER, BayerPattern.RGGB, {"gains": (1.9, 1.0, 1.4)}),
        (noise((46, 62)), ColorModel.BAYER, BayerPattern.RGGB, {"grey_weights": (0.0, 1.0, 0.0)}),
        (noise((46, 62)), ColorModel.BAYER, BayerPattern.RGGB, {"method": "malvar"}),
        (noise((46, 62, 4)), ColorModel.BANDS, None, {}),
    ],
)
def test_what_needs_the_whole_frame_is_of_the_whole_grey_picture(
    pixels: Image, color: ColorModel, pattern: BayerPattern | None, raw: dict[str, object]
) -> None:
    first = developed(pixels, color, pattern, **raw)
    at = origins((46, 62))
    squares, half = first.cut(PatchAtlas(at, SIDE)), first.halved(1)
    grey = developed(pixels, color, pattern, **raw).grey
    assert_array_equal(squares.reshape(-1, SIDE, SIDE), squares_of(grey, at))
    assert_allclose(half, mean_of_blocks(grey, 2), atol=0.51)
    assert_array_equal(first.halved(0), grey)


def test_a_flat_grey_mosaic_is_as_bright_at_every_size() -> None:
    frame = developed(np.full((64, 80), 77, np.uint8), ColorModel.BAYER, BayerPattern.BGGR)
    pictures = frame
    assert pictures.shape == (64, 80)
    for times in range(pictures.most_halvings, -1, -1):
        require_nearly_the_same(pictures.halved(times), np.array(77))
    require_nearly_the_same(pictures.cut(PatchAtlas([[0, 0], [68, 52]], SIDE)), np.array(77))


def test_pictures_are_made_once() -> None:
    pictures = developed(noise((46, 62)), ColorModel.BAYER, BayerPattern.RGGB)
    assert pictures.halved(2) is pictures.halved(2)
    assert pictures.halved(1) is pictures.halved(1)
    assert pictures.halved(0) is pictures.halved(0)


def test_how_often_a_picture_can_be_halved() -> None:
    for shape in ((8, 200), (9, 17), (64, 64), (1, 1), (47, 61)):
        pictures = developed(np.zeros(shape, np.uint8), ColorModel.MONO)
        most = pictures.most_halvings
        assert min(shape) >> most >= min(8, min(shape)) and (most == 0 or min(shape) >> most < 16)
        with pytest.raises(ShapeError, match=r"^halved: 9 times"):
            pictures.halved(9)
        with pytest.raises(ShapeError, match=r"^halved: -1 times"):
            pictures.halved(-1)
    with pytest.raises(ShapeError, match="halved: 1 times"):
        developed(np.zeros((1, 9), np.uint8), ColorModel.MONO).halved(1)


def test_squares_that_do_not_fit_are_refused() -> None:
    pictures = developed(noise((46, 62)), ColorModel.BAYER, BayerPattern.RGGB)
    for sheet in (PatchAtlas([[1, 2]], SIDE), PatchAtlas([[2, 3]], SIDE), PatchAtlas([[2, 2]], 11)):
        with pytest.raises(ShapeError, match="odd pixels"):
            pictures.cut(sheet)
    with pytest.raises(ShapeError, match="holds every square"):
        pictures.cut(PatchAtlas([[52, 0]], SIDE))


def test_what_is_wrong_with_a_frame_is_said_when_it_is_developed() -> None:
    """Not when the first picture is made of it."""
    with pytest.raises(ShapeError, match="2x2"):
        developed(np.zeros((5, 1), np.uint8), ColorModel.BAYER, BayerPattern.RGGB)
    with pytest.raises(ShapeError, match="black_level"):
        developed(noise((46, 62)), ColorModel.BAYER, BayerPattern.RGGB, black_level=255.0)
    with pytest.raises(ShapeError, match=r"raw\.bands"):
        developed(noise((46, 62, 4)), ColorModel.BANDS, bands=(4,))
