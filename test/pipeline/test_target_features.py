# SPDX-License-Identifier: Apache-2.0
"""What frames are matched to: where the keypoints of every kind of view lie, and when they are made."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.reference.features import (
    FeaturesOnDemand,
    TargetFeatures,
    close_features,
    description_options,
    target_features,
    thorough_features,
)
from imgu_ros.types import Image
from imgu_ros.vision.descriptors.extractor import make_extractor
from imgu_ros.vision.matching.nearest import match_to_gallery

VIEWS = (target_features, close_features, thorough_features)
OPTIONS = description_options(Parameters())
EXTRACTOR = make_extractor(OPTIONS.extractor)


@pytest.fixture(scope="module")
def grey() -> Image:
    """A textured rectangle, x 80 to 399 and y 60 to 299, on a flat ground of 480 x 360."""
    picture = np.full((360, 480), 100, np.uint8)
    texture = np.random.default_rng(2).integers(0, 256, (24, 32), np.uint8)
    picture[60:300, 80:400] = cv2.resize(texture, (320, 240), interpolation=cv2.INTER_CUBIC)
    return picture


@pytest.mark.parametrize("make", VIEWS)
def test_keypoints_lie_where_the_texture_is(make: Callable[..., TargetFeatures], grey: Image) -> None:
    keypoints = make(grey, OPTIONS, EXTRACTOR).described.keypoints
    fine = keypoints.xy[keypoints.scale <= 1.5 * keypoints.scale.min()]
    assert (fine >= (80 - 4, 60 - 4)).all() and (fine <= (399 + 4, 299 + 4)).all()
    assert_allclose(fine.min(axis=0), (80, 60), atol=12)
    assert_allclose(fine.max(axis=0), (399, 299), atol=12)


@pytest.mark.parametrize("make", VIEWS)
def test_a_turned_picture_has_its_keypoints_turned(make: Callable[..., TargetFeatures], grey: Image) -> None:
    """By half a turn: nothing moves on the way, be it enlarged, reduced, or turned away."""
    a, b = (make(picture, OPTIONS, EXTRACTOR) for picture in (grey, np.ascontiguousarray(grey[::-1, ::-1])))
    found = match_to_gallery(a.described.descriptors, b.gallery, ratio=0.7)
    assert len(found) >= 100
    between = a.described.keypoints.xy[found.index_src] + b.described.keypoints.xy[found.index_dst] - (479, 359)
    assert np.mean(np.abs(between).max(axis=1) < 2) > 0.9
    assert_allclose(np.median(between, axis=0), 0, atol=0.11)


def test_close_features_are_dense_at_fine_scales(grey: Image) -> None:
    """Those of a first look are spread over all scales."""
    first, close = (make(grey, OPTIONS, EXTRACTOR).described.keypoints for make in (target_features, close_features))
    assert np.count_nonzero(close.scale < 2.2) > 5 * np.count_nonzero(first.scale < 2.2)
    assert close.scale.max() < 0.5 * first.scale.max()
    # Twice as fine as the picture's own pixels allow.
    assert close.scale.min() == pytest.approx(first.scale.min() / 2, rel=0.01)


@pytest.mark.parametrize("detector", ["dog", "mser"])
def test_what_finds_every_scale_by_itself_is_given_no_larger_picture(detector: str, grey: Image) -> None:
    kinds = description_options(parameters_from({"keypoints.detector": detector, "descriptor.kind": "sift"}))
    first, close = (
        make(grey, kinds, make_extractor(kinds.extractor)).described.keypoints
        for make in (target_features, close_features)
    )
    assert len(close) >= len(first) > 0
    assert close.scale.min() == pytest.approx(first.scale.min(), rel=0.2)


def test_a_large_picture_is_not_enlarged() -> None:
    """It has pixels for the closest view already."""
    texture = np.random.default_rng(3).integers(0, 256, (30, 50), np.uint8)
    picture = np.kron(texture, np.ones((40, 40), np.uint8))
    keypoints = close_features(picture, OPTIONS, EXTRACTOR).described.keypoints
    assert keypoints.scale.min() >= 1.5
    assert (keypoints.xy > -0.5).all() and (keypoints.xy < (1999.5, 1199.5)).all()


def test_on_demand_they_are_made_once(grey: Image) -> None:
    made = []

    def make() -> TargetFeatures:
        made.append(target_features(grey, OPTIONS, EXTRACTOR))
        return made[-1]

    features = FeaturesOnDemand(make)
    assert not made
    assert features.features() is features.features() is made[0]
    assert len(made) == 1
