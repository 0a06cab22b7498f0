# SPDX-License-Identifier: Apache-2.0
"""A camera matrix from points: exact, noisy with an honest covariance, degenerate, and with wrong correspondences."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError, TooFewPoints
from imgu_ros.vision.camera.camera_model import ProjectionModel, estimate_projection
from imgu_ros.vision.camera.decomposition import decompose_projection
from imgu_ros.vision.camera.projection import camera_centre, project, projection_matrix
from imgu_ros.vision.camera.resection import fit_projection, projection_dlt
from imgu_ros.vision.camera.rotation import exp_so3

K = np.array([[900.0, 2.0, 641.5], [0, 880.0, 350.25], [0, 0, 1]])
R = exp_so3([0.3, -0.2, 0.5])
T = np.array([0.1, -0.2, 4.0])
P = projection_matrix(K, R, T)


def scene(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    world = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    return world, project(P, world)


@pytest.mark.parametrize("count", [6, 7, 40])
@pytest.mark.parametrize("seed", range(3))
def test_exact_from_six_points_on(count: int, seed: int) -> None:
    world, pixels = scene(count, seed)
    parts = decompose_projection(fit_projection(world + 100, pixels).P)
    assert_allclose(parts.K, K, atol=1e-5)
    assert_allclose(parts.pose.R, R, atol=1e-8)
    assert_allclose(camera_centre(projection_dlt(world, pixels)), -R.T @ T, atol=1e-8)


def test_refinement_reaches_scipys_minimum_and_beats_the_dlt() -> None:
    world, pixels = scene(20)
    noisy = pixels + np.random.default_rng(1).normal(0, 1.0, pixels.shape)
    estimate = fit_projection(world, noisy)

    def residuals(p: np.ndarray) -> np.ndarray:
        return (project(p.reshape(3, 4), world) - noisy).ravel()

    minimum = scipy.optimize.least_squares(residuals, P.ravel() / np.linalg.norm(P), x_scale="jac", xtol=1e-14)
    cost = 2 * len(world) * estimate.rms_px**2
    assert cost == pytest.approx(2 * minimum.cost, rel=1e-6)
    assert cost < 2 * minimum.cost * (1 + 1e-9)
    assert estimate.rms_px < np.sqrt((residuals(projection_dlt(world, noisy).ravel()) ** 2).mean())


def test_covariance_passes_a_chi_square_test() -> None:
    world, pixels = scene(40)
    truth = P.ravel() / np.linalg.norm(P)
    rng = np.random.default_rng(2)
    squared = []
    for _ in range(150):
        estimate = fit_projection(world, pixels + rng.normal(0, 0.5, pixels.shape))
        error = truth - estimate.P.ravel()
        squared.append(error @ np.linalg.pinv(estimate.covariance, rcond=1e-12, hermitian=True) @ error)
    # 11 degrees of freedom; standard error of the mean 0.33, and a little more as the noise is estimated.
    assert 10.2 < np.mean(squared) < 12.6


def test_degenerate_sets_are_refused() -> None:
    rng = np.random.default_rng(3)
    flat = np.column_stack((rng.uniform(-1, 1, (20, 2)), np.zeros(20))) @ R
    pixels = project(P, flat)
    for noise in (0.0, 0.5):
        with pytest.raises(DegenerateConfiguration, match="plane"):
            fit_projection(flat, pixels + rng.normal(0, noise, pixels.shape))
    # Points of a twisted cubic through the camera's centre (HZ section 22.1).
    s = np.linspace(-1, 1, 12)
    cubic = np.column_stack((s, s**2, s**3))
    through = projection_matrix(K, np.eye(3), -np.array([2.0, 4, 8]))
    with pytest.raises(DegenerateConfiguration, match="do not determine"):
        projection_dlt(cubic, project(through, cubic))
    world, pixels = scene(6)
    with pytest.raises(TooFewPoints):
        fit_projection(world[:5], pixels[:5])
    with pytest.raises(ShapeError, match="one for each"):
        fit_projection(world, pixels[:5])
    with pytest.raises(DegenerateConfiguration, match="coincide"):
        fit_projection(world, np.full((6, 2), 7.0))


@pytest.mark.parametrize("seed", range(5))
def test_thirty_percent_of_outliers(seed: int) -> None:
    world, pixels = scene(80, seed)
    rng = np.random.default_rng(seed)
    pixels = pixels + rng.normal(0, 0.4, pixels.shape)
    bad = np.zeros(80, bool)
    bad[rng.permutation(80)[:24]] = True
    pixels[bad] = rng.uniform((0, 0), (1280, 720), (24, 2))
    estimate = estimate_projection(world, pixels, rng)
    assert not (estimate.inliers & bad).any()
    assert np.count_nonzero(estimate.inliers) >= 55
    assert_allclose(estimate.P, fit_projection(world[estimate.inliers], pixels[estimate.inliers]).P, atol=1e-9)
    assert np.linalg.norm(camera_centre(estimate.P) + R.T @ T) < 0.15
    assert estimate.iterations < 500


def test_noise_alone_has_no_consensus_and_planar_samples_no_model() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(NoConsensus):
        estimate_projection(rng.uniform(-1, 1, (40, 3)), rng.uniform(0, 700, (40, 2)), rng, max_iterations=200)
    flat = np.column_stack((rng.uniform(-1, 1, (10, 2)), np.zeros(10)))
    model = ProjectionModel(flat, project(P, flat))
    assert len(model.generate(np.arange(6)[None])) == 0
