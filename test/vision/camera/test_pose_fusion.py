# SPDX-License-Identifier: Apache-2.0
"""Fusing poses: against the estimate from all observations at once, and against the true errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.pose_fusion import fuse_poses, pose_after, pose_seen_from
from imgu_ros.vision.camera.rigid import RigidTransform


def random_covariance(generator: np.random.Generator, sigma: float) -> np.ndarray:
    root = generator.normal(size=(6, 6)) * sigma
    return root @ root.T + (0.1 * sigma) ** 2 * np.eye(6)


def estimates(seed: int, count: int = 3, sigma: float = 1e-3) -> tuple[Pose, list[Pose]]:
    """Return the truth, and independent estimates of it, each drawn from its covariance."""
    generator = np.random.default_rng(seed)
    R, t = Rotation.random(random_state=seed), generator.normal(size=3)
    out = []
    for _ in range(count):
        covariance = random_covariance(generator, sigma * generator.uniform(0.3, 3))
        error = generator.multivariate_normal(np.zeros(6), covariance)
        # R_true = Exp(d) R_est
        out.append(Pose((Rotation.from_rotvec(-error[3:]) * R).as_matrix(), t - error[:3], covariance, 0.2))
    return Pose(R.as_matrix(), t, np.zeros((6, 6)), 0.0), out


def error_of(estimate: Pose, truth: Pose) -> np.ndarray:
    turn = Rotation.from_matrix(truth.R) * Rotation.from_matrix(estimate.R).inv()
    return np.concatenate((truth.t - estimate.t, turn.as_rotvec()))


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_least_squares_estimate(seed: int) -> None:
    truth, poses = estimates(seed, sigma=0.005)
    roots = [np.linalg.cholesky(np.linalg.inv(pose.covariance)).T for pose in poses]

    def residuals(x: np.ndarray) -> np.ndarray:
        R = Rotation.from_rotvec(x[3:]) * Rotation.from_matrix(truth.R)
        each = [np.concatenate((p.t - x[:3], (Rotation.from_matrix(p.R) * R.inv()).as_rotvec())) for p in poses]
        return np.concatenate([root @ r for root, r in zip(roots, each, strict=True)])

    best = least_squares(residuals, np.concatenate((truth.t, np.zeros(3))), x_scale="jac", xtol=1e-14, ftol=1e-14)
    fused = fuse_poses(poses)
    sigma = np.sqrt(np.diag(fused.pose.covariance))
    R = Rotation.from_rotvec(best.x[3:]).as_matrix() @ truth.R
    difference = error_of(fused.pose, Pose(R, best.x[:3], np.zeros((6, 6)), 0.0))
    assert np.abs(difference / sigma).max() < 0.05
    assert fused.disagreement == pytest.approx(2 * best.cost / 12, rel=0.01)


def test_the_covariance_is_that_of_the_errors() -> None:
    squared = []
    for seed in range(400):
        truth, poses = estimates(seed)
        fused = fuse_poses(poses).pose
        error = error_of(fused, truth)
        squared.append(error @ np.linalg.solve(fused.covariance, error))
        assert (
            all(
                np.trace(fused.covariance[part, part]) <= np.trace(pose.covariance[part, part]) * 1.0001
                for pose in poses
                for part in (slice(0, 3), slice(3, 6))
            )
            or fuse_poses(poses).disagreement > 2
        )
    assert np.mean(squared) == pytest.approx(6, rel=0.1)
    assert np.mean(np.array(squared) < chi2.ppf(0.95, 6)) == pytest.approx(0.95, abs=0.03)


def test_contradictions_are_told_and_widen_the_covariance() -> None:
    _, poses = estimates(5, sigma=1e-3)
    agreed = fuse_poses(poses)
    assert agreed.disagreement < 2.2
    wrong = [*poses[:2], replace(poses[2], t=poses[2].t + [0.5, 0, 0])]
    fused = fuse_poses(wrong)
    assert fused.disagreement > 100
    np.testing.assert_allclose(fused.pose.covariance, agreed.pose.covariance * fused.disagreement, rtol=1e-6)


def test_slack_explains_contradictions() -> None:
    _, poses = estimates(5, sigma=1e-3)
    slack = [np.diag([1.0] * 3 + [0.01] * 3)] * 3
    agreed = fuse_poses(poses, slack)
    np.testing.assert_array_equal(agreed.pose.covariance, fuse_poses(poses).pose.covariance)
    shift = np.random.default_rng(1).normal(0, 0.3, (3, 3))
    apart = [replace(pose, t=pose.t + e) for pose, e in zip(poses, shift, strict=True)]
    fused = fuse_poses(apart, slack)
    # Alike slack, far beyond the covariances: the mean, and its scatter.
    np.testing.assert_allclose(fused.pose.t, np.mean([pose.t for pose in apart], axis=0), atol=0.01)
    scatter = np.sum((shift - shift.mean(axis=0)) ** 2) / 12
    np.testing.assert_allclose(np.diag(fused.pose.covariance)[:3], scatter / 3, rtol=0.15)
    with pytest.raises(ShapeError, match="slack: 2; need 3"):
        fuse_poses(poses, slack[:2])
    with pytest.raises(DegenerateConfiguration, match=r"slack\[1\]"):
        fuse_poses(apart, [slack[0], np.zeros((6, 6)), slack[0]])


def test_one_is_itself_and_equals_halve_the_covariance() -> None:
    _, (pose,) = estimates(1, count=1)
    assert fuse_poses([pose]).pose is pose
    fused = fuse_poses([pose, pose])
    np.testing.assert_allclose(fused.pose.R, pose.R, atol=1e-12)
    np.testing.assert_allclose(fused.pose.t, pose.t, atol=1e-12)
    np.testing.assert_allclose(fused.pose.covariance, pose.covariance / 2, rtol=1e-9)
    assert fused.disagreement == pytest.approx(0, abs=1e-12)


def test_order_and_world_do_not_matter() -> None:
    _, poses = estimates(2)
    world = RigidTransform(Rotation.random(random_state=9).as_matrix(), np.array([3.0, -2.0, 1.0]))
    first = pose_seen_from(world, fuse_poses(poses).pose)
    second = fuse_poses([pose_seen_from(world, pose) for pose in poses[::-1]]).pose
    np.testing.assert_allclose(first.R, second.R, atol=1e-8)
    np.testing.assert_allclose(first.t, second.t, atol=1e-8)
    np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-6, atol=1e-12)


def test_a_pose_in_another_world_by_monte_carlo() -> None:
    _, (pose,) = estimates(3, count=1)
    world = RigidTransform(Rotation.random(random_state=4).as_matrix(), np.array([3.0, -2.0, 1.0]))
    moved = pose_seen_from(world, pose)
    np.testing.assert_allclose(moved.transform.matrix, world.matrix @ pose.transform.matrix, atol=1e-12)
    errors = np.random.default_rng(0).multivariate_normal(np.zeros(6), pose.covariance, 20_000)
    turned = Rotation.from_rotvec(errors[:, 3:]) * Rotation.from_matrix(pose.R)
    true_turn = Rotation.from_matrix(world.R) * turned * Rotation.from_matrix(moved.R).inv()
    sampled = np.cov(np.column_stack((errors[:, :3] @ world.R.T, true_turn.as_rotvec())).T)
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    assert np.abs((moved.covariance - sampled) / scale).max() < 0.03


def test_a_pose_of_a_moved_source_by_monte_carlo() -> None:
    _, (pose,) = estimates(3, count=1)
    motion = RigidTransform(Rotation.random(random_state=4).as_matrix(), np.array([3.0, -2.0, 1.0]))
    moved = pose_after(pose, motion)
    np.testing.assert_allclose(moved.transform.matrix, pose.transform.matrix @ motion.matrix, atol=1e-12)
    errors = np.random.default_rng(0).multivariate_normal(np.zeros(6), pose.covariance, 20_000)
    true_R = Rotation.from_rotvec(errors[:, 3:]) * Rotation.from_matrix(pose.R)
    true_t = pose.t + errors[:, :3] + true_R.apply(motion.t)
    true_turn = true_R * Rotation.from_matrix(motion.R) * Rotation.from_matrix(moved.R).inv()
    sampled = np.cov(np.column_stack((true_t - moved.t, true_turn.as_rotvec())).T)
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    assert np.abs((moved.covariance - sampled) / scale).max() < 0.03


def test_bad_input() -> None:
    _, poses = estimates(0)
    with pytest.raises(TooFewPoints, match="poses: none"):
        fuse_poses([])
    with pytest.raises(DegenerateConfiguration, match=r"poses\[1\].covariance"):
        fuse_poses([poses[0], replace(poses[1], covariance=np.zeros((6, 6)))])
    skewed = poses[1].covariance.copy()
    skewed[0, 1] += 1
    with pytest.raises(ShapeError, match=r"poses\[1\].covariance: not symmetric"):
        fuse_poses([poses[0], replace(poses[1], covariance=skewed)])
    with pytest.raises(ShapeError, match=r"poses\[0\]"):
        fuse_poses([replace(poses[0], R=np.zeros((3, 3))), poses[1]])
