# SPDX-License-Identifier: Apache-2.0
"""The robust estimators that the pipeline chooses from, each on matches whose truth is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from imgu_ros.errors import EstimationError, NoConsensus
from imgu_ros.simulate.plane_matches import plane_matches
from imgu_ros.vision.methods import ESTIMATORS
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.robust import (
    HomographyEstimator,
    RansacParameters,
    UsacParameters,
    usac_magsac_estimator,
    usac_then_ransac_estimator,
)
from imgu_ros.vision.projective.transform import normalised_homography, transform

#: Matches of `plane_matches` are in no order.
UNIFORM = {
    "ransac": RansacParameters(sampler="uniform"),
    "usac_then_ransac": RansacParameters(sampler="uniform"),
    "usac_magsac": UsacParameters(),
}


def estimator(name: str) -> HomographyEstimator:
    made: HomographyEstimator = ESTIMATORS[name].made(UNIFORM[name])
    return made


def test_every_row_is_tested() -> None:
    assert set(UNIFORM) == set(ESTIMATORS)


@pytest.mark.parametrize("name", UNIFORM)
@pytest.mark.parametrize("share", [0.2, 0.6])
def test_the_true_matches_are_found(name: str, share: float) -> None:
    """Of errors of 1 px in x and y, 1.1 % lie beyond 3 px."""
    recall, corners = [], []
    for seed in range(6):
        matches = plane_matches("uniform", share, 0.4, seed)
        found = estimator(name)(matches.src, matches.dst, 3.0, seed)
        assert np.linalg.norm(found.H) == pytest.approx(1)
        distance = np.hypot(*(transform(found.H, matches.src) - matches.dst).T)
        np.testing.assert_array_equal(found.inliers, distance <= 3.0)
        recall.append(found.inliers[matches.true].mean())
        corners.append(matches.corner_error(found.H))
    assert np.mean(recall) > 0.96
    assert np.median(corners) < 4


@pytest.mark.parametrize("name", UNIFORM)
def test_the_same_seed_gives_the_same_homography(name: str) -> None:
    matches = plane_matches("uniform", 0.6, 0.4, 3)
    first, second = (estimator(name)(matches.src, matches.dst, 3.0, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first.H, second.H)
    np.testing.assert_array_equal(first.inliers, second.inliers)


@pytest.mark.parametrize("name", UNIFORM)
@pytest.mark.parametrize("count", [8, 20, 200])
def test_random_pairs_are_no_plane(name: str, count: int) -> None:
    for seed in range(5):
        src, dst = np.random.default_rng(seed).uniform(0, 500, (2, count, 2))
        with pytest.raises(EstimationError):
            estimator(name)(src, dst, 3.0, seed)


@pytest.mark.parametrize("name", UNIFORM)
def test_a_plane_seen_mirrored_is_no_answer(name: str) -> None:
    matches = plane_matches("uniform", 0.2, 0.4, 1)
    with pytest.raises(EstimationError):
        estimator(name)(matches.src * (-1, 1), matches.dst, 3.0, 0)


@pytest.mark.skipif(int(cv2.__version__[0]) < 5, reason="needs OpenCV 5: USAC of earlier ones is not used")
def test_samples_are_drawn_only_where_the_proposal_may_be_chance() -> None:
    easy, hard = plane_matches("uniform", 0.3, 0.4, 2), plane_matches("uniform", 0.95, 0.4, 2)
    both = usac_then_ransac_estimator(RansacParameters(sampler="uniform", min_inliers=5, max_iterations=20))
    assert both(easy.src, easy.dst, 3.0, 0).iterations == 0
    with pytest.raises(NoConsensus, match=r"after 20 samples|by chance"):
        both(hard.src, hard.dst, 3.0, 0)


def test_the_biweight_score_is_that_of_ransac() -> None:
    matches = plane_matches("uniform", 0.8, 0.3, 4)
    parameters = RansacParameters(sampler="uniform", score="biweight")
    first, second = (
        ESTIMATORS[name].made(parameters)(matches.src, matches.dst, 3.0, 1) for name in ("ransac", "usac_then_ransac")
    )
    np.testing.assert_array_equal(first.H, second.H)
    assert second.iterations > 0


def test_chance_is_asked_as_the_caller_wants() -> None:
    """Ten random pairs, most of which some homography explains to 60 px: an answer where chance is not asked."""
    src, dst = np.random.default_rng(1).uniform(0, 200, (2, 10, 2))
    magsac = usac_magsac_estimator(UsacParameters(min_inliers=4))
    with pytest.raises(NoConsensus, match="by chance"):
        magsac(src, dst, 60.0, 0)
    assert magsac(src, dst, 60.0, 0, np.inf).inliers.sum() >= 5


def test_a_hypothesis_of_a_homography_is_that_homography() -> None:
    matches = plane_matches("uniform", 0.5, 0.4, 0)
    model = HomographyModel(matches.src, matches.dst)
    (hypothesis,) = model.normalised(-7 * matches.H, matches.true)
    np.testing.assert_allclose(model.denormalised(hypothesis), normalised_homography(matches.H), atol=1e-9)
    assert len(model.normalised(matches.H @ np.diag((-1, 1, 1)), matches.true)) == 0
    assert len(model.normalised(np.zeros((3, 3)), matches.true)) == 0
    assert len(model.normalised(matches.H, np.zeros(len(matches.src), bool))) == 0
