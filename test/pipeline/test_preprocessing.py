# SPDX-License-Identifier: Apache-2.0
"""Steps before keypoints are sought, and the pipeline with each of them against simulated truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imgu_ros.config.parameters import Parameters, PreprocessParameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import DegenerateConfiguration, ParameterError
from imgu_ros.image.preprocessing import for_targets, preprocessed, with_edges
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import Stage, Status
from imgu_ros.simulate.sequence import SimulatedFrame
from imgu_ros.simulate.truth import corner_error
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.scale_space.pyramid import Level, Pyramid

Frames = tuple[SimulatedFrame, ...]

OFF = PreprocessParameters()


def test_off_is_free() -> None:
    grey = np.zeros((4, 4), np.uint8)
    pyramid = Pyramid((Level(grey, np.ones(2)),))
    assert preprocessed(grey, OFF) is grey
    assert with_edges(pyramid, OFF) is pyramid
    assert for_targets(OFF) == OFF


def test_steps_by_hand_and_in_order() -> None:
    grey = np.array([[0, 10, 100, 200, 255]], np.uint8)

    def after(**steps: object) -> list[int]:
        return preprocessed(grey, replace(OFF, **steps)).ravel().tolist()

    assert after(brightness=60.0) == [60, 70, 160, 255, 255]
    assert after(contrast=2.0, brightness=-20.0) == [0, 0, 180, 255, 255]
    assert after(gamma=0.5)[:1] == [0] and after(gamma=0.5)[2] == round(255 * (100 / 255) ** 0.5)
    assert after(threshold="fixed", threshold_value=100.0) == [0, 0, 255, 255, 255]
    # Otsu: halfway between 100 and 200 lies the best of the four places
    assert after(threshold="otsu") == [0, 0, 0, 255, 255]
    # Of four bins only their limits are tried, of which 128 lies in the middle of those that part 100 from 200.
    assert after(threshold="otsu", threshold_bins=4) == [0, 0, 0, 255, 255]
    assert after(threshold="otsu", threshold_bins=2, brightness=30.0) == [0, 0, 255, 255, 255]
    assert after(equalisation="global") == [0, 64, 128, 191, 255]
    # The threshold comes last: 10 * 10 reaches it.
    assert after(contrast=10.0, threshold="fixed", threshold_value=100.0) == [0, 255, 255, 255, 255]
    impulse = np.zeros((15, 15), np.uint8)
    impulse[7, 7] = 255
    assert 38 < preprocessed(impulse, replace(OFF, smoothing_px=1.0))[7, 7] < 43


def test_edges_are_slopes_of_every_level() -> None:
    ramp = np.tile(np.arange(0, 250, 10), (20, 1)).astype(np.uint8)
    pyramid = Pyramid((Level(ramp, np.ones(2)), Level(ramp[::2, ::2].copy(), np.full(2, 2.0))))
    fine, coarse = with_edges(pyramid, replace(OFF, edges="strength")).levels
    assert (fine.image[2:-2, 2:-2] == 40).all() and (coarse.image[2:-2, 2:-2] == 80).all()
    assert coarse.step.tolist() == [2, 2]


def test_a_fixed_threshold_is_the_frames() -> None:
    fixed = replace(OFF, threshold="fixed", threshold_value=50.0, gamma=0.7)
    assert for_targets(fixed) == for_targets(replace(fixed, threshold="otsu"))


#: Each one word (or number) away from the default; a threshold for the dim frames of the simulation.
CHANGES: tuple[dict[str, object], ...] = (
    {"preprocess.smoothing_px": 1.0},
    {"preprocess.contrast": 1.4},
    {"preprocess.brightness": 40.0},
    {"preprocess.gamma": 0.5},
    {"preprocess.equalisation": "global"},
    {"preprocess.equalisation": "clahe"},
    {"preprocess.edges": "strength"},
    {"preprocess.edges": "strength", "preprocess.derivative": "scharr"},
    {"preprocess.edges": "strength", "preprocess.derivative": "gaussian"},
    {"preprocess.threshold": "otsu"},
    {"preprocess.threshold": "otsu", "preprocess.threshold_bins": 32},
    {"preprocess.threshold": "fixed", "preprocess.threshold_value": 56.0},
    {"pyramid.kind": "coarse"},
    {"pyramid.kind": "laplacian"},
    {"pyramid.kernel": "discrete"},
    {"pyramid.kernel": "recursive"},
)


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: "-".join(str(v) for v in change.values()))
def test_the_target_is_found_with_each_change(
    change: dict[str, object], target_images: tuple[TargetImage, ...], one_target_frames: Frames
) -> None:
    parameters = parameters_from({"tracking.enabled": False, **change})
    targets = prepare_references(target_images[:1], parameters)
    chain = Localizer(parameters, targets)
    for simulated in one_target_frames[:8:7]:
        result = chain.process(simulated.frame)
        found = result.first.homography
        assert found is not None, result.first.reason
        size = result.developed.grey.shape[1::-1]
        # Alignment works on the picture as it was: it is as precise as ever.
        assert corner_error(found.H, simulated.truths[0].H, targets[0].size, size, None) < 0.04


def test_alignment_and_published_pictures_are_untouched(
    target_images: tuple[TargetImage, ...], one_target_frames: Frames
) -> None:
    parameters = parameters_from({"preprocess.threshold": "otsu"})
    chain = Localizer(parameters, prepare_references(target_images[:1], parameters))
    first, second = (chain.process(f.frame) for f in one_target_frames[:2])
    assert len(np.unique(first.developed.grey)) > 50
    assert second.first.status is Status.TRACKED and Stage.PYRAMID not in second.times_ns


def test_a_frame_without_two_values_is_rejected_with_the_reason(
    target_images: tuple[TargetImage, ...], one_target_frames: Frames
) -> None:
    parameters = parameters_from({"preprocess.threshold": "otsu"})
    with pytest.raises(DegenerateConfiguration, match="one value"):
        preprocessed(np.full((4, 4), 7, np.uint8), parameters.preprocess)
    chain = Localizer(parameters, prepare_references(target_images[:1], parameters))
    flat = RawImage(np.full((480, 640), 7, np.uint8), PixelLayout(ColorModel.MONO))
    result = chain.process(replace(one_target_frames[0].frame, image=flat))
    assert result.first.status is Status.REJECTED and "one value" in result.reason


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"pyramid.kind": "laplacian", "keypoints.detector": "dog"}, "pyramid.kind"),
        ({"preprocess.edges": "strength", "keypoints.detector": "dog"}, "preprocess.edges"),
        ({"preprocess.edges": "strength", "preprocess.threshold": "otsu"}, "preprocess.threshold"),
    ],
)
def test_what_cannot_work_together_is_refused_at_start(values: dict[str, object], name: str) -> None:
    with pytest.raises(ParameterError, match=rf"^{name}: [^\n]+need[^\n]+$"):
        parameters_from(values)
    assert Parameters().preprocess == OFF
