# SPDX-License-Identifier: Apache-2.0
"""Condensed homographies against known motions and outliers, the points themselves, and many draws of noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError
from imgu_ros.vision.projective.fit import fit_homography
from imgu_ros.vision.projective.homography import (
    HomographyNormalEquations,
    homography_normal_equations,
    normalised_homography,
    tangent_basis,
)
from imgu_ros.vision.projective.plane_motion import PlaneMotion
from imgu_ros.vision.projective.transform import transform

H = np.array([[0.9, -0.2, 40.0], [0.15, 1.1, -20.0], [2e-4, -1e-4, 1.0]])
SRC_TO_POINTS = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1]])


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(5).uniform(0, 600, (200, 2))


def nearly(shift_px: float) -> np.ndarray:
    return np.array([[1, 0, shift_px], [0, 1, -shift_px], [0, 0, 1]]) @ H


def displaced(points: np.ndarray, start: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The displacements that say that `points`, looked for by `start`, are seen at `seen`."""
    return points - transform(np.linalg.inv(start), seen)


def condensed(points: np.ndarray, start: np.ndarray, seen: np.ndarray, **options: object) -> HomographyNormalEquations:
    motions = PlaneMotion(points)
    displacements = displaced(points, start, seen)
    motion = motions.fit(displacements, np.ones(len(points), bool))
    return homography_normal_equations(motions, displacements, motion, start, np.eye(3), **options)


def test_exact_points_give_the_homography_though_the_start_is_off(points: np.ndarray) -> None:
    found = condensed(points, nearly(0.5), transform(H, points))
    assert found.estimate.inliers.all()
    assert_allclose(transform(found.estimate.H, points), transform(H, points), atol=2e-3)


def test_the_estimate_maps_the_callers_pixels(points: np.ndarray) -> None:
    motions = PlaneMotion(points)
    displacements = displaced(points, nearly(0.1), transform(H, points))
    motion = motions.fit(displacements, np.ones(len(points), bool))
    found = homography_normal_equations(motions, displacements, motion, nearly(0.1), SRC_TO_POINTS)
    src = transform(np.linalg.inv(SRC_TO_POINTS), points)
    assert_allclose(transform(found.estimate.H, src), transform(H, points), atol=1e-3)
    assert_allclose(found.estimate.H, normalised_homography(H @ SRC_TO_POINTS), atol=1e-6)
    back = np.linalg.solve(found.T_dst, found.scaled @ found.T_src)
    assert_allclose(normalised_homography(back), found.estimate.H, atol=1e-12)


def test_outliers_are_left_out_and_good_points_stay(points: np.ndarray) -> None:
    rng = np.random.default_rng(6)
    dst = transform(H, points) + rng.normal(0, 0.05, points.shape)
    bad = rng.random(len(points)) < 0.25
    dst[bad] += rng.choice([-1, 1], (bad.sum(), 2)) * rng.uniform(0.6, 1.0, (bad.sum(), 2))
    found = condensed(points, nearly(0.2), dst)
    assert not (found.estimate.inliers & bad).any()
    assert found.estimate.inliers[~bad].mean() > 0.97
    assert_allclose(transform(found.estimate.H, points), transform(H, points), atol=0.06)


def test_noise_free_points_are_not_trimmed_by_rounding(points: np.ndarray) -> None:
    dst = np.round(transform(H, points) * 1e3) / 1e3
    assert condensed(points, H, dst).estimate.inliers.all()


def test_the_cost_of_another_homography_is_that_of_its_points(points: np.ndarray) -> None:
    """`squares` + delta^T `normal` delta against the distances' own sum of squares, with a third left out."""
    rng = np.random.default_rng(7)
    dst = transform(H, points) + rng.normal(0, 0.1, points.shape)
    dst[:66] += 30.0
    found = condensed(points, H, dst)
    kept = found.estimate.inliers
    assert not kept[:66].any()
    basis = tangent_basis(found.scaled)
    for scale in (1e-5, 1e-4):
        delta = rng.normal(0, scale, 8)
        moved = (found.scaled.ravel() + basis @ delta).reshape(3, 3)
        other = np.linalg.solve(found.T_dst, moved @ found.T_src)
        away = transform(other, points[kept]) - dst[kept]
        cost = float((away**2).sum()) * found.T_dst[0, 0] ** 2
        assert cost == pytest.approx(found.squares + delta @ found.normal @ delta, rel=0.02)


def test_it_is_the_fit_of_the_points(points: np.ndarray) -> None:
    rng = np.random.default_rng(8)
    dst = transform(H, points) + rng.normal(0, 0.05, points.shape)
    found = condensed(points, H, dst)
    kept = found.estimate.inliers
    fit = fit_homography(points[kept], dst[kept], error="transfer")
    assert_allclose(transform(found.estimate.H, points), transform(fit.H, points), atol=2e-4)
    assert_allclose(found.estimate.covariance, fit.covariance, rtol=0.01, atol=1e-3 * np.abs(fit.covariance).max())
    assert found.estimate.rms_px == pytest.approx(fit.rms_px, rel=1e-3)


@pytest.mark.parametrize("correlated", [False, True])
def test_normalised_squared_errors_are_chi_squared(correlated: bool) -> None:
    """Over draws of noise, of which pairs of points share theirs; 8 degrees of freedom."""
    rng = np.random.default_rng(9)
    points = rng.uniform(0, 600, (80, 2))
    correlation = np.eye(80)
    if correlated:
        points[40:] = points[:40] + rng.uniform(-4, 4, (40, 2))
        correlation += np.diag(np.full(40, 0.9), 40) + np.diag(np.full(40, 0.9), -40)
    root = np.linalg.cholesky(correlation)
    truth = normalised_homography(H)
    basis = tangent_basis(truth)
    squared = []
    for _ in range(200):
        displacements = displaced(points, H, transform(H, points)) + root @ rng.normal(0, 0.1, (80, 2))
        motions = PlaneMotion(points)
        motion = motions.fit(displacements, np.ones(80, bool))
        found = homography_normal_equations(motions, displacements, motion, H, np.eye(3), correlation)
        error = basis.T @ (found.estimate.H - truth).ravel()
        squared.append(error @ np.linalg.solve(basis.T @ found.estimate.covariance @ basis, error))
    # The mean of 200 has a standard deviation of 0.28; trimming takes a few per cent of the noise away.
    assert 7.0 < np.mean(squared) < 10.2


def test_the_covariance_grows_with_what_the_homography_cannot_follow() -> None:
    """A sway of half a pixel of whole rows, as of a rolling shutter, in noise of 0.05 px."""
    rng = np.random.default_rng(5)
    points = rng.uniform(0, 600, (120, 2))
    noise = rng.normal(0, 0.05, (120, 2))
    sway = np.column_stack((0.5 * np.sin(points[:, 1] / 60), np.zeros(120)))
    motions = PlaneMotion(points)
    still, swaying = (
        homography_normal_equations(motions, d, motions.fit(d, np.ones(120, bool)), np.eye(3), np.eye(3))
        for d in (noise, noise + sway)
    )
    spread = np.trace(swaying.estimate.covariance) / np.trace(still.estimate.covariance)
    assert spread > 3 * (swaying.estimate.rms_px / still.estimate.rms_px) ** 2
    count = np.count_nonzero(still.estimate.inliers)
    assert still.noise == pytest.approx(np.sqrt(still.squares / (2 * count - 8)))


def test_what_cannot_be_fitted_is_refused(points: np.ndarray) -> None:
    dst = transform(H, points)
    with pytest.raises(DegenerateConfiguration, match="coincide"):
        PlaneMotion(np.zeros((10, 2)))
    motions = PlaneMotion(points)
    displacements = displaced(points, H, dst)
    motion = motions.fit(displacements, np.ones(len(points), bool))
    with pytest.raises(ShapeError, match="displacements"):
        homography_normal_equations(motions, displacements[:-1], motion, H, np.eye(3))
    with pytest.raises(ShapeError, match="at least 5"):
        homography_normal_equations(motions, displacements, motion, H, np.eye(3), min_points=4)
    with pytest.raises(NoConsensus, match="need 201"):
        homography_normal_equations(motions, displacements, motion, H, np.eye(3), min_points=201)
    line = np.column_stack((np.arange(20.0), np.zeros(20)))
    with pytest.raises(NoConsensus, match="span the plane"):
        PlaneMotion(line).fit(np.zeros((20, 2)), np.ones(20, bool))
    affine = PlaneMotion(points, affine=True)
    with pytest.raises(ShapeError, match="projective"):
        homography_normal_equations(affine, displacements, affine.fit(displacements, np.ones(200, bool)), H, np.eye(3))
