# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic, site_mask
from imgu_ros.vision.formation.demosaic import DemosaicMethod, demosaic, grey_from_mosaic
from imgu_ros.vision.formation.demosaicking import strips

PATTERNS = list(BayerPattern)
METHODS = list(DemosaicMethod)
LUMA = np.array([0.299, 0.587, 0.114])
#: Pixels that the farthest site that a result depends on lies away: that near the border mirror images matter.
REACH = {"bilinear": 1, "edge_aware": 2, "malvar": 2, "hamilton_adams": 4, "menon": 11, "residual": 30}


def site_color(pattern: BayerPattern, row: int, column: int) -> str:
    return pattern.value[2 * (row % 2) + column % 2]


def mirrored(raw, reach: int = 2):
    return np.pad(raw.astype(float), reach, mode="reflect")


def bilinear_by_definition(raw, pattern):
    """Mean of the nearest sites of each colour, in double precision; the mosaic is mirrored at its borders."""
    height, width = raw.shape
    extended = mirrored(raw)
    out = np.empty((height, width, 3))
    for row in range(height):
        for column in range(width):
            for index, color in enumerate("rgb"):
                if site_color(pattern, row, column) == color:
                    out[row, column, index] = raw[row, column]
                    continue
                near = [
                    (dy * dy + dx * dx, extended[row + 2 + dy, column + 2 + dx])
                    for dy in (-1, 0, 1)
                    for dx in (-1, 0, 1)
                    if site_color(pattern, row + dy, column + dx) == color
                ]
                closest = min(distance for distance, _ in near)
                out[row, column, index] = np.mean([value for distance, value in near if distance == closest])
    return out


def malvar_by_definition(raw, pattern):
    """Bilinear plus the gradient correction of Malvar, He & Cutler 2004, equations 2, 4 and 5, site by site."""
    height, width = raw.shape
    e = mirrored(raw)
    out = bilinear_by_definition(raw, pattern)
    for row in range(height):
        for column in range(width):
            y, x = row + 2, column + 2
            here = site_color(pattern, row, column)
            across = [e[y - 2, x], e[y + 2, x], e[y, x - 2], e[y, x + 2]]
            diagonal = [e[y - 1, x - 1], e[y - 1, x + 1], e[y + 1, x - 1], e[y + 1, x + 1]]
            for index, color in enumerate("rgb"):
                if color == here:
                    continue
                if here == "g":
                    in_row = site_color(pattern, row, column + 1) == color
                    along = [e[y, x - 2], e[y, x + 2]] if in_row else [e[y - 2, x], e[y + 2, x]]
                    beside = [e[y - 2, x], e[y + 2, x]] if in_row else [e[y, x - 2], e[y, x + 2]]
                    laplacian = e[y, x] - (sum(along) + sum(diagonal) - sum(beside) / 2) / 5
                    out[row, column, index] += 5 / 8 * laplacian
                else:
                    gain = 1 / 2 if color == "g" else 3 / 4
                    out[row, column, index] += gain * (e[y, x] - np.mean(across))
    return np.clip(out, 0, np.iinfo(raw.dtype).max)


def random_raw(shape, dtype, seed=0):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_bilinear_is_the_mean_of_the_nearest_sites(pattern, dtype):
    for shape in ((2, 2), (2, 5), (3, 3), (7, 2), (8, 11)):
        raw = random_raw(shape, dtype)
        got = demosaic(raw, pattern, "bilinear")
        assert got.dtype == dtype and got.shape == (*shape, 3)
        np.testing.assert_allclose(got, bilinear_by_definition(raw, pattern), atol=0.76)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_malvar_follows_its_equations(pattern, dtype):
    for shape in ((2, 2), (3, 4), (9, 8)):
        raw = random_raw(shape, dtype, 1)
        np.testing.assert_allclose(demosaic(raw, pattern, "malvar"), malvar_by_definition(raw, pattern), atol=0.51)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_edge_aware_green_follows_the_weaker_gradient(pattern, dtype):
    raw = random_raw((13, 16), dtype, 7)
    got, e = demosaic(raw, pattern, "edge_aware"), mirrored(raw)
    expected = bilinear_by_definition(raw, pattern)
    for row, column in zip(*np.nonzero(~site_mask(raw.shape, pattern, "g")), strict=True):
        left, right, up, down = (e[row + 2 + dy, column + 2 + dx] for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0)))
        horizontal, vertical = abs(left - right), abs(up - down)
        means = [np.mean(pair) for pair in ((left, right), (up, down))]
        found = float(got[row, column, 1])
        if horizontal == vertical:  # either will do
            means = sorted(means, key=lambda mean: abs(mean - found))
        expected[row, column, 1] = means[0] if horizontal <= vertical else means[1]
    np.testing.assert_allclose(got, expected, atol=0.76)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_grey_is_the_luma_of_the_bilinear_picture(pattern, dtype):
    for shape in ((2, 2), (2, 9), (3, 3), (4, 7), (5, 6), (13, 16)):
        raw = random_raw(shape, dtype, 2)
        grey = grey_from_mosaic(raw, pattern)
        assert grey.dtype == dtype
        # Integer arithmetic, whose rounding differs between versions: two steps at most, none on average.
        error = grey - bilinear_by_definition(raw, pattern) @ LUMA
        assert np.abs(error).max() < 2
        assert abs(error.mean()) < 0.6 or min(shape) < 8


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("shape", [(2, 2), (2, 3), (3, 2), (3, 3), (4, 4), (5, 9), (16, 17)])
def test_constant_color_is_exact_to_the_border(method, pattern, shape):
    for color in ((10, 100, 200), (255, 0, 255), (65535, 1, 4096)):
        dtype = np.uint16 if max(color) > 255 else np.uint8
        rgb = np.broadcast_to(np.array(color, dtype), (*shape, 3))
        np.testing.assert_array_equal(demosaic(mosaic(rgb, pattern), pattern, method), rgb)
        grey = grey_from_mosaic(mosaic(rgb, pattern), pattern)
        np.testing.assert_allclose(grey, LUMA @ color, atol=1.01)


@pytest.mark.parametrize("method", [m for m in METHODS if m != "edge_aware"])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_linear_ramps_are_exact_inside(method, pattern):
    reach = REACH[method]
    y, x = np.mgrid[: 12 + 2 * reach, : 15 + 2 * reach]
    rgb = np.stack([8 * x + 4 * y, 500 + 12 * x - 8 * y + 8 * 80, 900 - 4 * x + 16 * y], axis=2).astype(np.uint16)
    got = demosaic(mosaic(rgb, pattern), pattern, method)
    np.testing.assert_array_equal(got[reach:-reach, reach:-reach], rgb[reach:-reach, reach:-reach])


@pytest.mark.parametrize("method", METHODS)
@given(
    st.sampled_from(PATTERNS),
    st.integers(0, 3),
    st.integers(0, 3),
    st.integers(0, 2**32),
    st.sampled_from([np.uint8, np.uint16]),
)
def test_phase_shift_commutes_with_cropping(method, pattern, rows, columns, seed, dtype):
    reach = REACH[method]
    raw = random_raw((2 * reach + 11, 2 * reach + 14), dtype, seed)
    whole = demosaic(raw, pattern, method)[rows:, columns:]
    cropped = demosaic(raw[rows:, columns:], pattern.shifted(rows, columns), method)
    np.testing.assert_array_equal(cropped[reach:-reach, reach:-reach], whole[reach:-reach, reach:-reach])


@pytest.mark.parametrize("method", METHODS)
def test_border_continues_as_the_mirror_image(method):
    raw = random_raw((19, 22), np.uint16, 9)
    extended = np.pad(raw, 32, mode="reflect")
    whole = demosaic(extended, "gbrg", method)[32:-32, 32:-32]
    np.testing.assert_array_equal(demosaic(raw, "gbrg", method), whole)


@pytest.fixture
def threads():
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


@pytest.mark.usefixtures("threads")
@pytest.mark.parametrize("method", ["malvar", "hamilton_adams", "menon", "residual"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_neither_strips_nor_threads_matter(method, dtype, monkeypatch):
    raw = random_raw((261, 173), dtype, 6)
    cv2.setNumThreads(1)
    whole = demosaic(raw, "grbg", method)
    monkeypatch.setattr(strips, "_FEWEST_QUADS", 1)
    for size, count in ((1, 1), (1, 2), (1 << 14, 3)):
        cv2.setNumThreads(count)
        monkeypatch.setattr(strips, "_FIELD_BYTES", size)
        np.testing.assert_array_equal(demosaic(raw, "grbg", method), whole)


@given(st.sampled_from(PATTERNS), st.integers(0, 3), st.integers(0, 3), st.integers(0, 2**32))
def test_phase_shift_of_grey_commutes_with_cropping(pattern, rows, columns, seed):
    raw = random_raw((19, 16), np.uint8, seed)
    whole = grey_from_mosaic(raw, pattern)[rows:, columns:]
    cropped = grey_from_mosaic(raw[rows:, columns:], pattern.shifted(rows, columns))
    np.testing.assert_array_equal(cropped[2:-2, 2:-2], whole[2:-2, 2:-2])


@pytest.mark.parametrize("method", METHODS)
@given(st.sampled_from(PATTERNS), st.integers(0, 2**32))
def test_measured_sites_are_kept(method, pattern, seed):
    raw = random_raw((10, 12), np.uint16, seed)
    np.testing.assert_array_equal(mosaic(demosaic(raw, pattern, method), pattern), raw)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_mirroring_commutes(method, pattern):
    # With an odd number of columns a mosaic and its mirror image have the same pattern.
    raw = cv2.GaussianBlur(random_raw((15, 15), np.uint8, 3), (3, 3), 0)
    np.testing.assert_allclose(
        demosaic(raw[:, ::-1], pattern, method).astype(int), demosaic(raw, pattern, method)[:, ::-1], atol=1
    )


@pytest.mark.parametrize("method", METHODS)
def test_8_and_16_bit_agree(method):
    raw = cv2.GaussianBlur(random_raw((40, 50), np.uint8, 4), (5, 5), 0)
    deep = demosaic(raw.astype(np.uint16) * 257, "grbg", method) / 257
    np.testing.assert_allclose(demosaic(raw, "grbg", method), deep, atol=0.76)


@pytest.mark.parametrize("method", METHODS)
def test_views_read_only_and_big_endian_input(method):
    raw = random_raw((12, 14), np.uint16, 5)
    expected = demosaic(raw, "bggr", method)
    padded = np.zeros((12, 20), np.uint16)
    padded[:, :14] = raw
    frozen = raw.copy()
    frozen.flags.writeable = False
    for same in (padded[:, :14], frozen, raw.astype(">u2"), np.asfortranarray(raw)):
        got = demosaic(same, "bggr", method)
        assert got.dtype == np.uint16 and got.dtype.isnative and got.flags.c_contiguous and got.flags.writeable
        np.testing.assert_array_equal(got, expected)
        np.testing.assert_array_equal(grey_from_mosaic(same, "bggr"), grey_from_mosaic(raw, "bggr"))
    np.testing.assert_array_equal(frozen, raw)


BAD = [
    (np.zeros((0, 0), np.uint8), "rggb"),
    (np.zeros((1, 8), np.uint8), "rggb"),
    (np.zeros((8, 1), np.uint16), "rggb"),
    (np.zeros((1, 1), np.uint16), "rggb"),
    (np.zeros((4, 4, 3), np.uint8), "rggb"),
    (np.zeros((4, 4, 1), np.uint8), "rggb"),
    (np.zeros(16, np.uint8), "rggb"),
    (np.zeros((4, 4)), "rggb"),
    (np.zeros((4, 4), np.float32), "rggb"),
    (np.full((4, 4), -1, np.int16), "rggb"),
    (np.zeros((4, 4), bool), "rggb"),
    (np.zeros((4, 4), object), "rggb"),
    ([[1, 2], [3, 4]], "rggb"),
    (None, "rggb"),
    (np.zeros((4, 4), np.uint8), "rgb"),
    (np.zeros((2, 2), np.uint8), "RGGB"),
    (np.zeros((4, 4), np.uint8), None),
]


@pytest.mark.parametrize(("raw", "pattern"), BAD)
def test_bad_mosaics_and_patterns_are_refused(raw, pattern):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        grey_from_mosaic(raw, pattern)
    for method in METHODS:
        with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
            demosaic(raw, pattern, method)


@pytest.mark.parametrize("method", ["menno", "", None, 3])
def test_unknown_methods_are_refused(method):
    with pytest.raises(ShapeError, match="need one of bilinear, edge_aware, malvar"):
        demosaic(np.zeros((4, 4), np.uint8), "rggb", method)


def psnr(got, truth, border=8):
    error = got[border:-border, border:-border].astype(float) - truth[border:-border, border:-border]
    return 10 * np.log10(255**2 / np.mean(error**2))


#: The mean CPSNR in dB (of the mean squared error over the three channels), 8 px border removed, on the pictures
#: below; benchmarks/demosaicking.py gives that of all.
LEAST = {
    "kodak": {"bilinear": 29, "edge_aware": 29, "malvar": 35, "hamilton_adams": 36.7, "menon": 38.8, "residual": 39.2},
    "mcmaster": {
        "bilinear": 30.5,
        "edge_aware": 30.5,
        "malvar": 31.2,
        "hamilton_adams": 31.3,
        "menon": 30,
        "residual": 33,
    },
}
PICTURES = {"kodak": ("kodim05", "kodim15", "kodim19"), "mcmaster": ("1", "9", "17")}


@pytest.mark.parametrize("folder", LEAST)
def test_quality_on_photographs(data_dir, folder):
    pictures = [cv2.imread(str(next((data_dir / folder).glob(f"{name}.*"))))[..., ::-1] for name in PICTURES[folder]]
    for method, least in LEAST[folder].items():
        found = [psnr(demosaic(mosaic(rgb, BayerPattern.RGGB), "rggb", method), rgb) for rgb in pictures]
        assert np.mean(found) >= least, (method, found)


def drawn_picture(vivid: bool):
    """Smooth light over edges and fine stripes; the colours follow each other, or change on their own."""
    y, x = np.mgrid[:160, :200]
    light = 120 + 70 * np.sin(0.0021 * x * x + 0.05 * y) * np.cos(0.0015 * y * y)
    disc = (np.hypot(x - 120, y - 80) < 50) * 1.0
    if vivid:
        rgb = np.stack([light + 60 * disc, 0.5 * light + 90 - 70 * disc, 200 - 0.7 * light + 20 * disc], axis=2)
    else:
        rgb = np.stack([0.9 * light + 20 + 30 * disc, light + 30 * disc, 0.8 * light + 10 + x / 8 + 30 * disc], axis=2)
    return np.clip(np.rint(cv2.GaussianBlur(rgb, (0, 0), 0.7)), 0, 255).astype(np.uint8)


def test_quality_on_drawn_pictures():
    # The twin of the test on photographs.
    dull, vivid = drawn_picture(False), drawn_picture(True)
    for pattern in PATTERNS:
        on_dull = {m: psnr(demosaic(mosaic(dull, pattern), pattern, m), dull) for m in METHODS}
        in_order = ["bilinear", "malvar", "hamilton_adams", "menon", "residual"]
        assert all(on_dull[a] + 1 < on_dull[b] for a, b in pairwise(in_order)), on_dull
        assert on_dull["residual"] > 50
        on_vivid = {m: psnr(demosaic(mosaic(vivid, pattern), pattern, m), vivid) for m in METHODS}
        assert on_vivid["residual"] > max(on_vivid[m] for m in METHODS if m != "residual") + 2.5, on_vivid
