# SPDX-License-Identifier: Apache-2.0
"""A calibration that does not fit what is seen: found, said once, in the covariances; a right one is left alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from imgu_ros.config.parameters import Parameters
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import CalibrationFinding, PoseStatus, ReferenceResult, Status, by_name
from imgu_ros.simulate.placing import Placing, camera_before_target
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import arrange_scene
from imgu_ros.simulate.sequence import TYPICAL_LENSES
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.types import Floats
from imgu_ros.vision.camera.camera_covariance import with_covariance
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3, log_so3
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor, expose

K = np.array([[935.0, 0, 655], [0, 935, 350], [0, 0, 1]])
PINHOLE = make_camera(K, (), "plumb_bob", 1280, 720)
LENS = make_camera(K, TYPICAL_LENSES["plumb_bob"], "plumb_bob", 1280, 720)
CORNERS = np.array([[-0.25, 0.2], [0.25, 0.2], [0.25, -0.2], [-0.25, -0.2]])
NOISE_PX = 0.05


def longer(camera: Camera, share: float) -> Camera:
    """Return a camera whose focal length is too long by a share."""
    return replace(camera, K=camera.K * [[1 + share, 1, 1], [1, 1 + share, 1], [1, 1, 1]])


def pose_at(index: int, tilt_deg: float) -> RigidTransform:
    """Return where a hand-held camera is in a frame of a sequence at 30 Hz."""
    turn = 0.05 * index
    axis = math.radians(tilt_deg) * np.array([math.cos(turn), math.sin(turn), 0.0])
    R = exp_so3([0, 0, 0.02 * index]) @ exp_so3(axis) @ np.diag([1.0, -1, -1])
    return RigidTransform(R, np.array([0.1 * math.sin(0.07 * index), 0.05 * math.cos(0.05 * index), 0.9]))


def examined(
    check: CalibrationCheck, camera: Camera | None, results: Sequence[ReferenceResult]
) -> tuple[ReferenceResult, ...]:
    return tuple(check.examined(camera, by_name(results)).values())


def seen(
    truth: Camera, given: Camera, pose: RigidTransform, rng: np.random.Generator, index: int = 0
) -> ReferenceResult:
    """Return what becomes of a target whose points are measured with noise."""
    plane = rng.uniform(-1, 1, (120, 2)) * [0.25, 0.2]
    both = truth.project(np.vstack((plane, CORNERS)) @ pose.R[:, :2].T + pose.t)
    poses = planar_poses(plane, both[:-4] + rng.normal(0, NOISE_PX, plane.shape), given)
    return ReferenceResult(
        f"target_{index}",
        index,
        Status.TRACKED,
        PoseStatus.METRIC,
        outline=both[-4:],
        pose=poses.solutions[0],
        solutions=poses.solutions,
        calibration=poses.calibration,
    )


def squared(target: ReferenceResult, truth: RigidTransform) -> float:
    assert target.pose is not None
    error = np.concatenate((truth.t - target.pose.t, log_so3(truth.R @ target.pose.R.T)))
    return float(error @ np.linalg.solve(target.pose.covariance, error))


def watched(
    check: CalibrationCheck, truth: Camera, given: Camera, tilts: Sequence[float], seed: int = 0
) -> tuple[list[CalibrationFinding], list[float]]:
    rng, findings, errors = np.random.default_rng(seed), [], []
    for index, tilt in enumerate(tilts):
        pose = pose_at(index, tilt)
        target = examined(check, given, [seen(truth, given, pose, rng)])[0]
        assert check.finding is not None
        findings.append(check.finding)
        errors.append(squared(target, pose))
    return findings, errors


@pytest.mark.parametrize("error", [0.01, -0.01, 0.02, -0.03, 0.05, -0.05])
@pytest.mark.parametrize("camera", [PINHOLE, LENS], ids=["pinhole", "plumb_bob"])
def test_a_wrong_focal_length_is_said_within_thirty_frames(camera: Camera, error: float) -> None:
    findings, errors = watched(CalibrationCheck(), camera, longer(camera, error), [24.0] * 30)
    warnings = [finding.warning for finding in findings if finding.warning]
    assert warnings
    assert "focal length about" in warnings[-1] and ("long" if error > 0 else "short") in warnings[-1]
    assert findings[-1].focal_percent == pytest.approx(100 * error, abs=0.15 + 3 * abs(error))
    # Once said, it stays in the same words.
    assert len({w for w in warnings if "focal length about" in w}) == 1
    assert (np.array(errors) < 12.59).mean() >= 0.85


def test_what_oblique_frames_told_helps_in_frontal_ones() -> None:
    findings, errors = watched(CalibrationCheck(), PINHOLE, longer(PINHOLE, 0.01), [30.0] * 6 + [3.0] * 25)
    assert findings[-1].is_focal
    assert (np.array(errors[6:]) < 12.59).mean() >= 0.85
    alone, blind = watched(CalibrationCheck(), PINHOLE, longer(PINHOLE, 0.01), [0.5] * 8)
    assert not any(finding.warning for finding in alone)
    assert np.median(blind) > 100  # nothing there says that the distance is wrong


@pytest.mark.parametrize("camera", [PINHOLE, LENS], ids=["pinhole", "plumb_bob"])
def test_a_right_calibration_is_left_alone(camera: Camera) -> None:
    tilts = [25 + 24 * math.sin(0.11 * index) for index in range(300)]
    findings, errors = watched(CalibrationCheck(), camera, camera, tilts, seed=3)
    assert not any(finding.warning for finding in findings)
    assert 0.91 < (np.array(errors) < 12.59).mean() < 0.99
    assert np.median(errors) == pytest.approx(5.35, abs=0.8)
    assert 1 < findings[-1].chi_squared < 3


def test_an_error_within_the_calibrations_own_covariance_is_expected() -> None:
    covariance = np.diag([0.01 * 935, 0.01 * 935, 3, 3]) ** 2
    covariance[0, 1] = covariance[1, 0] = 0.999 * covariance[0, 0]
    for error in (0.012, -0.008):
        given = with_covariance(longer(PINHOLE, error), covariance)
        findings, errors = watched(CalibrationCheck(), PINHOLE, given, [35.0] * 60)
        assert not any(finding.warning for finding in findings)
        assert (np.array(errors) < 12.59).mean() > 0.9
    far_off = with_covariance(longer(PINHOLE, 0.09), covariance)
    assert watched(CalibrationCheck(), PINHOLE, far_off, [35.0] * 60)[0][-1].is_focal


def test_a_wrong_principal_point_is_not_blamed_on_the_focal_length() -> None:
    given = replace(PINHOLE, K=K + [[0, 0, 25], [0, 0, -20], [0, 0, 0]])
    findings, errors = watched(CalibrationCheck(), PINHOLE, given, [35.0] * 30)
    assert findings[-1].warning
    assert not any("focal length about" in finding.warning for finding in findings)
    assert (np.array(errors) < 12.59).mean() > 0.85


def test_a_camera_that_stands_still_says_everything_once() -> None:
    check, rng = CalibrationCheck(), np.random.default_rng(5)
    one = seen(PINHOLE, longer(PINHOLE, 0.01), pose_at(0, 30), rng)
    for _ in range(1000):
        examined(check, longer(PINHOLE, 0.01), [one])
    assert check.finding is not None
    assert check.finding.views == 1


def test_it_forgets_when_the_camera_changes_and_at_a_reset() -> None:
    check, wrong = CalibrationCheck(), longer(PINHOLE, 0.03)
    watched(check, PINHOLE, wrong, [35.0] * 10)
    same_numbers = make_camera(wrong.K, (), "plumb_bob", 1280, 720)
    findings, _ = watched(check, PINHOLE, same_numbers, [35.0])
    assert findings[0].views > 5
    findings, _ = watched(check, PINHOLE, PINHOLE, [35.0] * 10)
    assert findings[0].views == 1
    assert not any(finding.warning for finding in findings)
    check.reset()
    assert check.finding is None


def test_targets_of_one_frame_share_the_calibrations_error() -> None:
    check, rng, wrong = CalibrationCheck(), np.random.default_rng(6), longer(PINHOLE, 0.02)
    for index in range(12):
        targets = [seen(PINHOLE, wrong, pose_at(index, tilt), rng, i) for i, tilt in enumerate((20, 45))]
        targets = list(examined(check, wrong, targets))
    shared = [target.pose.shared for target in targets if target.pose is not None]
    assert all(factor is not None and factor.shape == (6, 9) for factor in shared)
    assert check.finding is not None
    assert check.finding.views > 12


def test_without_a_camera_or_a_pose_nothing_is_said() -> None:
    check = CalibrationCheck()
    lost = ReferenceResult("a", 0, Status.LOST)
    assert examined(check, None, [lost]) == (lost,)
    assert examined(check, PINHOLE, [lost]) == (lost,)
    assert check.finding is None


@pytest.fixture(scope="module")
def rendered() -> tuple[list[tuple[Floats, RigidTransform]], TargetImage]:
    """Frames of 640x480 of a printed texture under a tilt of 35 degrees, at 30 Hz."""
    camera = make_camera([[600, 0, 330], [0, 600, 235], [0, 0, 1]], (), "plumb_bob", 640, 480)
    target = TargetImage("print", procedural_texture(640, 480, seed=21), 0.5)
    renderer = Renderer(arrange_scene([target]), camera, PixelLayout(ColorModel.BAYER, BayerPattern.RGGB))
    frames = []
    for index in range(12):
        placing = Placing(tilt_rad=math.radians(35), width_share=0.5)
        pose = camera_before_target(2 * index / 119, placing, camera, renderer.scene, 4)
        light = renderer.radiance(pose) * np.float32(0.9)
        truth = pose.after(renderer.scene.poses[0])
        frames.append((expose(light, Sensor(), np.random.default_rng(index)), truth))
    return frames, target


@pytest.mark.parametrize("error", [0.0, 0.02, -0.04])
def test_the_chain_says_it_of_frames(
    rendered: tuple[list[tuple[Floats, RigidTransform]], TargetImage], error: float
) -> None:
    frames, target = rendered
    given = longer(make_camera([[600, 0, 330], [0, 600, 235], [0, 0, 1]], (), "plumb_bob", 640, 480), error)
    parameters = Parameters()
    chain = Localizer(parameters, prepare_references([target], parameters))
    results = [
        chain.process(
            Frame(RawImage(pixels, PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)), index * 33_333_333, "c", given)
        )
        for index, (pixels, _) in enumerate(frames)
    ]
    last = results[-1]
    assert last.calibration is not None
    assert bool(last.calibration.warning) == bool(error)
    assert last.camera_remarks == ((last.calibration.warning,) if error else ())
    if error:
        assert last.calibration.focal_percent == pytest.approx(100 * error, abs=0.4)
    errors = [squared(result.first, truth) for result, (_, truth) in zip(results, frames, strict=True)]
    assert (np.array(errors) < 12.59).mean() >= 0.85
    # Stamps that jump back belong to another recording: what was seen is forgotten.
    again = replace(results[0].frame, stamp_ns=-5_000_000_000)
    begun = chain.process(again).calibration
    assert begun is not None
    assert begun.views == 1


def test_all_poses_of_a_frame_share_as_many_errors() -> None:
    """Else they could not be fused: also where one of them says nothing of the calibration."""
    check, rng, wrong = CalibrationCheck(), np.random.default_rng(3), longer(PINHOLE, 0.03)
    for index in range(12):
        first = seen(PINHOLE, wrong, pose_at(index, 30), rng)
        second = replace(seen(PINHOLE, wrong, pose_at(index + 40, 20), rng, 1), calibration=None)
        targets = examined(check, wrong, [first, second])
        poses = [target.pose for target in targets]
        shared = [0 if pose is None or pose.shared is None else pose.shared.shape[1] for pose in poses]
        assert shared[0] == shared[1]
        assert len({tuple(np.shape(pose.shared)) for pose in poses if pose is not None}) == 1
    assert shared[0] > 0
    assert poses[1] is not None and np.array_equal(poses[1].covariance, second.pose.covariance)


def test_a_view_that_cannot_be_weighed_costs_neither_the_frame_nor_the_others() -> None:
    check, rng, wrong = CalibrationCheck(), np.random.default_rng(4), longer(PINHOLE, 0.03)
    for index in range(6):
        examined(check, wrong, [seen(PINHOLE, wrong, pose_at(index, 30), rng)])
    before = check.finding
    assert before is not None and before.warning
    strange = seen(PINHOLE, wrong, pose_at(50, 30), rng)
    assert strange.calibration is not None
    huge = replace(strange.calibration, residual=strange.calibration.residual + 1e12)
    for index in (50, 70):
        target = replace(seen(PINHOLE, wrong, pose_at(index, 30), rng), calibration=huge)
        assert examined(check, wrong, [target])[0].pose is not None
    assert check.finding is before
    for index in (9, 12):
        examined(check, wrong, [seen(PINHOLE, wrong, pose_at(index, 30), rng)])
    assert check.finding is not before and check.finding.warning == before.warning


def test_a_new_calibration_is_not_blamed_while_nothing_is_in_view() -> None:
    check, rng, wrong = CalibrationCheck(), np.random.default_rng(5), longer(PINHOLE, 0.03)
    for index in range(6):
        examined(check, wrong, [seen(PINHOLE, wrong, pose_at(index, 30), rng)])
    assert check.finding is not None and check.finding.warning
    examined(check, PINHOLE, [ReferenceResult("target_0", 0, Status.LOST)])
    assert check.finding is None
