# SPDX-License-Identifier: Apache-2.0
"""Every way to estimate the homography works in the pipeline."""

from __future__ import annotations

import numpy as np
import pytest

from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.result import Status
from imgu_ros.simulate.sequence import SimulatedFrame
from imgu_ros.vision.projective.transform import transform


@pytest.mark.parametrize(
    "choice",
    [
        {"error": "algebraic"},
        {"error": "transfer"},
        {"error": "symmetric"},
        {"error": "reprojection"},
        {"refine": "none"},
        {"refine": "steepest_descent"},
        {"refine": "gauss_newton"},
        {"error": "reprojection", "refine": "steepest_descent"},
        {"score": "biweight"},
        {"sampler": "uniform", "score": "biweight"},
    ],
    ids=lambda choice: " ".join(choice.values()),
)
def test_found_to_a_few_pixels(
    choice: dict[str, str], one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...]
) -> None:
    options = {f"homography.{name}": value for name, value in choice.items()}
    chain = Localizer(parameters_from({"tracking.enabled": False, "refinement.enabled": False, **options}), targets[:1])
    for simulated in one_target_frames[:2]:
        found = chain.process(simulated.frame).first
        assert found.status is Status.DETECTED, found.reason
        corners = targets[0].outline_template
        error = transform(found.homography.H, corners) - transform(simulated.truths[0].H, corners)
        assert np.hypot(*error.T).mean() < 3
