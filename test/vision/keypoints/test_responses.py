from __future__ import annotations

import math

import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.keypoints.fast import detect_fast
from imgu_ros.vision.keypoints.harris import detect_harris, harris_response

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


def fast_scores(image):
    """Largest threshold at which 9 contiguous ring pixels are all brighter or all darker; 0 on the border."""
    height, width = image.shape
    values = image.astype(int)
    out = np.zeros((height, width), int)
    for y in range(3, height - 3):
        for x in range(3, width - 3):
            ring = [values[y + dy, x + dx] - values[y, x] for dx, dy in RING]
            arcs = [[ring[(s + n) % 16] for n in range(9)] for s in range(16)]
            out[y, x] = max(0, max(max(min(arc), min(-v for v in arc)) for arc in arcs) - 1)
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


def test_fast_by_the_definition():
    image = np.random.default_rng(2).integers(0, 256, (40, 44)).astype(np.uint8)
    image[20:] //= 4
    scores = fast_scores(image)
    expected = {
        (x, y): scores[y, x]
        for y in range(3, 37)
        for x in range(3, 41)
        if scores[y, x] >= 10
        and all(scores[y, x] > scores[y + dy, x + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dx, dy) != (0, 0))
    }
    assert len(expected) > 20
    found = detect_fast(image, 10_000)
    got = {(int(x), int(y)): int(r) for (x, y), r in zip(found.xy, found.response, strict=True)}
    assert got == expected


def test_harris_refuses_what_it_cannot_read():
    for image in (np.zeros((9, 9)), np.zeros((9, 9), np.uint16), np.full((9, 9), np.nan, np.float32), [[1]]):
        with pytest.raises(ShapeError):
            harris_response(image)
