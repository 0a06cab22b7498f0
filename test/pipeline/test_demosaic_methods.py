# SPDX-License-Identifier: Apache-2.0
"""`demosaic.method` in the pipeline: every method finds the target in Bayer frames of 8 and 16 bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imgu_ros.config.parameters import declaration
from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.simulate.sequence import SimulatedFrame
from imgu_ros.simulate.truth import corner_error
from imgu_ros.vision.formation.demosaic import demosaic


@pytest.mark.parametrize("deep", [False, True])
@pytest.mark.parametrize("method", declaration("demosaic.method").choices)
def test_every_method_finds_every_frame(
    method: str, deep: bool, one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...]
) -> None:
    chain = Localizer(parameters_from({"demosaic.method": method, "raw.significant_bits": 16}), targets[:1])
    for simulated in one_target_frames[:3]:
        frame = simulated.frame
        if deep:
            pixels = frame.image.pixels.astype(np.uint16) * 257
            frame = replace(frame, image=replace(frame.image, pixels=pixels))
        result = chain.process(frame)
        homography = result.first.homography
        assert homography is not None, result.first.reason
        size = result.developed.grey.shape[1::-1]
        assert corner_error(homography.H, simulated.truths[0].H, targets[0].size, size, None) < 0.025
        color = demosaic(frame.image.pixels, frame.image.layout.pattern, method)
        np.testing.assert_array_equal(result.developed.color(), color)
