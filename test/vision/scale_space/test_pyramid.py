# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.scale_space.pyramid import CAMERA_SIGMA_PX, Level, build_pyramid


def blob(shape, center, sigma):
    """A Gaussian integrated over each pixel's area, float32 in [0, 1]."""
    edges = [
        np.array([math.erf((n - 0.5 - c) / (sigma * math.sqrt(2))) for n in range(size + 1)])
        for size, c in zip(shape, center[::-1], strict=True)
    ]
    picture = np.diff(edges[0])[:, None] * np.diff(edges[1])
    return (picture / picture.max()).astype(np.float32)


def moments(picture):
    """Centroid (x, y) and variance along x and y."""
    weight = picture.astype(float)
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    cx, cy = (x * weight).sum() / weight.sum(), (y * weight).sum() / weight.sum()
    variance = ((x - cx) ** 2 * weight).sum() / weight.sum(), ((y - cy) ** 2 * weight).sum() / weight.sum()
    return np.array([[cx, cy]]), np.array(variance)


@pytest.mark.parametrize("kind", ["coarse", "fine"])
@pytest.mark.parametrize(("shape", "max_side"), [((256, 320), None), ((251, 317), None), ((503, 611), 400)])
def test_blobs_map_back_to_full_resolution(kind, shape, max_side):
    center = (shape[1] * 0.47 + 0.3, shape[0] * 0.54 - 0.2)
    pyramid = build_pyramid(blob(shape, center, 12.0), kind, 10, 3, max_side, min_side_px=16)
    assert len(pyramid.levels) >= 4
    for level in pyramid.levels:
        found, _ = moments(level.image)
        np.testing.assert_allclose(level.to_full(found)[0], center, atol=0.06)


@pytest.mark.parametrize(
    ("kind", "per_octave", "shape", "tolerance"),
    [
        ("coarse", 3, (512, 512), 0.01),
        ("coarse", 3, (509, 515), 0.15),
        ("fine", 3, (512, 512), 0.08),
        ("fine", 3, (509, 515), 0.15),
        ("fine", 2, (512, 512), 0.1),
        ("fine", 5, (512, 512), 0.2),
    ],
)
def test_blur_of_every_level_is_as_designed(kind, per_octave, shape, tolerance):
    # In its own pixels every level is as blurred as a camera's image is taken to be. What interpolation between
    # pixels adds depends on the phase, and is designed for on average: hence the tolerance where sizes are odd.
    sigma = 14.0
    pyramid = build_pyramid(blob(shape, (255.3, 256.1), sigma), kind, 12, per_octave, min_side_px=32)
    for level in pyramid.levels[1:]:
        _, variance = moments(level.image)
        # pixels integrate over their area: 1/12 px^2 in the picture above, present in every level
        added = variance * level.step**2 - sigma**2 - 1 / 12
        own = np.sqrt(added / level.step**2 + CAMERA_SIGMA_PX**2 / level.step**2)
        np.testing.assert_allclose(own, CAMERA_SIGMA_PX, rtol=tolerance)


@pytest.mark.parametrize("kernel", ["sampled", "discrete", "recursive"])
@pytest.mark.parametrize("kind", ["coarse", "fine"])
def test_scale_of_every_level_on_blobs_with_every_kernel(kind, kernel):
    center, sigma = (255.3, 256.1), 14.0
    pyramid = build_pyramid(blob((512, 512), center, sigma), kind, 12, 3, kernel=kernel)
    assert len(pyramid.levels) >= 5
    for level in pyramid.levels[1:]:
        found, variance = moments(level.image)
        np.testing.assert_allclose(level.to_full(found)[0], center, atol=0.05)
        added = variance * level.step**2 - sigma**2 - 1 / 12
        own = np.sqrt(added / level.step**2 + CAMERA_SIGMA_PX**2 / level.step**2)
        np.testing.assert_allclose(own, CAMERA_SIGMA_PX, rtol=0.08)


@given(st.integers(1, 200), st.integers(1, 200), st.sampled_from(["coarse", "fine", "laplacian"]), st.integers(1, 12))
def test_geometry_of_any_size(width, height, kind, levels):
    image = np.zeros((height, width), np.uint8)
    pyramid = build_pyramid(image, kind, levels, 3, min_side_px=8)
    assert 1 <= len(pyramid.levels) <= levels
    assert pyramid.levels[0].image.shape == image.shape
    corners = np.array([[-0.5, -0.5], [width - 0.5, height - 0.5], [0, 0]])
    last = 0.0
    for index, level in enumerate(pyramid.levels):
        h, w = level.image.shape
        assert index == 0 or min(h, w) >= 8
        assert level.scale > last or index == 0
        last = level.scale
        assert (level.step >= 1).all()
        np.testing.assert_allclose(level.from_full(corners)[:2], [[-0.5, -0.5], [w - 0.5, h - 0.5]], atol=1e-9)
        np.testing.assert_allclose(level.to_full(level.from_full(corners)), corners, atol=1e-9)
        assert level.scale == pytest.approx(math.sqrt(width / w * height / h))


def test_scales_are_powers():
    image = np.zeros((512, 640), np.uint8)
    coarse = build_pyramid(image, "coarse", 4)
    assert [level.image.shape for level in coarse.levels] == [(512, 640), (256, 320), (128, 160), (64, 80)]
    fine = build_pyramid(image, "fine", 9, 4)
    np.testing.assert_allclose([level.scale for level in fine.levels], 2 ** (np.arange(9) / 4), rtol=5e-3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_reduced_by_a_whole_number_before_level_0(dtype):
    image = np.random.default_rng(3).integers(0, 256, (60, 90)).astype(dtype)
    level = build_pyramid(image, "coarse", 1, max_side_px=31).levels[0]
    means = image.reshape(20, 3, 30, 3).astype(float).mean(axis=(1, 3))
    np.testing.assert_allclose(level.image, means, atol=0.51)
    np.testing.assert_array_equal(level.step, [3, 3])


def test_max_side_before_level_0():
    pyramid = build_pyramid(np.zeros((1080, 1920), np.uint8), "coarse", 3, max_side_px=960)
    assert pyramid.levels[0].image.shape == (540, 960)
    np.testing.assert_array_equal(pyramid.levels[0].step, [2, 2])
    assert build_pyramid(np.zeros((1080, 1921), np.uint8), max_side_px=960).levels[0].image.shape[1] <= 960


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, ">u2"])
@pytest.mark.parametrize("value", [0, 1, 200])
def test_constant_pictures_stay_constant(dtype, value):
    pyramid = build_pyramid(np.full((70, 90), value, dtype), "fine", min_side_px=8)
    assert len(pyramid.levels) > 5
    for level in pyramid.levels:
        assert level.image.dtype == np.dtype(dtype).newbyteorder("=")
        np.testing.assert_allclose(level.image, value, rtol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 100), (33, 1), (2, 3)])
@pytest.mark.parametrize("max_side", [None, 0, 1, 16])
def test_tiny_pictures(shape, max_side):
    for min_side in (0, 1, 32):
        pyramid = build_pyramid(np.full(shape, 9, np.uint8), "fine", 20, 3, max_side, min_side)
        assert all((level.image == 9).all() for level in pyramid.levels)


def test_read_only_view_as_input():
    wide = np.random.default_rng(0).integers(0, 256, (64, 100), np.uint8)
    view = wide[:, :64]
    view.flags.writeable = False
    for got, expected in zip(build_pyramid(view).levels, build_pyramid(view.copy()).levels, strict=True):
        np.testing.assert_array_equal(got.image, expected.image)


def test_level_is_a_value():
    level = Level(np.zeros((4, 4), np.uint8), np.array([2.0, 3.0]))
    np.testing.assert_array_equal(level.to_full(np.array([[0.0, 0.0], [1.0, 1.0]])), [[0.5, 1.0], [2.5, 4.0]])
    assert level.scale == pytest.approx(math.sqrt(6))
    with pytest.raises(AttributeError):
        level.step = np.ones(2)  # type: ignore[misc]


@pytest.mark.parametrize(
    "arguments",
    [
        {"levels": 0},
        {"scales_per_octave": 0, "kind": "fine"},
        {"kind": "laplace"},
        {"image": np.zeros((0, 5), np.uint8)},
        {"image": np.zeros((5, 5, 3), np.uint8)},
        {"image": np.zeros((5, 5), complex)},
        {"image": np.full((5, 5), np.inf, np.float32)},
    ],
)
def test_bad_input_is_refused(arguments):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        build_pyramid(**{"image": np.zeros((64, 64), np.uint8), **arguments})
