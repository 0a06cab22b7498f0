# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.processing.points import adjust, gamma_corrected, grey_from_rgb

FULL = {np.uint8: 255, np.uint16: 65535, np.float32: 1.0}


def test_255_plus_1_stays_255():
    image = np.array([[0, 1, 254, 255]], np.uint8)
    assert adjust(image, brightness=1).tolist() == [[1, 2, 255, 255]]
    assert adjust(image, brightness=-1).tolist() == [[0, 0, 253, 254]]
    assert adjust(np.array([[65535, 7]], np.uint16), brightness=1).tolist() == [[65535, 8]]
    assert adjust(np.array([[1.0, 0.25]], np.float32), brightness=0.5).tolist() == [[1.0, 0.75]]


@given(st.floats(-4, 4), st.floats(-300, 300))
def test_adjust_by_definition(contrast, brightness):
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    expected = [max(min(round(contrast * v + brightness), 255), 0) for v in range(256)]
    assert adjust(image, contrast, brightness).ravel().tolist() == expected


@pytest.mark.parametrize("dtype", FULL)
def test_nothing_changed_is_the_same_picture(dtype):
    image = (np.random.default_rng(0).random((9, 7, 3)) * FULL[dtype]).astype(dtype)
    for got in (adjust(image), gamma_corrected(image, 1.0)):
        assert got.dtype == dtype
        np.testing.assert_array_equal(got, image)


@pytest.mark.parametrize("dtype", FULL)
def test_gamma_by_hand_and_undone(dtype):
    full = FULL[dtype]
    image = np.array([[0, 0.25 * full, full]]).astype(dtype)
    expected = [0, 0.5 * full, full]
    np.testing.assert_allclose(gamma_corrected(image, 0.5)[0], expected, atol=0.002 * full)
    np.testing.assert_allclose(gamma_corrected(gamma_corrected(image, 0.5), 2.0), image, atol=0.005 * full)


def test_grey_by_hand():
    image = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255], [10, 20, 30]]], np.uint8)
    # 76.245, 149.685, 29.07, 255, 18.15
    assert grey_from_rgb(image).tolist() == [[76, 150, 29, 255, 18]]
    assert grey_from_rgb(image, (1, 1, 1)).tolist() == [[255, 255, 255, 255, 60]]
    np.testing.assert_allclose(grey_from_rgb(image.astype(np.float32) / 255)[0, 4], 18.15 / 255, rtol=1e-6)


@pytest.mark.parametrize(
    "call",
    [
        lambda: adjust(np.zeros((2, 2), np.uint8), contrast=np.inf),
        lambda: adjust(np.zeros((2, 2), np.uint8), brightness=np.nan),
        lambda: adjust(np.full((2, 2), 255.0)),
        lambda: gamma_corrected(np.zeros((2, 2), np.uint8), 0),
        lambda: grey_from_rgb(np.zeros((2, 2), np.uint8)),
        lambda: grey_from_rgb(np.zeros((2, 2, 3), np.uint8), (1, 2)),
        lambda: grey_from_rgb(np.zeros((2, 2, 3), np.uint8), (1e30, 2, 3)),
        lambda: grey_from_rgb(np.full((2, 2, 3), 3e38, np.float32)),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        call()
