from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from imgu_ros.errors import ImguError, ShapeError
from imgu_ros.types import Choice, as_image, as_matrix, as_points, as_rows


class Fruit(Choice):
    APPLE = "apple"
    PEAR = "pear"


def test_choices_are_strings_and_refuse_others():
    assert Fruit("pear") is Fruit.PEAR == "pear"
    for other in ("plum", "Apple", "", None, 3, ["apple"]):
        with pytest.raises(ShapeError, match="Fruit: .*; need one of apple, pear"):
            Fruit(other)


@given(hnp.arrays(np.float64, st.tuples(st.integers(0, 9), st.just(2)), elements=st.floats(-1e9, 1e9)))
def test_points_pass_unchanged(points):
    assert as_points(points) is points
    np.testing.assert_array_equal(as_points(points.tolist() or np.zeros((0, 2))), points)


@pytest.mark.parametrize("dtype", [np.uint8, np.int64, np.float32, ">f8", bool])
def test_numbers_become_float64(dtype):
    got = as_points(np.array([[1, 0]], dtype))
    assert got.dtype == np.float64 and got.dtype.isnative and got.tolist() == [[1.0, 0.0]]


def test_other_row_lengths_and_minimum():
    assert as_rows([[1, 2, 3]], 3, "rows").tolist() == [[1, 2, 3]]
    assert as_matrix(range(3), (3,), "v").tolist() == [0, 1, 2]
    with pytest.raises(ShapeError, match=r"src: shape \(3, 2\); need \(N >= 4, 2\)"):
        as_points(np.zeros((3, 2)), "src", 4)
    with pytest.raises(ShapeError, match=r"K: shape \(2, 3\); need \(3, 3\)"):
        as_matrix(np.zeros((2, 3)), (3, 3), "K")


BAD_POINTS = [
    None,
    "ab",
    [["a", "b"]],
    object(),
    {},
    iter([1]),
    [1, 2],
    [[1], [1, 2]],
    [[1, 2, 3]],
    np.zeros((2, 2, 2)),
    [[np.nan, 1]],
    [[np.inf, 1]],
    [[None, 1]],
    [[1 + 2j, 1]],
    np.array([[1 + 2j, 1]]),
    [[10**400, 1]],
    np.array([["2020-01-01", "2020-01-02"]], "M8[D]"),
    np.array([["1", "2"]]),
]


# An address in a name would make it another one in every process.
@pytest.mark.parametrize("points", BAD_POINTS, ids=lambda p: repr(p).partition(" at 0x")[0][:30])
def test_bad_points_are_refused(points):
    with pytest.raises(ShapeError, match=r"^points: [^\n]+need[^\n]+$"):
        as_points(points)


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">u2", "<f4", ">f4"])
def test_images_come_out_native_and_contiguous(dtype):
    whole = (np.arange(60) / 64 if dtype.endswith("f4") else np.arange(60)).reshape(6, 10).astype(dtype)
    for view in (whole, whole[::2, 1:7], whole.T, np.asfortranarray(whole)):
        view = view.view()
        view.flags.writeable = False
        got = as_image(view)
        assert got.dtype.isnative and got.flags.c_contiguous
        np.testing.assert_array_equal(got, view)
    assert np.shares_memory(as_image(whole), whole) == whole.dtype.isnative


def test_channels_and_types_that_are_asked_for():
    assert as_image(np.zeros((2, 3, 4), np.uint8), channels=(1, 4)).shape == (2, 3, 4)
    with pytest.raises(ShapeError, match=r"rgb: shape \(2, 3\); need \(H, W, 3\)"):
        as_image(np.zeros((2, 3), np.uint8), "rgb", (3,))
    with pytest.raises(ShapeError, match="data type uint16; need uint8"):
        as_image(np.zeros((2, 3), np.uint16), dtypes=(np.uint8,))


@pytest.mark.parametrize(
    "image",
    [
        None,
        [[1, 2]],
        b"12",
        np.uint8(3),
        np.zeros((), np.uint8),
        np.zeros(4, np.uint8),
        np.zeros((0, 4), np.uint8),
        np.zeros((4, 4, 1), np.uint8),
        np.zeros((4, 4, 3), np.uint8),
        np.zeros((1, 4, 4, 1), np.uint8),
        np.zeros((4, 4), bool),
        np.zeros((4, 4), np.int8),
        np.zeros((4, 4), np.float64),
        np.zeros((4, 4), np.float16),
        np.zeros((4, 4), np.complex64),
        np.zeros((4, 4), object),
        np.zeros((4, 4), "S1"),
        np.zeros((4, 4), [("r", "u1")]),
        np.full((2, 2), np.nan, np.float32),
        np.full((2, 2), np.inf, ">f4"),
    ],
    ids=repr,
)
def test_bad_images_are_refused(image):
    with pytest.raises(ImguError, match=r"^image: [^\n]+need[^\n]+$"):
        as_image(image)
