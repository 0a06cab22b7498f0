# SPDX-License-Identifier: Apache-2.0
"""The pipeline against simulated truth."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import PoseStatus, Result, Stage, Status
from imgu_ros.simulate.sequence import SimulatedFrame, Simulation, default_camera, default_targets, simulate_sequence
from imgu_ros.simulate.truth import corner_error
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

Frames = tuple[SimulatedFrame, ...]
Targets = tuple[Reference, ...]


def errors(frames: Frames, results: list[Result], targets: Targets) -> list[float]:
    out = []
    for simulated, result in zip(frames, results, strict=True):
        for truth in simulated.truths:
            found = next(t for t in result if t.name == truth.target)
            assert found.homography is not None, found.reason
            size = result.developed.grey.shape[1::-1]
            target = next(t for t in targets if t.name == truth.target)
            camera = simulated.frame.camera
            lens = camera if camera is not None and camera.is_distorted else None
            out.append(corner_error(found.homography.H, truth.H, target.size, size, lens))
    return out


@pytest.mark.parametrize("tracking", [True, False])
def test_every_frame_is_found(one_target_frames: Frames, targets: Targets, tracking: bool) -> None:
    """How exactly: test/guards."""
    chain = Localizer(parameters_from({"tracking.enabled": tracking}), targets[:1])
    results = [chain.process(f.frame) for f in one_target_frames]
    expected = [Status.DETECTED] + [Status.TRACKED if tracking else Status.DETECTED] * 11
    assert [r.first.status for r in results] == expected


def test_detection_without_refinement_is_already_good(one_target_frames: Frames, targets: Targets) -> None:
    chain = Localizer(parameters_from({"tracking.enabled": False, "refinement.enabled": False}), targets[:1])
    results = [chain.process(f.frame) for f in one_target_frames]
    assert np.median(errors(one_target_frames, results, targets)) < 0.65
    assert all(Stage.REFINE not in r.times_ns for r in results)


def test_several_targets(two_target_frames: Frames, targets: Targets) -> None:
    chain = Localizer(parameters_from({}), targets)
    results = [chain.process(f.frame) for f in two_target_frames]
    assert all([t.name for t in r] == [t.name for t in targets] for r in results)
    assert max(errors(two_target_frames, results, targets)) < 0.06


@pytest.mark.parametrize("pattern", list(BayerPattern))
@pytest.mark.parametrize("method", ["bilinear", "malvar"])
def test_every_bayer_phase(
    target_images: tuple[TargetImage, ...], targets: Targets, pattern: BayerPattern, method: str
) -> None:
    layout = PixelLayout(ColorModel.BAYER, pattern)
    frames = tuple(
        simulate_sequence(Simulation(width=640, height=480, frames=2, seed=3, layout=layout), target_images[:1])
    )
    chain = Localizer(parameters_from({"demosaic.method": method}), targets[:1])
    assert max(errors(frames, [chain.process(f.frame) for f in frames], targets)) < 0.025


@pytest.mark.parametrize(
    "lens", [("plumb_bob", (-0.26, 0.09, 0.0008, -0.0005, -0.01)), ("equidistant", (-0.03, 0.008, -0.004, 0.001))]
)
def test_lenses_are_respected(target_images: tuple[TargetImage, ...], targets: Targets, lens: tuple) -> None:
    camera = default_camera(640, 480, *lens)
    frames = tuple(
        simulate_sequence(Simulation(width=640, height=480, frames=4, seed=3, camera=camera), target_images[:1])
    )
    chain = Localizer(parameters_from({}), targets[:1])
    results = [chain.process(f.frame) for f in frames]
    assert max(errors(frames, results, targets)) < 0.025
    for simulated, result in zip(frames, results, strict=True):
        truth = simulated.truths[0].pose
        assert np.linalg.norm(result.first.pose.t - truth.t) < 2e-4 * np.linalg.norm(truth.t)


def test_same_frames_same_numbers(one_target_frames: Frames, targets: Targets) -> None:
    runs = []
    for _ in range(2):
        chain = Localizer(parameters_from({}), targets[:1])
        runs.append([chain.process(f.frame).first for f in one_target_frames])
    for a, b in zip(*runs, strict=True):
        assert np.array_equal(a.homography.H, b.homography.H)
        assert np.array_equal(a.pose.covariance, b.pose.covariance)


def test_a_skipped_frame_changes_no_other_frames_detection(one_target_frames: Frames, targets: Targets) -> None:
    p = parameters_from({"tracking.enabled": False})
    whole = [Localizer(p, targets[:1]).process(f.frame).first.homography.H for f in one_target_frames[:4]]
    chain = Localizer(p, targets[:1])
    assert np.array_equal(chain.process(one_target_frames[3].frame).first.homography.H, whole[3])
    assert np.array_equal(chain.process(one_target_frames[1].frame).first.homography.H, whole[1])


def test_a_frame_without_the_target_is_lost_and_the_next_one_found(one_target_frames: Frames, targets: Targets) -> None:
    chain = Localizer(parameters_from({}), targets[:1])
    first = one_target_frames[0].frame
    noise = np.random.default_rng(0).integers(0, 255, (480, 640), dtype=np.uint8)
    for empty in (noise, np.zeros_like(noise), np.full_like(noise, 255)):
        assert chain.process(first).first.status.found
        lost = chain.process(replace(first, image=RawImage(empty, first.image.layout))).first
        assert lost.status is Status.LOST
        assert lost.reason
        assert lost.homography is None
        assert lost.pose is None
        assert chain.process(one_target_frames[1].frame).first.status is Status.DETECTED
    assert lost.reason == "not in view, too small, blurred or covered (0 matches, 8 needed)"  # of the blank frame


def test_stamps_that_jump_back_begin_anew(one_target_frames: Frames, targets: Targets) -> None:
    """A recording played in a loop gives the same numbers in every round; two frames swapped are no new recording."""
    chain = Localizer(Parameters(), targets[:1])
    slow = [replace(f.frame, stamp_ns=i * 400_000_000) for i, f in enumerate(one_target_frames[:6])]
    rounds = [[chain.process(frame).first for frame in slow] for _ in range(2)]
    assert [t.status for t in rounds[0]] == [Status.DETECTED] + [Status.TRACKED] * 5
    for first, again in zip(*rounds, strict=True):
        assert again.status is first.status
        assert np.array_equal(again.homography.H, first.homography.H)
    chain.process(replace(slow[5], stamp_ns=slow[5].stamp_ns + 1))
    assert chain.process(slow[5]).first.status is Status.TRACKED


def test_a_jump_is_detected_again_in_the_same_frame(one_target_frames: Frames, targets: Targets) -> None:
    chain = Localizer(parameters_from({}), targets[:1])
    chain.process(one_target_frames[0].frame)
    result = chain.process(one_target_frames[11].frame)
    assert result.first.status.found
    assert errors(one_target_frames[11:], [result], targets)[0] < 0.05


def test_uncalibrated_and_unsized(
    one_target_frames: Frames, targets: Targets, target_images: tuple[TargetImage, ...]
) -> None:
    frame = one_target_frames[0].frame
    result = Localizer(parameters_from({}), targets[:1]).process(replace(frame, camera=None)).first
    assert result.status is Status.DETECTED
    assert (result.pose, result.pose_status) == (None, PoseStatus.UNCALIBRATED)
    unsized = prepare_references([replace(target_images[0], width_m=0.0)], parameters_from({}))
    result = Localizer(parameters_from({}), unsized).process(frame).first
    assert (result.pose, result.pose_status) == (None, PoseStatus.NO_SIZE)


def test_pose_scales_with_the_width(
    one_target_frames: Frames, targets: Targets, target_images: tuple[TargetImage, ...]
) -> None:
    frame = one_target_frames[0].frame
    small = Localizer(parameters_from({}), targets[:1]).process(frame).first.pose
    images = [replace(target_images[0], width_m=2 * target_images[0].width_m)]
    large = Localizer(parameters_from({}), prepare_references(images, parameters_from({}))).process(frame).first.pose
    assert_allclose(large.t, 2 * small.t, rtol=1e-6)
    assert_allclose(large.R, small.R, atol=1e-6)


def test_a_frame_that_cannot_be_worked_on_is_rejected(targets: Targets) -> None:
    camera = make_camera(np.eye(3), (), "plumb_bob", 4, 4)
    bands = RawImage(np.zeros((4, 4, 3), np.float64), PixelLayout(ColorModel.BANDS))
    p = parameters_from({"raw.bands": [7]})
    result = Localizer(p, targets).process(Frame(bands, 5, "camera", camera))
    assert "raw.bands" in result.reason
    assert [t.status for t in result] == [Status.REJECTED] * 2


@pytest.mark.parametrize("shape", [(2, 2), (1, 640), (31, 31), (480, 40)])
def test_tiny_frames_are_lost_not_fatal(targets: Targets, shape: tuple[int, int]) -> None:
    pixels = np.random.default_rng(0).integers(0, 255, shape, dtype=np.uint8)
    for layout in (PixelLayout(ColorModel.MONO), PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)):
        result = Localizer(parameters_from({}), targets[:1]).process(Frame(RawImage(pixels, layout), 0, "c", None))
        assert result.first.status in (Status.LOST, Status.REJECTED)
        assert result.first.reason


def test_keypoints_on_demand(one_target_frames: Frames, targets: Targets) -> None:
    chain = Localizer(parameters_from({}), targets[:1])
    chain.process(one_target_frames[0].frame)
    assert chain.process(one_target_frames[1].frame).keypoints is None
    result = chain.process(one_target_frames[2].frame, with_keypoints=True)
    assert result.first.status is Status.TRACKED
    assert len(result.keypoints) == len(result.descriptors) > 100


def test_missing_targets_are_looked_for_now_and_then(one_target_frames: Frames, targets: Targets) -> None:
    chain = Localizer(parameters_from({"tracking.search_every": 3}), targets)
    searched = [Stage.MATCH in chain.process(f.frame).times_ns for f in one_target_frames[:9]]
    assert searched == [True, False, False, True, False, False, True, False, False]


def test_a_target_that_turns_by_18_degrees_a_frame_is_tracked() -> None:
    """Too far to be followed from one sighting; two detections tell how it moves."""
    images = default_targets(1)
    chain = Localizer(Parameters(), prepare_references(images, Parameters()))
    frames = list(islice(simulate_sequence(Simulation(width=640, height=480, frames=20), images), 5))
    statuses = [chain.process(simulated.frame).first.status for simulated in frames]
    assert statuses == [Status.DETECTED] * 2 + [Status.TRACKED] * 3
    # Also when no frame has a stamp: they count as evenly spaced.
    chain.reset()
    unstamped = [chain.process(replace(s.frame, stamp_ns=0)).first.status for s in frames]
    assert unstamped == statuses
    # After a pause nothing is known of the motion any more.
    late = [replace(simulated.frame, stamp_ns=simulated.frame.stamp_ns + 10**10) for simulated in frames]
    chain.reset()
    assert chain.process(frames[0].frame).first.status is Status.DETECTED
    assert chain.process(late[1]).first.status is Status.DETECTED
    assert chain.process(late[2]).first.status is Status.DETECTED
    assert chain.process(late[3]).first.status is Status.TRACKED


def test_frames_without_stamps_are_tracked(one_target_frames: Frames, targets: Targets) -> None:
    """They count as evenly spaced: a camera that turns fast is followed all the same, as exactly."""
    stamped, none = Localizer(Parameters(), targets), Localizer(Parameters(), targets)
    for index, simulated in enumerate(one_target_frames[:8]):
        expected = stamped.process(simulated.frame).first
        result = none.process(replace(simulated.frame, stamp_ns=0)).first
        assert result.status is (Status.TRACKED if index else Status.DETECTED)
        assert expected.homography is not None and result.homography is not None
        size = simulated.frame.image.pixels.shape[1::-1]
        assert corner_error(result.homography.H, expected.homography.H, targets[0].size, size) < 0.01


def test_one_frame_without_a_stamp_costs_no_track(one_target_frames: Frames, targets: Targets) -> None:
    """As some simulators send it now and then."""
    chain = Localizer(Parameters(), targets[:1])
    frames = [replace(s.frame, stamp_ns=0 if i == 4 else s.frame.stamp_ns) for i, s in enumerate(one_target_frames)]
    statuses = [chain.process(frame).first.status for frame in frames]
    expected = [Status.TRACKED] * len(frames)
    expected[0] = expected[4] = Status.DETECTED
    assert statuses == expected


def test_a_print_is_compared_as_the_sensor_sees_it() -> None:
    """The simulated sensor is linear, as a raw one, and the targets' pictures are sRGB: said so, errors are smaller."""
    images = default_targets(1)
    frames = list(islice(simulate_sequence(Simulation(width=1280, height=720, frames=60), images), 0, 60, 6))
    median = {}
    for transfer in ("auto", "linear", "srgb"):
        parameters = parameters_from({"tracking.enabled": False, "raw.transfer": transfer})
        targets = prepare_references(images, parameters)
        chain = Localizer(parameters, targets)
        results = [chain.process(simulated.frame) for simulated in frames]
        median[transfer] = np.median(errors(tuple(frames), results, targets))
    # By how much depends on how exactly OpenCV interpolates: by a third with 5.0, by a twentieth with 4.6.
    assert median["auto"] == median["linear"] < 0.98 * median["srgb"]
    assert median["srgb"] < 0.045


def test_two_cameras_in_turn_are_each_tracked(one_target_frames: Frames, targets: Targets) -> None:
    """The same numbers as each alone: one looks at the target from the other end of the way."""
    left = [f.frame for f in one_target_frames]
    right = [
        replace(f.frame, stamp_ns=mine.stamp_ns, frame_id="right")
        for f, mine in zip(reversed(one_target_frames), left, strict=True)
    ]
    chain, alone = Localizer(Parameters(), targets[:1]), [Localizer(Parameters(), targets[:1]) for _ in range(2)]
    for frames in zip(left, right, strict=True):
        for frame, single in zip(frames, alone, strict=True):
            got, expected = chain.process(frame).first, single.process(frame).first
            assert got.status is expected.status
            assert got.homography is not None and expected.homography is not None
            assert_allclose(got.homography.H, expected.homography.H, rtol=0, atol=0)
    for number in range(100):
        chain.process(replace(left[0], frame_id=f"camera {number}"))
    assert len(chain._cameras) == 8


def test_a_frame_without_a_stamp_brings_back_no_track_of_a_reference_that_is_gone(
    target_images: tuple[TargetImage, ...], two_target_frames: Frames
) -> None:
    """Nor does what another localizer took over."""
    parameters = parameters_from({})
    both = prepare_references(target_images[:2], parameters)
    localizer = Localizer(parameters, both)
    frames = [simulated.frame for simulated in two_target_frames]
    for frame in (*frames[:2], replace(frames[2], stamp_ns=0)):
        localizer.process(frame)
    fewer = Localizer(parameters, both[1:])
    fewer.continue_from(localizer)
    assert list(fewer.process(frames[3]).references) == [both[1].name]
    # The one that was taken over from goes on as before.
    assert len(localizer.process(frames[3]).references) == 2
    localizer.remove(both[0].name)
    assert list(localizer.process(frames[4]).references) == [both[1].name]
    assert localizer.process(frames[5]).first.status.found


def test_names_of_references_are_unique(targets: Targets) -> None:
    with pytest.raises(ParameterError, match="need unique names"):
        Localizer(parameters_from({}), [targets[0], targets[0]])
