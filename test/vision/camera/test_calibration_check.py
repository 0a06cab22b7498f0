# SPDX-License-Identifier: Apache-2.0
"""What the picture of a plane says of the calibration, and what the calibration's covariance means for the pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Points
from imgu_ros.vision.camera.calibration_evidence import weigh_calibration
from imgu_ros.vision.camera.calibration_test import CalibrationTest
from imgu_ros.vision.camera.camera_covariance import as_covariance, with_covariance
from imgu_ros.vision.camera.camera_derivatives import ideal_by_camera, raw_by_camera
from imgu_ros.vision.camera.homography_pose import poses_of_homography
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.camera.pose import PlanarPoses, Pose
from imgu_ros.vision.camera.pose_estimate import fit_pose
from imgu_ros.vision.camera.pose_fusion import fuse_poses
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3, log_so3
from imgu_ros.vision.projective.homography import homography_normal_equations
from imgu_ros.vision.projective.plane_motion import PlaneMotion
from imgu_ros.vision.projective.transform import transform

K = np.array([[935.0, 0, 655], [0, 920, 350], [0, 0, 1]])
LENSES = {
    "pinhole": make_camera(K, (), "plumb_bob", 1280, 720),
    "plumb_bob": make_camera(K, (-0.26, 0.09, 0.0008, -0.0005, -0.01), "plumb_bob", 1280, 720),
    "rational_polynomial": make_camera(
        K, (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01), "rational_polynomial", 1280, 720
    ),
    "equidistant": make_camera(K, (-0.03, 0.008, -0.004, 0.001), "equidistant", 1280, 720),
}
NOISE_PX = 0.05


def pose_at(rng: np.random.Generator, tilt_deg: float, distance_m: float = 0.9) -> RigidTransform:
    turn = rng.uniform(0, 2 * np.pi)
    axis = np.deg2rad(tilt_deg) * np.array([np.cos(turn), np.sin(turn), 0.0])
    R = exp_so3(np.array([0, 0, rng.uniform(-3, 3)])) @ exp_so3(axis) @ np.diag([1.0, -1, -1])
    return RigidTransform(R, np.array([rng.uniform(-0.15, 0.15), rng.uniform(-0.08, 0.08), distance_m]))


def points(rng: np.random.Generator, count: int = 120) -> Points:
    return rng.uniform(-1, 1, (count, 2)) * [0.25, 0.2]


def seen(camera: Camera, plane: Points, pose: RigidTransform, rng: np.random.Generator) -> Points:
    return camera.project(plane @ pose.R[:, :2].T + pose.t) + rng.normal(0, NOISE_PX, plane.shape)


def with_numbers(camera: Camera, change: Floats) -> Camera:
    matrix = camera.K.copy()
    matrix[0, 0] += change[0]
    matrix[1, 1] += change[1]
    matrix[:2, 2] += change[2:4]
    return replace(camera, K=matrix, distortion=camera.distortion + change[4:])


def error_of(pose: Pose, truth: RigidTransform) -> Floats:
    return np.concatenate((truth.t - pose.t, log_so3(truth.R @ pose.R.T)))


def views_of(truth: Camera, given: Camera, count: int, rng: np.random.Generator, tilt: float) -> list[CalibrationTest]:
    found = []
    for _ in range(count):
        plane, pose = points(rng), pose_at(rng, tilt)
        test = planar_poses(plane, seen(truth, plane, pose, rng), given).calibration
        assert test is not None
        found.append(test)
    return found


@pytest.mark.parametrize("name", LENSES)
def test_derivatives_are_those_of_the_camera(name: str) -> None:
    camera, rng = LENSES[name], np.random.default_rng(1)
    objects = np.column_stack((rng.uniform(-0.4, 0.4, (20, 2)), np.ones(20)))
    raw = camera.project(objects)
    ideal = camera.ideal_pixels(raw)[0]
    of_raw, of_ideal = raw_by_camera(camera, objects), ideal_by_camera(camera, ideal)
    for index in range(4 + len(camera.distortion)):
        change = np.zeros(4 + len(camera.distortion))
        change[index] = 1e-3 if index < 4 else 1e-6
        both = [with_numbers(camera, sign * change) for sign in (1, -1)]
        by_raw = (both[0].project(objects) - both[1].project(objects)) / (2 * change[index])
        assert np.allclose(of_raw[:, :, index], by_raw, rtol=1e-5, atol=1e-6)
        if not camera.is_distorted and index >= 4:
            continue
        lines = [other.undistort(raw)[0] @ camera.K[:2, :2].T for other in both]
        assert np.allclose(of_ideal[:, :, index], (lines[0] - lines[1]) / (2 * change[index]), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("name", "tilt"), [("pinhole", 10), ("pinhole", 45), ("plumb_bob", 30), ("equidistant", 50)])
def test_the_misfit_is_chi_squared_with_two_degrees_of_freedom(name: str, tilt: float) -> None:
    tests = views_of(LENSES[name], LENSES[name], 400, np.random.default_rng(2), tilt)
    squared = np.array([test.chi_squared for test in tests])
    # Mean 2 and variance 4: 400 of them have a mean within 0.3 but once in 300 times.
    assert abs(squared.mean() - 2) < 0.3
    assert 0.92 < (squared < 5.99).mean() < 0.98


def test_of_few_points_the_misfit_is_no_larger() -> None:
    rng, squared = np.random.default_rng(3), []
    for _ in range(400):
        plane, pose = points(rng, 7), pose_at(rng, 35)
        test = planar_poses(plane, seen(LENSES["pinhole"], plane, pose, rng), LENSES["pinhole"]).calibration
        assert test is not None
        squared.append(test.chi_squared)
    assert abs(np.mean(squared) - 2) < 0.35
    assert (np.array(squared) < 5.99).mean() > 0.92


def test_correlated_errors_are_weighed_as_such() -> None:
    rng, squared = np.random.default_rng(4), []
    correlation = np.kron(np.eye(40), np.full((3, 3), 0.8)) + 0.2 * np.eye(120)
    half = np.linalg.cholesky(correlation)
    for _ in range(300):
        plane, pose = points(rng), pose_at(rng, 35)
        pixels = LENSES["pinhole"].project(plane @ pose.R[:, :2].T + pose.t)
        pixels += NOISE_PX * half @ rng.normal(size=(120, 2))
        test = planar_poses(plane, pixels, LENSES["pinhole"], NOISE_PX, correlation).calibration
        assert test is not None
        squared.append(test.chi_squared)
    assert abs(np.mean(squared) - 2) < 0.35


METRES = np.array([[0.001, 0, -0.25], [0, -0.001, 0.2], [0, 0, 1]])


def posed_from(ideal: Points, pixels: Points, start: Floats, camera: Camera, asked: Camera | None) -> PlanarPoses:
    """Return the poses of a homography that maps `pixels` of a picture to `ideal` ones, near `start`."""
    motions, moved = PlaneMotion(pixels), pixels - transform(np.linalg.inv(start), ideal)
    condensed = homography_normal_equations(
        motions, moved, motions.fit(moved, np.ones(len(pixels), bool)), start, np.eye(3)
    )
    assert condensed.estimate.inliers.all()
    return poses_of_homography(condensed, camera.K, METRES, asked, pixels)


@pytest.mark.parametrize("name", LENSES)
def test_a_homographys_pose_moves_with_the_camera_as_is_said(name: str) -> None:
    """Against poses of the same raw pixels, undistorted by cameras that differ a little."""
    camera, rng = LENSES[name], np.random.default_rng(5)
    count = 4 + len(camera.distortion)
    pose, pixels = pose_at(rng, 40), rng.uniform(0, 1, (100, 2)) * [500, 400]
    H = K @ np.column_stack((pose.R[:, :2], pose.t)) @ METRES
    ideal = transform(H, pixels) + rng.uniform(-0.5, 0.5, (100, 2))
    raw = camera.raw_pixels(ideal)
    given = with_covariance(camera, np.eye(count) * 1e-9)
    test = posed_from(ideal, pixels, H, camera, given).calibration
    assert test is not None
    for index in range(count if camera.is_distorted else 4):
        change = np.zeros(count)
        change[index] = 0.4 / np.abs(ideal_by_camera(camera, ideal)[:, :, index]).max()
        both = []
        for sign in (1, -1):
            other = with_numbers(camera, sign * change)
            both.append(posed_from(other.ideal_pixels(raw)[0], pixels, H, other, None).solutions[0])
        moved = error_of(both[1], both[0].transform) / (2 * change[index])
        said = test.pose_by_camera[:, index]
        assert np.allclose(said, moved, rtol=0.02, atol=0.02 * np.abs(said).max()), index


def test_points_and_their_homography_say_the_same() -> None:
    camera, rng = LENSES["pinhole"], np.random.default_rng(5)
    pose, pixels = pose_at(rng, 40), rng.uniform(0, 1, (100, 2)) * [500, 400]
    H = K @ np.column_stack((pose.R[:, :2], pose.t)) @ METRES
    ideal = transform(H, pixels) + rng.uniform(-0.08, 0.08, (100, 2))
    a, b = posed_from(ideal, pixels, H, camera, camera), planar_poses(transform(METRES, pixels), ideal, camera)
    assert a.calibration is not None and b.calibration is not None
    assert a.calibration.chi_squared == pytest.approx(b.calibration.chi_squared, rel=0.1)
    by_K, expected = a.calibration.pose_by_camera[:, :4], b.calibration.pose_by_camera[:, :4]
    assert np.allclose(by_K, expected, atol=0.01 * np.abs(expected).max())


def test_a_pinhole_says_the_same_with_and_without_its_points() -> None:
    camera, rng = LENSES["pinhole"], np.random.default_rng(6)
    pose, pixels = pose_at(rng, 40), rng.uniform(0, 1, (100, 2)) * [500, 400]
    H = K @ np.column_stack((pose.R[:, :2], pose.t)) @ METRES
    ideal = transform(H, pixels) + rng.uniform(-0.08, 0.08, (100, 2))
    exact = posed_from(ideal, pixels, H, camera, camera).calibration
    pointwise = posed_from(ideal, pixels, H, camera, with_covariance(camera, np.zeros((4, 4)))).calibration
    assert exact is not None and pointwise is not None
    assert np.allclose(
        exact.by_camera[:, :4], pointwise.by_camera[:, :4], rtol=1e-6, atol=1e-6 * np.abs(exact.by_camera).max()
    )


@pytest.mark.parametrize("error", [-0.05, -0.01, 0.01, 0.03])
@pytest.mark.parametrize("name", ["pinhole", "plumb_bob"])
def test_a_wrong_focal_length_is_measured(name: str, error: float) -> None:
    truth, rng = LENSES[name], np.random.default_rng(7)
    change = np.zeros(9)
    change[:2] = error * K[0, 0], error * K[1, 1]
    given = with_numbers(truth, change)
    evidence = weigh_calibration(views_of(truth, given, 12, rng, 35), given)
    assert 1 / (1 + evidence.focal) - 1 == pytest.approx(error, abs=0.001 + 0.03 * abs(error))
    assert evidence.focal_share > 0.9
    assert evidence.covariance is not None


def test_a_right_calibration_gives_no_evidence() -> None:
    rng = np.random.default_rng(8)
    for count in (1, 3, 12, 40):
        evidence = weigh_calibration(
            views_of(LENSES["plumb_bob"], LENSES["plumb_bob"], count, rng, 35), LENSES["plumb_bob"]
        )
        assert evidence.covariance is None
        assert abs(evidence.focal) < 4 * evidence.focal_sigma


def test_a_wrong_principal_point_is_not_called_a_focal_length() -> None:
    truth, rng = LENSES["pinhole"], np.random.default_rng(9)
    given = with_numbers(truth, np.array([0.0, 0, 30, -25, 0, 0, 0, 0, 0]))
    evidence = weigh_calibration(views_of(truth, given, 12, rng, 35), given)
    assert evidence.sigmas > 10
    assert evidence.focal_share < 0.5


def test_what_the_covariance_allows_is_no_evidence() -> None:
    truth, rng = LENSES["pinhole"], np.random.default_rng(10)
    change = np.zeros(9)
    change[:2] = 0.01 * K[0, 0], 0.01 * K[1, 1]
    common = np.zeros((4, 4))
    common[:2, :2] = [[9.4**2, 0.99 * 9.4 * 9.2], [0.99 * 9.4 * 9.2, 9.2**2]]
    common[2:, 2:] = 9 * np.eye(2)
    given = with_covariance(with_numbers(truth, change), common)
    evidence = weigh_calibration(views_of(truth, given, 20, rng, 35), given)
    assert evidence.covariance is None
    assert abs(evidence.focal) < 3 * evidence.focal_sigma


@pytest.mark.parametrize("pose_of", ["plane", "space"])
def test_poses_with_calibrations_drawn_from_their_covariance_are_honest(pose_of: str) -> None:
    truth, rng = LENSES["plumb_bob"], np.random.default_rng(11)
    sigmas = np.array([6.0, 6.0, 4.0, 4.0, 0.01, 0.03, 3e-4, 3e-4, 0.03])
    correlated = np.eye(9)
    correlated[0, 1] = correlated[1, 0] = 0.95
    correlated[4, 5] = correlated[5, 4] = -0.9
    covariance = correlated * np.outer(sigmas, sigmas)
    half = np.linalg.cholesky(covariance)
    squared = []
    for _ in range(150):
        given = with_covariance(with_numbers(truth, half @ rng.normal(size=9)), covariance)
        plane, pose = points(rng, 60), pose_at(rng, rng.uniform(20, 55))
        pixels = seen(truth, plane, pose, rng)
        if pose_of == "plane":
            found = planar_poses(plane, pixels, given).solutions[0]
        else:
            found = fit_pose(np.column_stack((plane, np.zeros(60))), pixels, given)
        error = error_of(found, pose)
        squared.append(error @ np.linalg.solve(found.covariance, error))
    assert (np.array(squared) < 12.59).mean() > 0.9
    assert 4.5 < np.mean(squared) < 8


def test_fusion_does_not_shrink_what_poses_share() -> None:
    own, shared = np.diag([1e-6] * 3 + [1e-8] * 3), np.array([[0.0, 0, 0.01, 0, 0, 0]]).T
    one = Pose(np.eye(3), np.zeros(3), own, 0.1).with_shared_error(shared)
    fused = fuse_poses([one] * 9).pose
    assert fused.covariance[2, 2] == pytest.approx(1e-4 + 1e-6 / 9, rel=0.02)
    assert fused.covariance[0, 0] == pytest.approx(1e-6 / 9)
    assert fused.shared is not None
    assert fused.shared[2, 0] == pytest.approx(0.01)
    turned = one.inverse().inverse()
    assert turned.shared is not None
    assert np.allclose(np.abs(turned.shared), np.abs(shared))


def test_fusion_of_targets_by_one_camera_is_honest() -> None:
    truth, rng, squared = LENSES["pinhole"], np.random.default_rng(12), []
    covariance = np.zeros((9, 9))
    covariance[:2, :2] = 36.0
    for _ in range(150):
        change = np.zeros(9)
        change[:2] = 6 * rng.normal()
        given = with_covariance(with_numbers(truth, change), covariance)
        pose, poses = pose_at(rng, 40), []
        for _ in range(4):
            plane = points(rng, 40)
            poses.append(planar_poses(plane, seen(truth, plane, pose, rng), given).solutions[0])
        fused = fuse_poses(poses).pose
        error = error_of(fused, pose)
        squared.append(error @ np.linalg.solve(fused.covariance, error))
    assert (np.array(squared) < 12.59).mean() > 0.9
    assert np.mean(squared) < 8


@pytest.mark.parametrize(
    ("covariance", "words"),
    [
        (np.eye(3), "9 numbers; need a square"),
        (np.arange(17.0), "17 numbers; need a square"),
        (np.diag([1.0, 1, 1, -1]), "a variance of -1"),
        (np.eye(4) + np.triu(np.full((4, 4), 0.1), 1), "not symmetric"),
        (np.full((4, 4), 2.0) - np.eye(4), "not positive semidefinite"),
        (np.full((4, 4), np.nan), "NaN|nan|finite"),
    ],
)
def test_what_is_no_covariance_is_refused(covariance: Floats, words: str) -> None:
    with pytest.raises(ShapeError, match=words):
        as_covariance(covariance, "camera.covariance")


def test_a_covariance_is_of_the_cameras_numbers() -> None:
    camera = LENSES["plumb_bob"]
    assert with_covariance(camera, np.eye(4).ravel()).covariance is not None
    with pytest.raises(ShapeError, match="of 12 numbers; need 9 x 9"):
        with_covariance(camera, np.eye(12))
    with pytest.raises(ShapeError, match="of 8 numbers"):
        with_covariance(camera, np.eye(8))  # k3 is -0.01, and nothing is said of it
    assert with_covariance(LENSES["pinhole"], np.eye(8)).covariance is not None
