# SPDX-License-Identifier: Apache-2.0
"""The camera in the map: several planes at known places, seen by one simulated camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.pose.map_pose import camera_in_map, map_places, told_apart
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import PoseStatus, ReferenceResult, Result, Status, by_name
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
NOISE_PX = 0.2
#: The targets' places: two on one wall, one on another, turned by 70 degrees.
MAP_FROM_TARGET = (
    RigidTransform(np.eye(3), np.array([-0.5, 0.1, 0.0])),
    RigidTransform(Rotation.from_euler("z", 30, degrees=True).as_matrix(), np.array([0.3, -0.2, 0.0])),
    RigidTransform(Rotation.from_euler("y", -50, degrees=True).as_matrix(), np.array([1.0, 0.2, 0.4])),
)
PLACES = map_places(("t0", "t1", "t2"), MAP_FROM_TARGET)
#: Before the wall, looking at it a little from the side.
CAMERA = RigidTransform(
    (Rotation.from_euler("x", 180, degrees=True) * Rotation.from_euler("yx", [14, 8], degrees=True)).as_matrix(),
    np.array([0.1, 0.1, 2.0]),
)


def seen(seed: int, map_from_target: tuple[RigidTransform, ...] = MAP_FROM_TARGET) -> Result:
    """Return what the camera sees of the targets, with noise in every corner's place."""
    generator = np.random.default_rng(seed)
    camera = make_camera(K, np.zeros(0), "plumb_bob", 640, 480)
    grid = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 6), np.linspace(-0.15, 0.15, 5)), axis=-1).reshape(-1, 2)
    targets = []
    for index, place in enumerate(map_from_target):
        camera_from_target = CAMERA.inverse().after(place)
        points = np.column_stack((grid, np.zeros(len(grid)))) @ camera_from_target.R.T + camera_from_target.t
        pixels = camera.project(points) + generator.normal(0, NOISE_PX, grid.shape)
        pose = planar_poses(grid, pixels, camera).solutions[0]
        targets.append(ReferenceResult(f"t{index}", index, Status.DETECTED, PoseStatus.METRIC, pose=pose, width_m=0.4))
    frame = Frame(RawImage(np.zeros((1, 1), np.uint8), PixelLayout(ColorModel.MONO)), 0, "camera", None)
    return Result(frame, by_name(tuple(targets)))


def errors(result: Result) -> tuple[float, float]:
    """Return the position's error in metres, and the pose's squared error in units of its covariance."""
    fused = camera_in_map(result, PLACES)
    assert fused is not None
    pose = fused.pose
    turn = (Rotation.from_matrix(CAMERA.R) * Rotation.from_matrix(pose.R).inv()).as_rotvec()
    error = np.concatenate((CAMERA.t - pose.t, turn))
    return float(np.linalg.norm(error[:3])), float(error @ np.linalg.solve(pose.covariance, error))


def only(result: Result, *kept: int) -> Result:
    targets = tuple(t if t.number in kept else ReferenceResult(t.name, t.number, Status.LOST) for t in result)
    return replace(result, references=by_name(targets))


def test_more_planes_give_a_better_pose_and_an_honest_covariance() -> None:
    frames = [seen(seed) for seed in range(80)]
    together = np.array([errors(frame) for frame in frames])
    alone = np.array([[errors(only(frame, index))[0] for index in range(3)] for frame in frames])
    assert np.median(together[:, 0]) < 0.4 * np.median(alone, axis=0).min()
    assert np.mean(together[:, 1]) == pytest.approx(6, abs=1.5)


def test_a_target_at_another_place_than_told_is_noticed() -> None:
    moved = RigidTransform(MAP_FROM_TARGET[1].R, MAP_FROM_TARGET[1].t + [0.2, 0, 0])
    result = seen(1, (MAP_FROM_TARGET[0], moved, MAP_FROM_TARGET[2]))
    fused = camera_in_map(result, PLACES)
    assert fused is not None
    assert fused.disagreement > 100
    # Nobody can say which; what is wrong is within what the covariance says.
    position, squared = errors(result)
    assert position < 0.3
    assert squared < 18


def test_places_measured_by_hand_give_honest_covariances() -> None:
    """Every target hangs a little elsewhere than told, by 5 mm at its corners."""
    generator = np.random.default_rng(8)
    squared = []
    for seed in range(60):
        hung = tuple(
            RigidTransform(
                Rotation.from_rotvec(generator.normal(0, 0.005 / 0.4, 3)).as_matrix() @ place.R,
                place.t + generator.normal(0, 0.0025, 3),
            )
            for place in MAP_FROM_TARGET
        )
        position, one = errors(seen(seed, hung))
        assert position < 0.1
        squared.append(one)
    # 5.35 is exact; from three targets the deviation is known roughly.
    assert 3 < np.median(squared) < 12
    assert np.mean(np.array(squared) < 12.59) > 0.75


def test_without_a_pose_there_is_none() -> None:
    assert camera_in_map(only(seen(0)), PLACES) is None


def test_the_chain_on_simulated_frames_of_two_targets() -> None:
    targets = default_targets(2, seed=3, width_m=0.3)
    parameters = parameters_from(
        {"targets.images": ["a.png", "b.png"], "targets.widths_m": [0.3, 0.3], "tracking.enabled": False}
    )
    chain = Localizer(parameters, prepare_references(targets, parameters))
    alone, together, squared = [], [], []
    for simulated in simulate_sequence(Simulation(width=640, height=480, frames=10, seed=3), targets):
        result = chain.process(simulated.frame)
        first, second = (truth.pose for truth in simulated.truths)
        # The first target is the map.
        places = (RigidTransform(np.eye(3), np.zeros(3)), first.inverse().after(second))
        if any(target.pose is None for target in result):
            continue
        truth = first.inverse()

        def placed(*kept: int, result: Result = result, places: tuple[RigidTransform, ...] = places) -> Pose:
            fused = camera_in_map(only(result, *kept), map_places([known.name for known in targets], places))
            assert fused is not None
            return fused.pose

        alone.append([np.linalg.norm(truth.t - placed(index).t) for index in (0, 1)])
        pose = placed(0, 1)
        together.append(np.linalg.norm(truth.t - pose.t))
        turn = (Rotation.from_matrix(truth.R) * Rotation.from_matrix(pose.R).inv()).as_rotvec()
        difference = np.concatenate((truth.t - pose.t, turn))
        squared.append(difference @ np.linalg.solve(pose.covariance, difference))
    assert len(together) >= 8
    assert np.median(together) < 0.7 * np.median(alone, axis=0).min()
    assert 1.2 < np.median(squared) < 12


def flipped(pose: Pose) -> Pose:
    """Return about the other pose that a small plane may have: mirrored at the line of sight."""
    sight = pose.t / np.linalg.norm(pose.t)
    normal = pose.R[:, 2]
    turn = Rotation.from_rotvec(2 * np.cross(normal, -sight * np.sign(normal @ -sight)))
    return replace(pose, R=(turn * Rotation.from_matrix(pose.R)).as_matrix())


@pytest.mark.parametrize("first", [0, 1])
def test_other_targets_tell_which_planar_solution_is_right(first: int) -> None:
    result = seen(3)
    right = result.references["t1"].pose
    assert right is not None
    solutions = (right, flipped(right)) if first == 0 else (flipped(right), right)
    unsure = replace(
        result.references["t1"], pose_status=PoseStatus.AMBIGUOUS, pose=None, solutions=solutions, reason="two fit"
    )
    results = {**result.references, "t1": unsure}
    settled, turned = told_apart(results, {}, PLACES, None)
    assert settled["t1"].pose is right and settled["t1"].pose_status is PoseStatus.METRIC
    assert settled["t1"].reason == "" and not turned
    assert settled["t0"] is results["t0"]
    # Alone, or where none of its poses is near what the others tell, it stays as it is.
    alone = {"t1": unsure}
    assert told_apart(alone, {}, PLACES, None)[0] == alone
    far = replace(unsure, solutions=(flipped(right),))
    assert told_apart({**results, "t1": far}, {}, PLACES, None)[0]["t1"] is far
