# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from imgu_ros.arguments import as_generator
from imgu_ros.errors import ImguError, ShapeError
from imgu_ros.types import (
    Choice,
    as_floats,
    as_image,
    as_matrix,
    as_plain,
    as_plane_points,
    as_points,
    as_rows,
    require_unit_range,
)

ALL = (np.uint8, np.uint16, np.float32)


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
    3.0,
    "3",
    ["1", "2"],
    [["1", "2"]],
    {1: 2},
    {(1, 2)},
    [None, None],
    np.zeros((2, 1, 3)),
    np.zeros((1, 2, 2)),
    np.ma.masked_equal([[1.0, 2.0]], 2.0),
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
        np.full((4, 4), -1),
        np.full((4, 4), 65536),
        np.full((4, 4), 1e300),
        np.full((4, 4), np.nan),
        np.ma.masked_equal(np.eye(4), 0),
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


@pytest.mark.parametrize(
    "points",
    [
        ((1, 2), (3, 4)),
        [(1, 2), [3, 4]],
        [np.array([1, 2]), (3.0, np.float32(4))],
        np.array([[1, 2], [3, 4]], np.uint8),
        np.array([[[1, 2]], [[3, 4]]], np.int32),
        [[[1, 2]], [[3, 4]]],
        np.array([[1, 2], [3, 4]]).view(np.matrix),
        [cv2.KeyPoint(1, 2, 7), cv2.KeyPoint(3, 4, 7)],
        (cv2.KeyPoint(1, 2, 7), cv2.KeyPoint(3, 4, 7)),
        cv2.KeyPoint.convert([cv2.KeyPoint(1, 2, 7), cv2.KeyPoint(3, 4, 7)]),
    ],
    ids=lambda points: f"{type(points).__name__} {np.shape(points)}",
)
def test_points_as_numpy_and_opencv_have_them(points):
    got = as_points(points)
    assert type(got) is np.ndarray and got.dtype == np.float64 and got.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize("nothing", [[], (), np.zeros((0, 2)), np.zeros((0, 1, 2), np.float32), np.zeros(0)], ids=str)
def test_an_empty_list_is_no_points(nothing):
    assert as_points(nothing).shape == (0, 2)
    with pytest.raises(ShapeError, match=r"points: shape \(0, 2\); need \(N >= 1, 2\)"):
        as_points(nothing, minimum=1)


def test_opencv_lists_its_points_as_we_take_them():
    picture = np.zeros((60, 80), np.uint8)
    cv2.rectangle(picture, (20, 15), (50, 40), 255, -1)
    (contour,), _ = cv2.findContours(picture, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    assert contour.shape == (4, 1, 2)
    assert sorted(as_points(contour).tolist()) == [[20, 15], [20, 40], [50, 15], [50, 40]]
    assert as_points(cv2.goodFeaturesToTrack(picture, 4, 0.1, 5)).shape == (4, 2)


@pytest.mark.parametrize(
    "points", [[(1, 2, 0), (3, 4, 0)], [[1, 2], [3, 4]], np.array([[[1, 2, 0]], [[3, 4, 0]]], "f4")]
)
def test_points_of_a_plane_may_have_a_third_coordinate_that_is_0(points):
    assert as_plane_points(points).tolist() == [[1, 2], [3, 4]]


def test_other_points_of_space_are_no_points_of_a_plane():
    with pytest.raises(ShapeError, match="board: z up to 5; need points of the plane z = 0"):
        as_plane_points([(1, 2, 0), (3, 4, -5)], "board")
    for points in (None, "3", [(1, 2, 3, 4)], [(1, 2, np.nan)], [], [(1, 2)]):
        with pytest.raises(ShapeError, match=r"^board: .*need"):
            as_plane_points(points, "board", 2)


UNIT = [[0.0, 0.25], [0.5, 1.0]]


@pytest.mark.parametrize(
    ("image", "dtypes", "expected"),
    [
        (np.array(UNIT), ALL, np.array(UNIT, np.float32)),
        (np.array(UNIT, np.float16), ALL, np.array(UNIT, np.float32)),
        (np.array(UNIT, ">f8").T, ALL, np.array(UNIT, np.float32).T),
        (np.array(UNIT, np.longdouble), ALL, np.array(UNIT, np.float32)),
        (np.array(UNIT), (np.uint8,), np.array([[0, 64], [128, 255]], np.uint8)),
        (np.array(UNIT, np.float32), (np.uint8, np.uint16), np.array([[0, 16384], [32768, 65535]], np.uint16)),
        (np.array([[-0.5, 1.5]]), (np.uint8,), np.array([[0, 255]], np.uint8)),
        (np.array([[True, False]]), ALL, np.array([[1, 0]], np.float32)),
        (np.array([[True, False]]), (np.uint8,), np.array([[255, 0]], np.uint8)),
        (np.array([[True, False]]), (np.uint8, np.uint16), np.array([[255, 0]], np.uint8)),
        (np.array([[True, False]]), (np.uint16,), np.array([[65535, 0]], np.uint16)),
        (np.array([[0, 255]]), ALL, np.array([[0, 255]], np.uint8)),
        (np.array([[0, 256]]), ALL, np.array([[0, 256]], np.uint16)),
        (np.array([[0, 65535]], np.uint32), ALL, np.array([[0, 65535]], np.uint16)),
        (np.array([[0, 127]], np.int8), (np.uint8,), np.array([[0, 127]], np.uint8)),
        (np.array([[7, 9]], ">i8")[:, ::-1], (np.uint8,), np.array([[9, 7]], np.uint8)),
        (np.array([[1, 2]], np.uint8).view(np.matrix), ALL, np.array([[1, 2]], np.uint8)),
    ],
)
def test_other_images_are_taken_as_it_says(image, dtypes, expected):
    got = as_image(image, dtypes=dtypes)
    assert type(got) is np.ndarray and got.dtype == expected.dtype and got.dtype.isnative and got.flags.c_contiguous
    np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize(
    ("image", "dtypes", "message"),
    [
        (np.full((2, 2), 200.0), (np.uint8,), r"float64 from 200 to 200; need floats in \[0, 1\]"),
        (np.array([[-3, 5]]), ALL, "int64 from -3 to 5; need 0 to 65535"),
        (np.array([[0, 256]], np.int32), (np.uint8,), "int32 from 0 to 256; need 0 to 255"),
        (np.zeros((2, 2), np.uint16), (np.uint8,), "uint16; need uint8"),
        (np.zeros((2, 2), np.uint8), (np.float32,), "uint8; need float32"),
        (np.full((2, 2), 1e39), ALL, "beyond 3.40282e"),
        (np.array([[0.5, np.nan]]), ALL, "1 values are not finite"),
        (np.array([[0.5, np.inf]]), (np.uint8,), "1 values are not finite"),
    ],
)
def test_images_that_can_be_meant_in_several_ways_are_refused(image, dtypes, message):
    with pytest.raises(ShapeError, match=f"^image: .*{message}"):
        as_image(image, dtypes=dtypes)


@pytest.mark.parametrize("image", [np.full((2, 2), 0.5), np.ones((2, 2), bool)])
def test_raw_numbers_are_not_scaled(image):
    with pytest.raises(ShapeError, match="need uint8, uint16"):
        as_image(image, dtypes=(np.uint8, np.uint16), rescaled=False)


def test_the_unit_range_leaves_room_for_an_overshoot():
    require_unit_range(np.array([[-1.0, 2.0]]))
    require_unit_range(np.full((2, 2), 255, np.uint8))
    for value in (-1.1, 2.1, np.nan, 255):
        with pytest.raises(ShapeError, match=r"^grey: .*need floats in \[0, 1\]"):
            require_unit_range(np.full((2, 2), value, np.float32), "grey")


def test_seeds_and_generators():
    rng = np.random.default_rng(7)
    assert as_generator(rng) is rng
    expected = np.random.default_rng(7).random(5)
    for seed in (7, np.int64(7), np.uint8(7)):
        np.testing.assert_array_equal(as_generator(seed).random(5), expected)


@pytest.mark.parametrize(
    "rng", [None, -1, 1.0, True, "0", [1], np.random.RandomState(0), np.random], ids=lambda rng: type(rng).__name__
)
def test_what_is_no_source_of_randomness_is_refused(rng):
    with pytest.raises(ShapeError, match=r"^rng: [^\n]+; need a numpy.random.Generator, or a seed: an integer >= 0$"):
        as_generator(rng)


def test_arrays_of_subclasses_become_plain_and_masked_ones_are_refused():
    for array in (np.array([[1.0, 2.0]]).view(np.matrix), np.array([[1.0, 2.0]])):
        assert type(as_floats(array, "a")) is type(as_plain(array, "a")) is np.ndarray
    for function in (as_floats, as_plain):
        with pytest.raises(ShapeError, match="a: a masked array; need a plain one"):
            function(np.ma.masked_equal([1.0, 2.0], 2.0), "a")
