# SPDX-License-Identifier: Apache-2.0
"""Residuals that neighbours share: noise draws have none, smooth fields have."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.vision.estimation.covariance import window_correlation
from imgu_ros.vision.projective.homography import smooth_misfit_unchecked
from imgu_ros.vision.projective.plane_motion import PlaneMotion


def left_over(points: np.ndarray, displacements: np.ndarray) -> np.ndarray:
    """Return the residuals of a projective motion, by numpy's least squares."""
    rows = PlaneMotion(points).by_parameters.reshape(-1, 8)
    motion, *_ = np.linalg.lstsq(rows, displacements.ravel(), rcond=None)
    return (displacements.ravel() - rows @ motion).reshape(-1, 2)


@pytest.mark.parametrize("window_px", [0, 90])
def test_noise_is_1_on_average_and_seldom_more_than_3(window_px: int) -> None:
    """Independent errors, and those of windows that overlap."""
    rng = np.random.default_rng(2)
    points = rng.uniform(0, 600, (150, 2))
    correlation = window_correlation(points, window_px) if window_px else None
    root = np.eye(150) if correlation is None else np.linalg.cholesky(correlation + 1e-9 * np.eye(150))
    used = np.ones(150, bool)
    told = []
    for _ in range(300):
        residuals = left_over(points, root @ rng.normal(0, 0.2, (150, 2)))
        told.append(smooth_misfit_unchecked(points, residuals, used, 0.2**2, correlation))
    assert 0.85 < np.mean(told) < 1.25
    assert np.mean(np.array(told) > 2.96) < 0.02


@pytest.mark.parametrize("seed", range(5))
def test_a_smooth_field_that_no_homography_makes_is_seen(seed: int) -> None:
    """A sway of half a pixel, as of a rolling shutter, in noise of 0.1 px."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 600, (150, 2))
    sway = np.column_stack((0.5 * np.sin(points[:, 1] / 70), np.zeros(150)))
    residuals = left_over(points, sway + rng.normal(0, 0.1, (150, 2)))
    variance = float((residuals**2).sum()) / (300 - 8)
    assert smooth_misfit_unchecked(points, residuals, np.ones(150, bool), variance) > 4


def test_it_depends_on_nothing_but_the_residuals_in_use() -> None:
    rng = np.random.default_rng(4)
    points, residuals = rng.uniform(0, 600, (80, 2)), rng.normal(size=(80, 2))
    used = rng.uniform(size=80) < 0.7
    told = smooth_misfit_unchecked(points, residuals, used, 1.0)
    assert_allclose(smooth_misfit_unchecked(3 * points + 7, 5 * residuals, used, 25.0), told)
    wild = np.where(used[:, None], residuals, 1e6)
    assert_allclose(smooth_misfit_unchecked(points, wild, used, 1.0), told)
    assert_allclose(smooth_misfit_unchecked(points, residuals, used, 1.0, np.eye(80)), told)


def test_too_little_tells_nothing() -> None:
    points = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])
    assert smooth_misfit_unchecked(points, np.ones((4, 2)), np.ones(4, bool), 1.0) == 1.0
    assert smooth_misfit_unchecked(points, np.ones((4, 2)), np.zeros(4, bool), 1.0) == 1.0
    assert smooth_misfit_unchecked(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, bool), 1.0) == 1.0
    assert smooth_misfit_unchecked(points, np.zeros((4, 2)), np.ones(4, bool), 0.0) == 1.0
