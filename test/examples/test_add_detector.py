# SPDX-License-Identifier: Apache-2.0
"""The worked example "a detector" of CONTRIBUTING.md: the good features to track of Shi & Tomasi (1994)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
import pytest

from imgu_ros.config.parameters import declaration
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError, ShapeError
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.sequence import SimulatedFrame
from imgu_ros.simulate.truth import corner_error
from imgu_ros.types import Image
from imgu_ros.vision.keypoints import Corners, centroid_orientation
from imgu_ros.vision.methods import DETECTORS, DetectorMethod, register_detector


@dataclass(frozen=True, slots=True)
class ShiTomasiParameters:
    """`quality`: smallest response, as a share of the strongest; `distance_px`: between corners."""

    quality: float = 0.005
    distance_px: float = 4.0


def shi_tomasi_detector(parameters: ShiTomasiParameters) -> Callable[[Image, int], Corners]:
    """Return the detector with `parameters`."""
    return partial(detect_shi_tomasi, parameters)


def detect_shi_tomasi(parameters: ShiTomasiParameters, image: Image, max_count: int) -> Corners:
    """Detect corners by the smaller eigenvalue of the structure tensor."""
    found = cv2.goodFeaturesToTrack(image, max_count, parameters.quality, parameters.distance_px)
    xy = np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)
    strongest_first = -np.arange(len(xy), dtype=np.float64)
    return Corners(xy, np.full(len(xy), 1.5), centroid_orientation(image, xy), strongest_first)


SHI_TOMASI = DetectorMethod(name="shi_tomasi", make=shi_tomasi_detector, parameters=ShiTomasiParameters)


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    register_detector(SHI_TOMASI)
    yield
    del DETECTORS["shi_tomasi"]


def test_it_finds_the_target(
    target_images: tuple[TargetImage, ...], one_target_frames: tuple[SimulatedFrame, ...]
) -> None:
    parameters = parameters_from({"keypoints.detector": "shi_tomasi", "tracking.enabled": False})
    targets = prepare_references(target_images[:1], parameters)
    result = Localizer(parameters, targets).process(one_target_frames[0].frame)
    assert result.first.homography is not None, result.first.reason
    truth, size = one_target_frames[0].truths[0].H, result.developed.grey.shape[1::-1]
    assert corner_error(result.first.homography.H, truth, targets[0].size, size) < 0.3


def test_users_choose_it_by_name() -> None:
    assert "shi_tomasi" in declaration("keypoints.detector").choices
    with pytest.raises(ParameterError, match=r"need one of fast, .*, shi_tomasi \(nearest: shi_tomasi\)$"):
        parameters_from({"keypoints.detector": "shi_tomas"})


def test_a_name_is_given_once() -> None:
    with pytest.raises(ShapeError, match=r"^shi_tomasi: already registered; need another name$"):
        register_detector(SHI_TOMASI)
