# SPDX-License-Identifier: Apache-2.0
"""Rotations from directions: exact, against scipy, and among outliers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from imgu_ros.errors import DegenerateConfiguration, ShapeError, TooFewPoints
from imgu_ros.vision.estimation.directions import DirectionsModel, align_directions
from imgu_ros.vision.estimation.ransac import ransac


@pytest.mark.parametrize("count", [2, 3, 20])
def test_exact_and_as_scipy_has_it(count: int) -> None:
    rng = np.random.default_rng(count)
    R = Rotation.random(random_state=count).as_matrix()
    src = rng.normal(size=(count, 3))
    assert_allclose(align_directions(src, 5 * src @ R.T), R, atol=1e-12)
    noisy = src @ R.T + rng.normal(0, 0.1, (count, 3))
    unit = [v / np.linalg.norm(v, axis=1)[:, None] for v in (noisy, src)]
    weights = rng.uniform(0.1, 1, count)
    assert_allclose(
        align_directions(src, noisy, weights), Rotation.align_vectors(*unit, weights)[0].as_matrix(), atol=1e-9
    )


def test_never_a_reflection() -> None:
    src = np.eye(3)
    R = align_directions(src, src * [1, 1, -1])
    assert np.linalg.det(R) == pytest.approx(1)


def test_two_thirds_are_outliers() -> None:
    rng = np.random.default_rng(0)
    R = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    src = rng.normal(size=(120, 3))
    dst = src @ R.T
    dst[40:] = rng.normal(size=(80, 3))
    dst[:40] += rng.normal(0, 0.002, (40, 3)) * np.linalg.norm(dst[:40], axis=1)[:, None]
    for score in ("truncated", "biweight"):
        consensus = ransac(DirectionsModel(src, dst), 0.01, np.random.default_rng(1), score=score)
        assert consensus.inliers[:40].all()
        assert np.count_nonzero(consensus.inliers) <= 43
        angle = Rotation.from_matrix(consensus.hypothesis @ R.T).magnitude()
        assert angle < 0.002


def test_bad_directions() -> None:
    with pytest.raises(TooFewPoints):
        align_directions([[1, 0, 0]], [[1, 0, 0]])
    with pytest.raises(DegenerateConfiguration, match="parallel"):
        align_directions([[1, 0, 0], [-2, 0, 0]], [[0, 1, 0], [0, 1, 0]])
    with pytest.raises(DegenerateConfiguration, match="length 0"):
        align_directions(np.zeros((2, 3)), np.ones((2, 3)))
    with pytest.raises(ShapeError, match="weights"):
        align_directions(np.eye(3), np.eye(3), [0, 0, 0])
    with pytest.raises(TooFewPoints):
        DirectionsModel(np.eye(3), np.eye(3)[:2])
    parallel = DirectionsModel([[1, 0, 0], [2, 0, 0], [0, 1, 0]], np.eye(3))
    assert len(parallel.generate(np.array([[0, 1]]))) == 0
