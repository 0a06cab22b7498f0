# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.vision.processing.histograms import equalised, equalised_locally, histogram
from imgu_ros.vision.processing.thresholding import otsu_threshold, thresholded


@given(st.integers(1, 300), st.integers(0, 2**32))
def test_every_bin_by_its_definition(bins, seed):
    image = np.random.default_rng(seed).integers(0, 256, (13, 11)).astype(np.uint8)
    width = 256 / bins
    expected = [np.count_nonzero((image >= i * width) & (image < (i + 1) * width)) for i in range(bins)]
    assert histogram(image, bins).tolist() == expected


def test_histograms_by_hand():
    assert histogram(np.array([[0, 63, 64, 255]], np.uint8), 4).tolist() == [2, 1, 0, 1]
    # l = 85 1/3: bins begin at 0, 85.33, 170.67
    assert histogram(np.array([[85, 86, 170, 171]], np.uint8), 3).tolist() == [1, 2, 1]
    assert histogram(np.array([[0, 32767, 32768, 65535]], np.uint16), 2).tolist() == [2, 2]
    assert histogram(np.array([[-1, 0.0, 0.49, 0.5, 1.0, 2]], np.float32), 2).tolist() == [3, 3]


def test_counts_beyond_what_floats_can_count():
    # OpenCV counts in float32, which ends at 2^24.
    image = np.broadcast_to(np.uint8(7), (4097, 4099))
    assert histogram(image, 2).tolist() == [4097 * 4099, 0]


def test_equalised_by_hand():
    # C = 2, 3, 4 of 4; C0 = 2: 0, 1/2, 1
    assert equalised(np.array([[50, 50, 51, 52]], np.uint8)).tolist() == [[0, 0, 128, 255]]
    assert equalised(np.array([[50, 50, 51, 52]], np.uint16)).tolist() == [[0, 0, 32768, 65535]]
    assert equalised(np.full((3, 3), 9, np.uint8)).tolist() == [[9] * 3] * 3


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_equalising_straightens_the_cumulative_histogram_and_keeps_the_order(dtype):
    top = np.iinfo(dtype).max
    image = (np.random.default_rng(1).beta(2, 8, (200, 200)) * top).astype(dtype)
    got = equalised(image)
    values = np.sort(got.ravel()) / top
    assert np.abs(values - np.linspace(0, 1, values.size)).max() < 0.03
    order = np.argsort(image.ravel(), kind="stable")
    assert (np.diff(got.ravel()[order].astype(int)) >= 0).all()


def test_local_equalisation_evens_out_light_that_differs():
    rng = np.random.default_rng(2)
    texture = rng.integers(0, 40, (160, 160))
    light = np.linspace(0, 160, 160)[None]
    image = (texture + light).astype(np.uint8)
    got = equalised_locally(image, clip=40.0, tiles=8)
    contrast = [got[:, i : i + 20].std() for i in range(20, 140, 20)]
    assert min(contrast) > 2 * image[:, 60:80].std()
    # The limit holds noise down: with 1, tiles are hardly changed in contrast.
    assert equalised_locally(image, clip=1.0).std() < got.std() * 1.5
    assert equalised_locally(image.astype(np.uint16) * 257).dtype == np.uint16


@given(st.integers(0, 255), st.integers(0, 2**32))
def test_threshold_by_definition(value, seed):
    image = np.random.default_rng(seed).integers(0, 256, (8, 8)).astype(np.uint8)
    np.testing.assert_array_equal(thresholded(image, value), np.where(image < value, 0, 255))
    np.testing.assert_array_equal(thresholded(image, value - 0.5), np.where(image < value - 0.5, 0, 255))
    wide = image.astype(np.uint16) * 257
    np.testing.assert_array_equal(thresholded(wide, value * 257), np.where(wide < value * 257, 0, 65535))
    real = image.astype(np.float32) / 255
    np.testing.assert_array_equal(thresholded(real, value / 256), np.where(real < value / 256, 0, 1))


@pytest.mark.parametrize("value", [-1e300, -1, 0])
def test_thresholds_below_everything(value):
    for dtype in (np.uint8, np.uint16, np.float32):
        assert thresholded(np.zeros((2, 2), dtype), value).min() > 0
    assert thresholded(np.full((2, 2), 255, np.uint8), 1e300).max() == 0


def between_class_variance(image, t):
    low, high = image[image < t].astype(float), image[image >= t].astype(float)
    return len(low) * len(high) * (low.mean() - high.mean()) ** 2 if len(low) and len(high) else 0.0


@given(st.integers(0, 2**32))
def test_otsu_maximises_the_variance_between_classes(seed):
    rng = np.random.default_rng(seed)
    image = np.clip(np.r_[rng.normal(70, 20, 60), rng.normal(170, 30, 90)], 0, 255).astype(np.uint8)[None]
    t = otsu_threshold(image)
    best = max(between_class_variance(image, v) for v in range(1, 256))
    assert between_class_variance(image, t) == pytest.approx(best)
    assert otsu_threshold(image.astype(np.uint16) * 257) == pytest.approx(257 * t, abs=257)
    assert otsu_threshold(image.astype(np.float32) / 255) == pytest.approx(t / 255, abs=1 / 255)


def test_otsu_lies_in_the_middle_of_an_empty_gap():
    assert otsu_threshold(np.array([[10, 10, 200]], np.uint8)) == 105.5
    with pytest.raises(DegenerateConfiguration, match="one value"):
        otsu_threshold(np.full((5, 5), 9, np.uint8))


@given(st.integers(2, 300), st.integers(0, 2**32))
def test_otsu_of_few_bins_is_otsu_of_the_binned_picture(bins, seed):
    rng = np.random.default_rng(seed)
    image = np.clip(np.r_[rng.normal(60, 15, 60), rng.normal(180, 15, 90)], 0, 255).astype(np.uint8)[None]
    binned = image.astype(np.int64) * bins // 256
    classes = thresholded(image, otsu_threshold(image, bins)) > 0
    levels = np.unique(binned)
    best = max(between_class_variance(binned, v) for v in range(levels[0] + 1, levels[-1] + 1))
    # A limit between bins: no bin is divided.
    assert not set(binned[classes]) & set(binned[~classes])
    assert between_class_variance(binned, binned[classes].min()) == pytest.approx(best)


def test_otsu_bins_by_hand():
    image = np.array([[10, 12, 12, 200, 202]], np.uint8)
    # Limits at 64, 128, 192: all three divide the picture alike.
    assert otsu_threshold(image, 4) == 128
    assert otsu_threshold(image.astype(np.uint16) * 256, 4) == 128 * 256
    assert otsu_threshold(image.astype(np.float32) / 256, 4) == 0.5
    with pytest.raises(DegenerateConfiguration, match="one bin"):
        otsu_threshold(np.array([[10, 60]], np.uint8), 4)


@pytest.mark.parametrize(
    "call",
    [
        lambda: histogram(np.zeros((2, 2), np.uint8), 0),
        lambda: histogram(np.zeros((2, 2), np.uint8), 65537),
        lambda: histogram(np.zeros((2, 2), np.uint8), 2.5),
        lambda: histogram(np.zeros((2, 2, 3), np.uint8)),
        lambda: equalised(np.full((2, 2), 255, np.float32)),
        lambda: equalised_locally(np.zeros((2, 2), np.uint8), clip=0.5),
        lambda: equalised_locally(np.zeros((2, 2), np.uint8), tiles=0),
        lambda: thresholded(np.zeros((2, 2), np.uint8), np.nan),
        lambda: otsu_threshold(np.zeros((2, 2), np.uint8), 1),
        lambda: otsu_threshold(np.zeros((2, 2), np.uint8), 2.5),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        call()
