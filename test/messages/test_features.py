# SPDX-License-Identifier: Apache-2.0
"""What one stage tells another arrives as it was told; what cannot be meant is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.bags.messages import make_message
from imgu_ros.errors import EncodingError
from imgu_ros.messages.features import (
    HOMOGRAPHY_DTYPE,
    MATCH_DTYPE,
    decode_estimates,
    decode_keypoints,
    decode_sharp,
    decode_target_matches,
    homographies_message,
    keypoints_message,
    matches_message,
)
from imgu_ros.messages.header import Header
from imgu_ros.messages.point_cloud import point_cloud_message
from imgu_ros.result import ReferenceMatches, ReferenceResult, Status
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.projective.homography import HomographyEstimate

HEADER = Header(1_500_000_000, "camera")
FLOATS = st.floats(-1e6, 1e6, width=32)


def rows(draw, count: int, columns: int):
    return np.array(draw(st.lists(FLOATS, min_size=count * columns, max_size=count * columns))).reshape(count, columns)


@st.composite
def target_results(draw):
    indices = draw(st.lists(st.integers(0, 50), min_size=0, max_size=4, unique=True))
    results = []
    for index in indices:
        count = draw(st.integers(1, 5))
        none = np.full(count, -1, np.intp)
        matches = ReferenceMatches(
            Matches(none, none, rows(draw, count, 1).ravel()),
            rows(draw, count, 2),
            rows(draw, count, 2),
            np.array(draw(st.lists(st.booleans(), min_size=count, max_size=count))),
        )
        results.append(ReferenceResult(f"t{index}", index, Status.LOST, matches=matches))
    return results


@given(target_results())
def test_matches_arrive_in_the_order_in_which_they_were_told(results):
    found = decode_target_matches(matches_message(make_message, HEADER, results))
    assert list(found) == [result.number for result in results]
    for result in results:
        got, sent = found[result.number], result.matches
        np.testing.assert_array_equal(got.template_xy, sent.template_xy)
        np.testing.assert_array_equal(got.image_xy, sent.image_xy)
        np.testing.assert_array_equal(got.matches.distance, sent.matches.distance)
        np.testing.assert_array_equal(got.inliers, sent.inliers)
        assert (got.matches.index_src == -1).all()


@given(st.data())
def test_keypoints_at_places_of_single_precision_arrive_as_they_were(data):
    count = data.draw(st.integers(0, 5))
    columns = rows(data.draw, count, 5)
    keypoints = Keypoints(columns[:, :2], *columns[:, 2:].T, np.arange(count, dtype=np.int32))
    binary = data.draw(st.booleans())
    width = data.draw(st.sampled_from([1, 32, 128]))
    descriptors = (rows(data.draw, count, 1) * np.ones(width)).astype(np.uint8 if binary else np.float32)
    got, told = decode_keypoints(keypoints_message(make_message, HEADER, keypoints, descriptors))
    np.testing.assert_array_equal(told, descriptors)
    assert told.dtype == descriptors.dtype
    for name in ("xy", "scale", "angle", "response", "octave"):
        np.testing.assert_array_equal(getattr(got, name), getattr(keypoints, name))


@given(st.integers(0, 2**32 - 1))
def test_homographies_arrive_as_they_were(seed):
    generator = np.random.default_rng(seed)
    results, counts = [], {}
    for index in range(3):
        H = np.eye(3) + 0.1 * generator.normal(size=(3, 3))
        inliers = np.ones(int(generator.integers(4, 200)), bool)
        estimate = HomographyEstimate(H, generator.normal(size=(9, 9)), inliers, 0.5, 7)
        results.append(ReferenceResult(f"t{index}", index, Status.DETECTED, homography=estimate))
        counts[index] = len(inliers)
    found = decode_estimates(homographies_message(make_message, HEADER, results, calibrated=True), counts)
    for result in results:
        got, sent = found[result.number], result.homography
        np.testing.assert_array_equal(got.H, sent.H)
        np.testing.assert_array_equal(got.covariance, sent.covariance)
        assert (got.inliers.sum(), got.rms_px) == (sent.inliers.sum(), sent.rms_px)
    counts.pop(1)
    assert list(decode_estimates(homographies_message(make_message, HEADER, results, calibrated=True), counts)) == [
        0,
        2,
    ]


def test_of_homographies_that_say_nothing_of_it_none_is_sharp():
    estimate = HomographyEstimate(np.eye(3), np.eye(9), np.ones(4, bool), 0.5, 7)
    results = [
        ReferenceResult(f"t{index}", index, Status.DETECTED, homography=estimate, is_sharp=index == 1)
        for index in range(3)
    ]
    message = homographies_message(make_message, HEADER, results, calibrated=True)
    assert decode_sharp(message) == {1}
    message.fields = [field for field in message.fields if field.name != "sharp"]
    assert decode_sharp(message) == set()


def homography_table(**changes):
    table = np.zeros(1, HOMOGRAPHY_DTYPE)
    table["h"] = np.eye(3).ravel()
    for name, value in changes.items():
        table[name] = value
    return table


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"h": np.nan}, "need 9 + 81, finite"),
        ({"covariance": np.inf}, "need 9 + 81, finite"),
        ({"h": np.diag([-1.0, 1, 1]).ravel()}, "determinant -1"),
        ({"h": 0.0}, "determinant 0"),
        ({"rms_px": np.nan}, "need > 0 and >= 0"),
    ],
)
def test_homographies_that_are_none_are_refused(changes, says):
    message = point_cloud_message(make_message, HEADER, homography_table(**changes))
    with pytest.raises(EncodingError, match=re.escape(says)):
        decode_estimates(message, {0: 4})


def test_matches_that_are_none_are_refused():
    table = np.zeros(2, MATCH_DTYPE)
    table["image_x"][1] = np.nan
    with pytest.raises(EncodingError, match="need finite numbers"):
        decode_target_matches(point_cloud_message(make_message, HEADER, table))
    wide = np.zeros(1, [(name, "f4", (2,)) for name in MATCH_DTYPE.names])
    with pytest.raises(EncodingError, match="need one"):
        decode_target_matches(point_cloud_message(make_message, HEADER, wide))
    with pytest.raises(EncodingError, match="need target"):
        decode_target_matches(point_cloud_message(make_message, HEADER, np.zeros(1, [("x", "f4")])))
