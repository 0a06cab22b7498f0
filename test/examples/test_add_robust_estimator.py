# SPDX-License-Identifier: Apache-2.0
"""The worked example "a robust estimator" of CONTRIBUTING.md: least median of squares (Rousseeuw 1984), by OpenCV."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
import pytest

from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.result import Status
from imgu_ros.simulate.sequence import SimulatedFrame
from imgu_ros.simulate.truth import corner_error
from imgu_ros.types import Points
from imgu_ros.vision.estimation import Proposal, accepted
from imgu_ros.vision.methods import ESTIMATORS, EstimatorMethod, register_estimator
from imgu_ros.vision.projective import HomographyEstimator, HomographyModel, RobustHomography


@dataclass(frozen=True, slots=True)
class MedianParameters:
    """`min_inliers`: of an answer."""

    min_inliers: int = 8


def median_estimator(parameters: MedianParameters) -> HomographyEstimator:
    """Return the estimator with `parameters`."""
    return partial(estimate_by_median, parameters)


def estimate_by_median(
    parameters: MedianParameters,
    src: Points,
    dst: Points,
    threshold_px: float,
    rng: np.random.Generator | int,
    max_by_chance: float = 1e-3,
) -> RobustHomography:
    """Estimate H, and accept it by the rules of this package: enough inliers, and more than chance."""
    del rng  # OpenCV seeds this method itself, always alike
    model = HomographyModel(src, dst)
    H, mask = cv2.findHomography(src, dst, cv2.LMEDS)
    hypotheses = np.zeros((0, 3, 3)) if H is None else model.normalised(H, mask.ravel() != 0)
    consensus = accepted(
        model, Proposal(hypotheses, 2000), threshold_px, min_inliers=parameters.min_inliers, max_by_chance=max_by_chance
    )
    return RobustHomography(model.denormalised(consensus.hypothesis), consensus.inliers, 0)


MEDIAN = EstimatorMethod(
    name="least_median",
    make=median_estimator,
    parameters=MedianParameters,
    settings={"min_inliers": "homography.min_inliers"},
)


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    register_estimator(MEDIAN)
    yield
    del ESTIMATORS["least_median"]


@pytest.mark.parametrize("name", ["least_median", "usac_magsac"])
def test_it_finds_the_target(
    name: str, targets: tuple[Reference, ...], one_target_frames: tuple[SimulatedFrame, ...]
) -> None:
    parameters = parameters_from({"homography.estimator": name, "tracking.enabled": False})
    localizer = Localizer(parameters, targets[:1])
    for simulated in one_target_frames[:2]:
        result = localizer.process(simulated.frame)
        assert result.first.status is Status.DETECTED, result.first.reason
        size = result.developed.grey.shape[1::-1]
        assert corner_error(result.first.homography.H, simulated.truths[0].H, targets[0].size, size) < 0.3


def test_a_users_parameter_reaches_it(
    targets: tuple[Reference, ...], one_target_frames: tuple[SimulatedFrame, ...]
) -> None:
    values = {"homography.estimator": "least_median", "homography.min_inliers": 150, "search.thorough": False}
    result = Localizer(parameters_from(values), targets[:1]).process(one_target_frames[0].frame)
    assert result.first.status is Status.LOST
    assert "150 needed" in result.first.reason
