# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.keypoints.fast import detect_fast
from imgu_ros.vision.keypoints.harris import detect_harris, harris_response
from imgu_ros.vision.keypoints.moravec import moravec_response
from imgu_ros.vision.keypoints.peaks import find_peaks

RING = [
    (0, -3), (1, -3), (2, -2), (3, -1), (3, 0), (3, 1), (2, 2), (1, 3),
    (0, 3), (-1, 3), (-2, 2), (-3, 1), (-3, 0), (-3, -1), (-2, -2), (-1, -3),
]  # fmt: skip


def harris_by_definition(image, sigma, k):
    height, width = image.shape
    light = np.pad(image.astype(float) / 255, 1, mode="reflect")
    gx, gy = np.zeros((height, width)), np.zeros((height, width))
    for dy, weight in ((-1, 1), (0, 2), (1, 1)):
        for y in range(height):
            for x in range(width):
                gx[y, x] += weight * (light[y + 1 + dy, x + 2] - light[y + 1 + dy, x]) / 8
                gy[y, x] += weight * (light[y + 2, x + 1 + dy] - light[y, x + 1 + dy]) / 8
    reach = 12
    window = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * sigma**2))
    window = np.outer(window, window) / window.sum() ** 2

    def averaged(product, y, x):
        return (window * product[y - reach : y + reach + 1, x - reach : x + reach + 1]).sum()

    out = np.full((height, width), np.nan)
    for y in range(reach, height - reach):
        for x in range(reach, width - reach):
            moments = np.array(
                [[averaged(gx * gx, y, x), averaged(gx * gy, y, x)], [averaged(gx * gy, y, x), averaged(gy * gy, y, x)]]
            )
            out[y, x] = np.linalg.det(moments) - k * np.trace(moments) ** 2
    return out


def fast_scores(image, arc):
    """Largest threshold at which so many contiguous ring pixels are all brighter or all darker; 0 on the border."""
    height, width = image.shape
    values = image.astype(int)
    out = np.zeros((height, width), int)
    for y in range(3, height - 3):
        for x in range(3, width - 3):
            ring = [values[y + dy, x + dx] - values[y, x] for dx, dy in RING]
            arcs = [[ring[(s + n) % 16] for n in range(arc)] for s in range(16)]
            out[y, x] = max(0, max(max(min(a), min(-v for v in a)) for a in arcs) - 1)
    return out


def moravec_by_definition(image, window):
    """Least mean squared difference of the window and the eight windows beside it."""
    reach = window // 2
    light = np.pad(image.astype(float) / 255, reach + 1, mode="reflect")
    out = np.zeros(image.shape)
    for y, x in np.ndindex(*image.shape):
        variations = []
        for v, u in np.ndindex(3, 3):
            if (u, v) != (1, 1):
                here = light[y + 1 : y + 1 + window, x + 1 : x + 1 + window]
                there = light[y + v : y + v + window, x + u : x + u + window]
                variations.append(np.mean((here - there) ** 2))
        out[y, x] = min(variations)
    return out


@pytest.mark.parametrize(("sigma", "k"), [(1.5, 0.04), (1.0, 0.06)])
def test_harris_response_by_the_formula(sigma, k):
    image = np.random.default_rng(0).integers(0, 256, (32, 34), np.uint8)
    expected = harris_by_definition(image, sigma, k)
    inner = np.isfinite(expected)
    assert inner.sum() > 60
    # 8-bit pictures are convolved with a window that ends at 3 or 4 sigma
    np.testing.assert_allclose(
        harris_response(image, sigma, k)[inner], expected[inner], atol=0.02 * np.abs(expected[inner]).max()
    )


def test_harris_response_does_not_depend_on_the_data_type():
    image = np.random.default_rng(1).integers(0, 256, (30, 40), np.uint8)
    scaled = image.astype(np.float32) / np.float32(255)
    np.testing.assert_allclose(harris_response(image), harris_response(scaled), atol=1e-7)


def test_harris_tells_corners_from_edges_and_planes():
    image = np.zeros((60, 60), np.uint8)
    image[30:, 30:] = 200
    response = harris_response(image)
    assert response[30, 30] > 0 and response[50, 30] < 0 and response[30, 50] < 0
    assert not response[:20, :20].any()
    found = detect_harris(image, 10)
    assert len(found.xy) == 1
    np.testing.assert_allclose(found.xy[0], [30, 30], atol=1.5)
    assert found.angle[0] == pytest.approx(math.pi / 4, abs=1e-6)


def test_harris_corners_are_sub_pixel():
    # The crossing of a chessboard's four fields lies between pixels: at 30.5, by symmetry exactly.
    image = np.full((62, 62), 20, np.uint8)
    image[31:, 31:] = image[:31, :31] = 220
    found = detect_harris(image, 10)
    np.testing.assert_allclose(found.xy[0], [30.5, 30.5], atol=0.05)


@pytest.mark.parametrize("arc", [9, 10, 11, 12])
def test_fast_by_the_definition(arc):
    image = np.random.default_rng(2).integers(0, 256, (40, 44)).astype(np.uint8)
    image[20:] //= 4
    image[3:9, 3:9] = image[30:37, 30:41] = 128
    image[6, 6] = image[33, 34] = 255
    scores = fast_scores(image, arc)
    scores[scores < 10] = 0
    expected = {
        (x, y): scores[y, x]
        for y in range(3, 37)
        for x in range(3, 41)
        if scores[y, x] >= 10
        and all(scores[y, x] > scores[y + dy, x + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dx, dy) != (0, 0))
    }
    assert len(expected) > (20 if arc == 9 else 5)
    found = detect_fast(image, 10_000, arc)
    got = {(int(x), int(y)): int(r) for (x, y), r in zip(found.xy, found.response, strict=True)}
    assert got == expected


@given(st.integers(0, 2**32), st.sampled_from([10, 11, 12]), st.integers(1, 60))
@settings(max_examples=15)
def test_fast_of_longer_arcs_at_any_threshold(seed, arc, threshold):
    rng = np.random.default_rng(seed)
    image = np.kron(rng.integers(0, 256, (4, 5)), np.ones((5, 5))) + rng.integers(0, 30, (20, 25))
    image = image.clip(0, 255).astype(np.uint8)
    scores = fast_scores(image, arc)
    scores[scores < threshold] = 0
    around = np.pad(scores, 1)
    best = np.max([around[1 + v : 21 + v, 1 + u : 26 + u] for v, u in np.argwhere(np.ones((3, 3))) - 1 if u or v], 0)
    found = detect_fast(image, 10_000, arc, threshold)
    got = {(int(y), int(x)) for x, y in found.xy}
    assert got == {(int(y), int(x)) for y, x in np.argwhere(scores > best)}


@pytest.mark.parametrize("threshold", [0, 255, -1])
def test_fast_refuses_such_thresholds(threshold):
    with pytest.raises(ShapeError, match=r"^threshold: [^\n]+need 1 to 254$"):
        detect_fast(np.zeros((20, 20), np.uint8), 5, threshold=threshold)


@pytest.mark.parametrize("window", [1, 3, 5, 9])
@pytest.mark.parametrize("shape", [(21, 18), (5, 30)])
def test_moravec_by_the_definition(window, shape):
    image = np.random.default_rng(4).integers(0, 256, shape, np.uint8)
    np.testing.assert_allclose(moravec_response(image, window), moravec_by_definition(image, window), atol=2e-6)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_moravec_turns_with_the_picture(turns):
    image = np.random.default_rng(6).integers(0, 256, (31, 40), np.uint8)
    np.testing.assert_allclose(
        moravec_response(np.rot90(image, turns)), np.rot90(moravec_response(image), turns), atol=1e-6
    )


def test_moravec_of_floats_and_of_edges():
    image = np.random.default_rng(5).integers(0, 256, (30, 40), np.uint8)
    scaled = image.astype(np.float32) / np.float32(255)
    np.testing.assert_allclose(moravec_response(image), moravec_response(scaled), atol=1e-6)
    corner = np.zeros((60, 60), np.uint8)
    corner[30:, 30:] = 200
    response = moravec_response(corner)
    assert response[30, 30] > 0.01
    assert not response[50, 30] and not response[30, 50] and not response[:20, :20].any()


@pytest.mark.parametrize("function", [moravec_response, harris_response])
def test_responses_refuse_what_leaves_the_range(function):
    for image in (np.zeros((9, 9), complex), np.zeros((9, 9), np.uint16), np.full((9, 9), 1e7, np.float32), [[1]]):
        with pytest.raises(ShapeError, match=r"^image: [^\n]+need[^\n]+$"):
            function(image)


def test_parameters_of_responses_are_checked():
    image = np.zeros((9, 9), np.uint8)
    for call in (
        lambda: moravec_response(image, 4),
        lambda: moravec_response(image, 101),
        lambda: harris_response(image, 0.0),
        lambda: harris_response(image, math.nan),
        lambda: harris_response(image, 1.5, 0.3),
        lambda: find_peaks(image.astype(np.float32), 1.5, 1),
        lambda: find_peaks(image.astype(np.float32), 0.5, 0),
    ):
        with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
            call()


@given(st.floats(-0.45, 0.45), st.floats(-0.45, 0.45), st.floats(1e-20, 1e20), st.floats(-0.8, 0.8))
def test_paraboloids_have_their_vertex_found(u, v, height, slant):
    y, x = np.mgrid[:11, :13]
    dx, dy = x - 6 - u, y - 5 - v
    response = (height * (100 - dx**2 - 1.3 * dy**2 - slant * dx * dy)).astype(np.float32)
    peaks = find_peaks(response, 0.1, 1)
    assert len(peaks.xy) == 1
    np.testing.assert_allclose(peaks.xy[0], [6 + u, 5 + v], atol=2e-3)


def test_harris_refuses_what_it_cannot_read():
    for image in (np.zeros((9, 9), complex), np.zeros((9, 9), np.uint16), np.full((9, 9), np.nan, np.float32), [[1]]):
        with pytest.raises(ShapeError):
            harris_response(image)
