# SPDX-License-Identifier: Apache-2.0
"""Homographies of four points, in batches."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.transform import transform

H_TRUE = normalised_homography([[0.8, -0.3, 200.0], [0.25, 0.9, 50.0], [2e-4, -1e-4, 1.0]])


def test_every_good_sample_gives_the_truth() -> None:
    rng = np.random.default_rng(0)
    src = rng.uniform(0, 1000, (30, 2))
    model = HomographyModel(src, transform(H_TRUE, src))
    samples = np.stack([rng.permutation(30)[:4] for _ in range(40)])
    hypotheses = model.generate(samples)
    assert len(hypotheses) >= 35
    assert_allclose([model.denormalised(H) for H in hypotheses], np.tile(H_TRUE, (len(hypotheses), 1, 1)), atol=1e-9)
    assert model.squared_errors(hypotheses).max() < 1e-10


def test_errors_are_in_the_callers_pixels() -> None:
    src = np.random.default_rng(1).uniform(0, 1000, (20, 2))
    dst = transform(H_TRUE, src)
    dst[7] += (3, 4)
    model = HomographyModel(src, dst)
    errors = model.squared_errors(model.generate(np.array([[0, 1, 2, 3]])))
    assert np.sqrt(errors[0, 7]) == pytest.approx(5, rel=1e-9)


def test_collinear_and_mirrored_samples_give_nothing() -> None:
    src = np.array([[0.0, 0], [1, 1], [2, 2], [5, 1], [1, 5]])
    model = HomographyModel(src, src)
    assert len(model.generate(np.array([[0, 1, 2, 3]]))) == 0
    assert len(model.generate(np.array([[0, 1, 3, 4]]))) == 1
    mirrored = HomographyModel(src, src * [-1, 1])
    assert len(mirrored.generate(np.array([[0, 1, 3, 4]]))) == 0


def test_coincident_points_raise() -> None:
    with pytest.raises(DegenerateConfiguration, match="coincide"):
        HomographyModel(np.ones((5, 2)), np.ones((5, 2)))
