# SPDX-License-Identifier: Apache-2.0
"""Responses against the linear maps that made the displacements, and on blurred pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.errors import ShapeError
from imgu_ros.vision.matching.patch_bank import PatchBank
from imgu_ros.vision.projective.plane_motion import BlurGain

TRUE = np.array([[0.4, 0.1], [0.1, 0.8]])


def test_without_motions_nothing_is_corrected() -> None:
    response = BlurGain()
    measured = np.array([[0.3, -0.2], [1.0, 0.0]])
    assert_allclose(response.corrected(measured), measured)
    response.learn(np.zeros((5, 2)), np.full((5, 2), 0.01))
    assert_allclose(response.matrix, np.eye(2), atol=0.05)
    assert_allclose(response.weakest, 1.0, atol=0.05)


def test_motions_tell_the_map() -> None:
    rng = np.random.default_rng(1)
    response = BlurGain()
    for _ in range(3):
        applied = rng.normal(0, 0.7, (60, 2))
        response.learn(applied, applied @ TRUE.T + rng.normal(0, 0.1, (60, 2)))
    assert_allclose(response.matrix, TRUE, atol=0.06)
    assert response.weakest == pytest.approx(np.linalg.svd(TRUE, compute_uv=False)[1], abs=0.06)
    assert_allclose(response.corrected(applied @ response.matrix.T), applied, atol=1e-9)


def test_a_motion_along_one_axis_tells_of_that_axis_alone() -> None:
    response = BlurGain()
    applied = np.column_stack((np.full(60, 0.8), np.zeros(60)))
    response.learn(applied, 0.5 * applied)
    assert_allclose(response.matrix, np.diag([0.5, 1.0]), atol=0.02)


def test_long_motions_and_absurd_ones_are_bounded() -> None:
    response = BlurGain()
    response.learn(np.full((10, 2), 5.0), np.zeros((10, 2)))
    assert_allclose(response.matrix, np.eye(2))
    response.learn(np.tile([[1.0, 0.0], [0.0, 1.0]], (30, 1)), -np.tile([[1.0, 0.0], [0.0, 1.0]], (30, 1)))
    assert response.weakest >= 0.2 - 1e-12
    response = BlurGain()
    response.learn(np.tile([[1.0, 0.0], [0.0, 1.0]], (30, 1)), 9 * np.tile([[1.0, 0.0], [0.0, 1.0]], (30, 1)))
    assert np.linalg.svd(response.matrix, compute_uv=False).max() <= 1.5 + 1e-12


def test_a_blurred_picture_responds_weakly_and_corrected_displacements_are_true() -> None:
    """Blurred along x only: displacements fall short there, and what was learnt puts that right."""
    rng = np.random.default_rng(2)
    sharp = cv2.GaussianBlur(rng.normal(0, 1, (200, 200)).astype(np.float32), (0, 0), 1.5)
    sharp = (sharp - sharp.min()) / np.ptp(sharp) * 255
    blurred = cv2.blur(sharp, (7, 1))
    centres = np.stack(np.meshgrid(np.arange(20, 181, 16), np.arange(20, 181, 16)), -1).reshape(-1, 2).astype(float)
    patches = PatchBank(sharp, centres, 11).select(np.arange(len(centres)))

    def measured(x: float, y: float) -> np.ndarray:
        """Displacements where the picture is looked at as if it lay at (x, y); it lies at (0, 0)."""
        return patches.displacements(patches.sampled(blurred, np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]))).xy

    response = BlurGain()
    # Seen at (x, y), patches lie at -(x, y): a displacement of (x, y) for each.
    at_first, later = measured(0.6, 0.4), measured(0.1, 0.1)
    response.learn(np.tile([0.5, 0.3], (len(centres), 1)), at_first - later)
    assert response.weakest < 0.85
    raw, corrected = (np.median(d, axis=0) for d in (at_first, response.corrected(at_first)))
    assert abs(corrected[0] - 0.6) < abs(raw[0] - 0.6)
    assert_allclose(corrected, [0.6, 0.4], atol=0.06)


def test_arrays_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ShapeError, match="change"):
        BlurGain().learn(np.zeros((3, 2)), np.zeros((4, 2)))
    with pytest.raises(ShapeError, match="measured"):
        BlurGain().corrected(np.zeros((3, 3)))
