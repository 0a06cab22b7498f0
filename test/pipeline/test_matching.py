# SPDX-License-Identifier: Apache-2.0
"""Every descriptor, metric and guided matching in the pipeline, on a short simulated sequence."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from numpy.typing import NDArray

from imgu_ros.config.parameters import MatchingParameters, Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.detect.features import Features
from imgu_ros.detect.robust_fit import LocatedMatches
from imgu_ros.detect.search_passes import guided
from imgu_ros.errors import ParameterError
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.pose.planar_pose import Located
from imgu_ros.reference.templates import TargetImage, grey_template
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import Status
from imgu_ros.simulate.sequence import SimulatedFrame, Simulation, simulate_sequence
from imgu_ros.vision.descriptors.describe import Descriptions
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

OFF = {"tracking.enabled": False, "refinement.enabled": False}


def corner_error(estimated: NDArray[np.float64], true: NDArray[np.float64], outline: NDArray[np.float64]) -> float:
    corners = np.column_stack((outline, np.ones(4)))
    a, b = (corners @ H.T for H in (estimated, true))
    return float(np.linalg.norm(a[:, :2] / a[:, 2:] - b[:, :2] / b[:, 2:], axis=1).mean())


@pytest.fixture(scope="module")
def upright_frame(target_images: tuple[TargetImage, ...]) -> SimulatedFrame:
    """The last of six frames that the target fills, hardly turned, as BRIEF and SSD need it."""
    sequence = simulate_sequence(Simulation(width=640, height=480, frames=60, seed=3), target_images[:1])
    return next(islice(sequence, 50, None))


@pytest.mark.parametrize(
    "values",
    [
        {"descriptor.kind": "orb", "matching.metric": "hamming"},
        {"descriptor.kind": "brief"},
        {"descriptor.kind": "sift", "matching.metric": "cosine"},
        {"descriptor.kind": "rootsift", "matching.metric": "euclidean"},
        {"descriptor.kind": "patch"},
        {"descriptor.kind": "patch", "matching.metric": "zmssd"},
        {"descriptor.kind": "patch", "matching.metric": "ncc", "matching.guided": True},
        {"descriptor.kind": "brief", "matching.guided": True},
        {"matching.guided": True},
    ],
    ids=lambda values: "-".join(str(value) for value in values.values()),
)
def test_every_choice_finds_the_target(
    values: dict[str, object], target_images: tuple[TargetImage, ...], upright_frame: SimulatedFrame
) -> None:
    parameters = parameters_from(OFF | values)
    chain = Localizer(parameters, prepare_references(target_images[:1], parameters))
    result = chain.process(upright_frame.frame).first
    assert result.status is Status.DETECTED and result.homography is not None
    outline = chain.references[0].outline_template
    assert corner_error(result.homography.H, upright_frame.truths[0].H, outline) < 2.0


def test_ssd_finds_a_target_of_unchanged_brightness(target_images: tuple[TargetImage, ...]) -> None:
    """The picture itself as the frame: sums of squared differences know no other brightness."""
    parameters = parameters_from(OFF | {"descriptor.kind": "patch", "matching.metric": "ssd"})
    targets = prepare_references(target_images[:1], parameters)
    grey = grey_template(target_images[0].pixels, parameters.raw.grey_weights)
    frame = Frame(RawImage(grey, PixelLayout(ColorModel.MONO)), 0, "camera", None)
    result = Localizer(parameters, targets).process(frame).first
    assert result.homography is not None
    assert corner_error(result.homography.H, np.eye(3), targets[0].outline_template) < 0.5


def test_senseless_parameters_are_refused_at_start(target_images: tuple[TargetImage, ...]) -> None:
    """Also when nobody made them by `parameters_from`, which refuses them itself."""
    parameters = replace(Parameters(), matching=MatchingParameters(metric="cosine"))
    with pytest.raises(ParameterError, match=r"^matching.metric: 'cosine' conflicts .+; need auto or hamming$"):
        prepare_references(target_images[:1], parameters)


def test_guided_matching_brings_more_inliers(
    target_images: tuple[TargetImage, ...], one_target_frames: tuple[SimulatedFrame, ...]
) -> None:
    plain, more = (
        Localizer(p, prepare_references(target_images[:1], p))
        for p in (parameters_from(OFF | {"matching.guided": value}) for value in (False, True))
    )
    for simulated in one_target_frames[::4]:
        a, b = (chain.process(simulated.frame).first for chain in (plain, more))
        assert a.matches is not None and b.matches is not None and b.homography is not None
        assert b.matches.inliers.sum() > 1.3 * a.matches.inliers.sum()
        assert len(b.matches.inliers) == len(b.matches.matches) == len(b.matches.template_xy)
        assert corner_error(b.homography.H, simulated.truths[0].H, plain.references[0].outline_template) < 2.0
        keypoints = more.process(simulated.frame, with_keypoints=True).keypoints
        assert keypoints is not None
        np.testing.assert_array_equal(keypoints.xy[b.matches.matches.index_dst], b.matches.image_xy)


def test_guided_matching_that_brings_no_more_changes_nothing(
    target_images: tuple[TargetImage, ...], upright_frame: SimulatedFrame
) -> None:
    parameters = parameters_from(OFF)
    target = prepare_references(target_images[:1], parameters)[0]
    chain = Localizer(parameters, [target])
    result = chain.process(upright_frame.frame, with_keypoints=True)
    found = result.first
    assert found.matches is not None and found.homography is not None
    assert result.keypoints is not None and result.descriptors is not None
    nowhere = replace(result.keypoints, xy=result.keypoints.xy + 1e5)
    before = LocatedMatches(
        found.matches, Located(found.matches.template_xy, found.matches.image_xy, found.homography, None)
    )
    assert result.pyramid is not None
    features = Features(result.pyramid, Descriptions(nowhere, result.descriptors))
    assert guided(target, target.features, features, before, None, Parameters()) is before
