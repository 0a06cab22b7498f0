"""Condensed homographies against known outliers, the uncondensed fit, and the cost of other homographies."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError
from imgu_ros.vision.projective.condensed import condensed_homography
from imgu_ros.vision.projective.transform import normalised_homography, transform

H = np.array([[0.9, -0.2, 40.0], [0.15, 1.1, -20.0], [2e-4, -1e-4, 1.0]])


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(5).uniform(0, 600, (200, 2))


def nearly(shift_px: float) -> np.ndarray:
    return np.array([[1, 0, shift_px], [0, 1, -shift_px], [0, 0, 1]]) @ H


def test_exact_points_give_the_homography_though_the_start_is_off(points: np.ndarray) -> None:
    found = condensed_homography(points, transform(H, points), nearly(0.5), 1.5)
    assert found.estimate.inliers.all()
    assert_allclose(transform(found.estimate.H, points), transform(H, points), atol=1e-3)


def test_outliers_are_left_out_and_good_points_stay(points: np.ndarray) -> None:
    rng = np.random.default_rng(6)
    dst = transform(H, points) + rng.normal(0, 0.05, points.shape)
    bad = rng.random(len(points)) < 0.25
    dst[bad] += rng.choice([-1, 1], (bad.sum(), 2)) * rng.uniform(0.6, 1.0, (bad.sum(), 2))
    found = condensed_homography(points, dst, nearly(0.2), 1.5)
    assert not (found.estimate.inliers & bad).any()
    assert found.estimate.inliers[~bad].mean() > 0.97
    assert_allclose(transform(found.estimate.H, points), transform(H, points), atol=0.06)


def test_noise_free_points_are_not_trimmed_by_rounding(points: np.ndarray) -> None:
    dst = np.round(transform(H, points) * 1e3) / 1e3
    assert condensed_homography(points, dst, H, 1.5).estimate.inliers.all()


def test_points_behind_the_camera_are_left_out(points: np.ndarray) -> None:
    src = np.vstack((points, [[-9000.0, 0.0]]))  # w < 0 there
    dst = np.vstack((transform(H, points), [[0.0, 0.0]]))
    found = condensed_homography(src, dst, H, 1.5)
    assert found.estimate.inliers[:-1].all() and not found.estimate.inliers[-1]


def test_what_cannot_be_fitted_is_refused(points: np.ndarray) -> None:
    dst = transform(H, points)
    with pytest.raises(NoConsensus, match="need 5"):
        condensed_homography(points, dst + 50, H, 1.5)
    with pytest.raises(NoConsensus, match="3 correspondences agree"):
        condensed_homography(points[:3], dst[:3], H, 1.5)
    with pytest.raises(DegenerateConfiguration, match="coincide"):
        condensed_homography(np.zeros((10, 2)), np.zeros((10, 2)), np.eye(3), 1.5)
    line = np.column_stack((np.arange(20.0), np.zeros(20)))
    with pytest.raises(DegenerateConfiguration, match="line"):
        condensed_homography(line, line, np.eye(3), 1.5)
    with pytest.raises(ShapeError, match="need 200"):
        condensed_homography(points, dst[:-1], H, 1.5)
    with pytest.raises(ShapeError, match="need > 0"):
        condensed_homography(points, dst, H, 0.0)


def test_result_has_unit_norm(points: np.ndarray) -> None:
    found = condensed_homography(points, transform(H, points), 7 * H, 1.5)
    assert_allclose(found.estimate.H, normalised_homography(H), atol=1e-6)
