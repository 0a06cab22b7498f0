# SPDX-License-Identifier: Apache-2.0
"""Every detector finds the target in a simulated frame."""

from __future__ import annotations

import pytest

from imgu_ros.config.parameters import declaration
from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.truth import corner_error

CHOICES = [{"keypoints.detector": name} for name in declaration("keypoints.detector").choices]


@pytest.mark.parametrize(
    "choice",
    [*CHOICES, {"keypoints.detector": "fast", "keypoints.fast_arc": 12}],
    ids=lambda choice: "-".join(map(str, choice.values())),
)
def test_the_target_is_found_with_every_detector(choice, target_images, one_target_frames):
    parameters = parameters_from({**choice, "tracking.enabled": False, "keypoints.max_count": 800})
    targets = prepare_references(target_images[:1], parameters)
    chain = Localizer(parameters, targets)
    for simulated in one_target_frames[:1]:
        result = chain.process(simulated.frame, with_keypoints=True)
        (found,) = result
        assert found.homography is not None, found.reason
        size = result.developed.grey.shape[1::-1]
        assert corner_error(found.homography.H, simulated.truths[0].H, targets[0].size, size) < 0.025


def test_the_arc_reaches_the_detector(target_images):
    found = []
    for arc in (9, 12):
        values = {"keypoints.detector": "fast", "keypoints.fast_arc": arc, "keypoints.max_count": 50}
        (target,) = prepare_references(target_images[:1], parameters_from(values))
        found.append({tuple(xy) for xy in target.features.described.keypoints.xy.tolist()})
    assert found[0] != found[1]
