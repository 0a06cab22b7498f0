# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.errors import ShapeError
from imgu_ros.image.frame_image import develop
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

LUMA = np.array([0.299, 0.587, 0.114])
METHODS = ["bilinear", "edge_aware", "malvar"]


def developed(pixels, color, pattern=None, method="bilinear", **raw):
    return develop(RawImage(pixels, PixelLayout(color, pattern)), RawParameters(**raw), DemosaicParameters(method))


def random_rgb(dtype=np.uint8, shape=(6, 8), seed=0):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, (*shape, 3), dtype, endpoint=True)


def arranged(rgb, color):
    """RGB pixels as that colour model orders them, with an alpha that must not matter."""
    alpha = np.full(rgb.shape[:2], 77, rgb.dtype)
    r, g, b = np.moveaxis(rgb, 2, 0)
    order = {
        ColorModel.RGB: (r, g, b),
        ColorModel.BGR: (b, g, r),
        ColorModel.RGBA: (r, g, b, alpha),
        ColorModel.BGRA: (b, g, r, alpha),
        ColorModel.ARGB: (alpha, r, g, b),
    }
    return np.stack(order[color], axis=2)


ORDERED = [ColorModel.RGB, ColorModel.BGR, ColorModel.RGBA, ColorModel.BGRA, ColorModel.ARGB]


@pytest.mark.parametrize("color", ORDERED)
def test_channel_orders(color):
    rgb = random_rgb()
    got = developed(arranged(rgb, color), color)
    np.testing.assert_array_equal(got.color(), rgb)
    assert got.color() is got.color()
    assert got.grey.dtype == np.uint8
    np.testing.assert_allclose(got.grey, rgb @ LUMA, atol=1.01)


@pytest.mark.parametrize("color", ORDERED)
@pytest.mark.parametrize("order", ["<", ">"])
def test_16_bit_channel_orders(color, order):
    rgb = random_rgb(np.uint16)
    got = developed(arranged(rgb, color).astype(f"{order}u2"), color, significant_bits=16)
    np.testing.assert_array_equal(got.color(), rgb)
    assert got.color().dtype == np.uint16 and got.color().dtype.isnative
    np.testing.assert_allclose(got.grey, rgb @ LUMA / 65535 * 255, atol=0.52)


@pytest.mark.parametrize("color", ORDERED)
@pytest.mark.parametrize("weights", [(0.0, 0.0, 1.0), (0.0, 3.0, 1.0)])
def test_grey_weights(color, weights):
    for rgb, levels in ((random_rgb(), {}), (random_rgb(np.uint16), {"significant_bits": 16})):
        got = developed(arranged(rgb, color), color, grey_weights=weights, **levels)
        mean = rgb @ np.array(weights) / sum(weights)
        np.testing.assert_allclose(got.grey, mean * (255 / np.iinfo(rgb.dtype).max), atol=1.01)


@pytest.mark.parametrize("method", METHODS)
def test_grey_weights_of_a_mosaic(method):
    flat = np.broadcast_to(np.array([10, 20, 30], np.uint8), (8, 8, 3))
    raw = mosaic(np.ascontiguousarray(flat), BayerPattern.GRBG)
    got = developed(raw, ColorModel.BAYER, BayerPattern.GRBG, method, grey_weights=(1.0, 0.0, 3.0))
    assert (got.grey == 25).all()


def test_grey_weights_of_packed_yuv():
    # Neutral chroma: all three are the luma, whatever the weights (ITU-R BT.601: 16 ... 235).
    packed = np.full((4, 6, 2), 128, np.uint8)
    packed[..., 1] = 100
    assert (
        developed(packed, ColorModel.UYVY, grey_weights=(1.0, 0.0, 0.0)).grey == round((100 - 16) * 255 / 219)
    ).all()


@pytest.mark.parametrize(("bits", "white"), [(10, 1023), (12, 4095), (16, 65535)])
@pytest.mark.parametrize("order", ["<", ">"])
def test_mono_of_known_depth(bits, white, order):
    grey = np.linspace(0, white, 48).astype(f"{order}u2").reshape(6, 8)
    got = developed(grey, ColorModel.MONO, significant_bits=bits)
    np.testing.assert_allclose(got.grey, grey.astype(float) / white * 255, atol=0.51)
    np.testing.assert_array_equal(got.color(), np.repeat(grey[:, :, None], 3, axis=2))


def test_mono_keeps_8_bit_values():
    grey = np.arange(48, dtype=np.uint8).reshape(6, 8)
    got = developed(grey, ColorModel.MONO)
    np.testing.assert_array_equal(got.grey, grey)
    assert got.color().dtype == np.uint8
    assert developed(grey[:1, :1], ColorModel.MONO).grey.tolist() == [[0]]


def test_black_and_white_level_of_grey():
    grey = np.array([[0, 20, 60], [100, 120, 255]], np.uint8)
    got = developed(grey, ColorModel.MONO, black_level=20.0, white_level=120.0).grey
    np.testing.assert_allclose(got, [[0, 0, 102], [204, 255, 255]], atol=0.5)


def test_deep_data_without_a_known_depth_are_stretched():
    y, x = np.mgrid[:60, :80]
    grey = (30000 + 3 * x + 2 * y).astype(np.uint16)
    got = developed(grey, ColorModel.MONO).grey
    assert got.min() == 0 and got.max() == 255
    assert np.corrcoef(got.ravel(), grey.ravel())[0, 1] > 0.999


@pytest.mark.parametrize(("color", "luma_first"), [(ColorModel.UYVY, False), (ColorModel.YUYV, True)])
def test_packed_yuv(color, luma_first):
    y = np.arange(16, 240, 7, dtype=np.uint8).reshape(4, 8)
    chroma = np.full_like(y, 128)
    pixels = np.stack((y, chroma) if luma_first else (chroma, y), axis=2)
    got = developed(pixels, color)
    np.testing.assert_array_equal(got.grey, y)
    # BT.601, studio range: (y - 16) * 255 / 219, no colour
    np.testing.assert_allclose(
        got.color(), np.clip((y[:, :, None] - 16.0) * 255 / 219, 0, 255).repeat(3, axis=2), atol=1.5
    )
    # Cr (the second chroma sample of each pair) makes red.
    chroma = np.tile(np.array([128, 220], np.uint8), (4, 4))
    pixels = np.stack((np.full_like(y, 100), chroma) if luma_first else (chroma, np.full_like(y, 100)), axis=2)
    red, green, blue = developed(pixels, color).color()[1, 1].astype(int)
    np.testing.assert_allclose(
        (red, green, blue), (84 * 1.164 + 1.596 * 92, 84 * 1.164 - 0.813 * 92, 84 * 1.164), atol=2
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pattern", list(BayerPattern))
@pytest.mark.parametrize("dtype", [np.uint8, "<u2", ">u2"])
def test_bayer_of_one_color(method, pattern, dtype):
    depth = np.dtype(dtype).itemsize
    scale = 1 if depth == 1 else 16
    rgb = np.broadcast_to(np.array([40, 120, 200], f"u{depth}") * scale, (9, 12, 3)).astype(f"u{depth}")
    got = developed(mosaic(rgb, pattern).astype(dtype), ColorModel.BAYER, pattern, method, significant_bits=12)
    np.testing.assert_array_equal(got.color(), rgb if depth == 1 else np.rint(rgb / 4095 * 65535))
    np.testing.assert_allclose(got.grey, LUMA @ [40, 120, 200] * (1 if depth == 1 else 16 / 4095 * 255), atol=1.1)


@pytest.mark.parametrize("method", METHODS)
def test_gains_hold_above_black(method):
    # A neutral scene of 600 + s / gain: with the right gains it is grey, and s of a range of 14400 above black.
    gains, black, white = (1.95, 1.0, 1.35), 600.0, 15000.0
    signal = 6000.0
    rgb = np.broadcast_to(np.rint(black + signal / np.array(gains)).astype(np.uint16), (10, 12, 3))
    got = developed(
        mosaic(rgb, "rggb"),
        ColorModel.BAYER,
        BayerPattern.RGGB,
        method,
        black_level=black,
        white_level=white,
        gains=gains,
    )
    np.testing.assert_allclose(got.grey, signal / (white - black) * 255, atol=0.6)
    np.testing.assert_allclose(got.color(), signal / (white - black) * 65535, atol=10)
    dark = np.full((10, 12), 600, np.uint16)
    picture = developed(
        dark, ColorModel.BAYER, BayerPattern.RGGB, method, black_level=black, white_level=white, gains=gains
    )
    assert not picture.grey.any() and not picture.color().any()


def test_padded_read_only_rows():
    rgb = random_rgb(shape=(7, 9))
    wide = np.zeros((7, 12, 3), np.uint8)
    wide[:, :9] = rgb
    view = wide[:, :9]
    view.flags.writeable = False
    np.testing.assert_array_equal(developed(view, ColorModel.RGB).color(), rgb)
    raw = mosaic(rgb, "rggb")
    wide_raw = np.zeros((7, 16), np.uint8)
    wide_raw[:, :9] = raw
    view = wide_raw[:, :9]
    view.flags.writeable = False
    for method in METHODS:
        one = developed(view, ColorModel.BAYER, BayerPattern.RGGB, method)
        other = developed(raw, ColorModel.BAYER, BayerPattern.RGGB, method)
        np.testing.assert_array_equal(one.grey, other.grey)
        np.testing.assert_array_equal(one.color(), other.color())


@pytest.mark.parametrize("dtype", ["u1", "i1", "u2", "i2", "i4", "f4", "f8", ">u2", ">i2", ">f4", ">f8"])
@pytest.mark.parametrize("bands", [0, 1, 5])
def test_bands_of_any_type(dtype, bands):
    rng = np.random.default_rng(1)
    values = rng.integers(-100 if np.dtype(dtype).kind in "if" else 0, 100, (40, 30) + ((bands,) if bands else ()))
    mean = values if not bands else values.mean(axis=2)
    got = developed(values.astype(dtype), ColorModel.BANDS)
    if dtype == "u1":
        exact = mean
    else:
        low, high = np.quantile(mean, (0.002, 0.998))
        exact = np.clip((mean - low) / (high - low) * 255, 0, 255)
    np.testing.assert_allclose(got.grey, exact, atol=0.52)
    np.testing.assert_array_equal(got.color(), np.repeat(got.grey[:, :, None], 3, axis=2))


def test_chosen_bands():
    cube = np.stack([np.full((4, 4), v, np.uint8) for v in (10, 20, 60)], axis=2)
    assert (developed(cube, ColorModel.BANDS, bands=(1,)).grey == 20).all()
    assert (developed(cube, ColorModel.BANDS, bands=(0, 2)).grey == 35).all()
    assert (developed(cube, ColorModel.BANDS).grey == 30).all()
    with pytest.raises(ShapeError, match=r"raw.bands: 3; need 0 to 2"):
        developed(cube, ColorModel.BANDS, bands=(0, 3))


def stretched(values):
    low, high = np.quantile(values, (0.002, 0.998))
    return np.clip((values - low) / (high - low) * 255, 0, 255)


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">u2", "f4"])
def test_weighted_mean_of_bands(dtype):
    cube = np.random.default_rng(5).integers(0, 256, (20, 30, 4)).astype(dtype)
    got = developed(cube, ColorModel.BANDS, band_mode="weighted", band_weights=(1.0, 0.0, 2.0, 1.0)).grey
    exact = (cube[:, :, 0] + 2.0 * cube[:, :, 2] + cube[:, :, 3]) / 4
    np.testing.assert_allclose(got, exact if dtype == "u1" else stretched(exact), atol=0.52)
    got = developed(cube, ColorModel.BANDS, bands=(3, 1), band_mode="weighted", band_weights=(1.0, 3.0)).grey
    exact = (cube[:, :, 3] + 3.0 * cube[:, :, 1]) / 4
    np.testing.assert_allclose(got, exact if dtype == "u1" else stretched(exact), atol=0.52)


@pytest.mark.parametrize("dtype", ["u1", ">u2", "f8"])
def test_principal_component_of_bands(dtype):
    t = np.random.default_rng(6).uniform(-20, 20, (20, 30))
    cube = np.rint(np.stack((100 + 3 * t, 120 + 4 * t, np.full(t.shape, 7.0)), axis=2)).astype(dtype)
    got = developed(cube, ColorModel.BANDS, band_mode="principal_component").grey
    np.testing.assert_allclose(got, stretched(t), atol=2)
    # The levels of raw data do not apply to a component.
    with_black = developed(cube, ColorModel.BANDS, band_mode="principal_component", black_level=50.0).grey
    np.testing.assert_array_equal(with_black, got)


def test_spectral_angle_of_bands():
    # Two materials at many brightnesses, over a black level: the picture tells the materials apart, bright the sought.
    rng = np.random.default_rng(7)
    brightness, sought = rng.uniform(200, 900, (20, 30, 1)), rng.random((20, 30)) < 0.5
    spectra = np.where(sought[:, :, None], [3.0, 1.0, 0.5], [1.0, 2.0, 0.5])
    cube = np.rint(64 + brightness * spectra).astype(np.uint16)
    raw = {"band_mode": "spectral_angle", "reference_spectrum": (6.0, 2.0, 1.0), "black_level": 64.0}
    got = developed(cube, ColorModel.BANDS, **raw).grey
    assert got[sought].min() > 240 and got[~sought].max() < 15
    some = developed(cube, ColorModel.BANDS, **(raw | {"bands": (1, 0), "reference_spectrum": (1.0, 3.0)})).grey
    assert some[sought].min() > 240 and some[~sought].max() < 15
    cube[:4] = 64  # no light: no spectrum, dark, and no reason to compress the rest
    dark = developed(cube, ColorModel.BANDS, **raw).grey
    assert not dark[:4].any()
    assert dark[4:][sought[4:]].min() > 240


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        ({"band_mode": "weighted", "band_weights": (1.0,)}, "raw.band_weights: 1 values; need 3, one for each band"),
        (
            {"band_mode": "spectral_angle", "reference_spectrum": (1.0, 2.0)},
            "raw.reference_spectrum: 2 values; need 3, one for each band",
        ),
        ({"band_mode": "median"}, "BandMode: 'median'; need one of mean"),
    ],
)
def test_bands_that_do_not_fit_their_parameters(raw, message):
    with pytest.raises(ShapeError) as caught:
        developed(np.ones((4, 5, 3), np.uint8), ColorModel.BANDS, **raw)
    assert str(caught.value).startswith(message)


def test_thermal_picture_gets_its_gain_from_percentiles():
    # Centikelvin around 300 K in mono16, a hot spot and a dead pixel: the scene keeps the whole range.
    y, x = np.mgrid[:120, :160]
    scene = (29_800 + x + y).astype(np.uint16)
    plain = developed(scene, ColorModel.MONO).grey
    assert plain.min() == 0 and plain.max() == 255
    np.testing.assert_allclose(plain, stretched(scene), atol=0.51)
    scene[60, 80], scene[3, 5] = 65535, 0
    got = developed(scene, ColorModel.MONO).grey
    assert np.abs(got.astype(int) - plain)[scene % 65535 != 0].max() <= 1


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("gap", [np.nan, np.inf, -np.inf])
def test_pixels_without_a_value_do_not_matter(dtype, gap):
    # A thermal picture in kelvin with a hole: the hole is dark, the rest is as without it.
    y, x = np.mgrid[:50, :60]
    kelvin = (290 + 0.1 * x + 0.05 * y).astype(dtype)
    whole = developed(kelvin, ColorModel.BANDS).grey.astype(int)
    kelvin[10:14, 20:25] = gap
    got = developed(kelvin, ColorModel.BANDS).grey.astype(int)
    assert not got[10:14, 20:25].any()
    rest = np.ones(got.shape, bool)
    rest[10:14, 20:25] = False
    assert np.abs(got - whole)[rest].max() <= 8  # the hole is counted as dark: the low end moves a little


def test_extreme_bands():
    assert not developed(np.full((4, 4), np.nan), ColorModel.BANDS).grey.any()
    assert not developed(np.full((4, 4, 3), [np.inf, -np.inf, 0]), ColorModel.BANDS).grey.any()
    huge = np.array([[0.0, 1e300], [-1e300, 1.7e308]])
    assert developed(huge, ColorModel.BANDS).grey[1, 0] == 0


def test_luma_is_grey_of_a_display():
    """The luma of YUV is that of JPEG: no values of the light, unlike a monochrome sensor's."""
    pixels = np.random.default_rng(1).integers(0, 256, (6, 8), np.uint8)
    luma, mono = developed(pixels, ColorModel.LUMA), developed(pixels, ColorModel.MONO)
    assert (luma.is_linear, mono.is_linear) == (False, True)
    np.testing.assert_array_equal(luma.grey, pixels)
    np.testing.assert_array_equal(luma.color(), np.dstack([pixels] * 3))
    np.testing.assert_array_equal(luma.halved(1), mono.halved(1))


CHANNELS = {
    ColorModel.BAYER: 0,
    ColorModel.MONO: 0,
    ColorModel.LUMA: 0,
    **dict.fromkeys((ColorModel.RGB, ColorModel.BGR), 3),
    **dict.fromkeys((ColorModel.RGBA, ColorModel.BGRA, ColorModel.ARGB), 4),
    **dict.fromkeys((ColorModel.UYVY, ColorModel.YUYV), 2),
}


@pytest.mark.parametrize("color", list(ColorModel))
def test_pixels_that_do_not_fit_their_layout(color):
    pattern = BayerPattern.RGGB if color is ColorModel.BAYER else None
    shapes = [(0, 0), (3,), (), (2, 2, 2, 2), (0, 4, 3)]
    if color is not ColorModel.BANDS:
        shapes += [(4, 4, n) if n else (4, 4) for n in (0, 1, 2, 3, 4, 5) if n != CHANNELS[color]]
    for shape in shapes:
        with pytest.raises(ShapeError, match=r"^pixels: [^\n]+need[^\n]+$"):
            developed(np.zeros(shape, np.uint8), color, pattern)
    n = CHANNELS.get(color, 0)
    shape = (4, 4, n) if n else (4, 4)
    wrong = [bool, object, complex, "S1"]
    if color is not ColorModel.BANDS:
        wrong += [np.int8, np.int16, np.int32, np.float32, np.float64]
    if color in (ColorModel.UYVY, ColorModel.YUYV):
        wrong += [np.uint16]
    for dtype in wrong:
        with pytest.raises(ShapeError, match=r"^pixels: data type [^\n]+need[^\n]+$"):
            developed(np.zeros(shape, dtype), color, pattern)
    with pytest.raises(ShapeError):
        developed([[1, 2]], color, pattern)


def test_other_impossible_frames():
    with pytest.raises(ShapeError, match="pattern"):
        developed(np.zeros((4, 4), np.uint8), ColorModel.BAYER)
    with pytest.raises(ShapeError, match="2x2"):
        developed(np.zeros((1, 4), np.uint8), ColorModel.BAYER, BayerPattern.RGGB)
    for color in (ColorModel.UYVY, ColorModel.YUYV):
        with pytest.raises(ShapeError, match="even width"):
            developed(np.zeros((4, 5, 2), np.uint8), color)
    with pytest.raises(ShapeError, match=r"raw\.black_level: 300; need less than the white level, 255"):
        developed(np.zeros((4, 4), np.uint8), ColorModel.MONO, black_level=300.0)
    with pytest.raises(ShapeError, match=r"raw\.black_level"):
        developed(np.zeros((4, 4), np.uint16), ColorModel.MONO, black_level=1023.0, significant_bits=10)
    with pytest.raises(ShapeError, match="need one of"):
        developed(np.zeros((4, 4), np.uint8), ColorModel.MONO, method="best")
