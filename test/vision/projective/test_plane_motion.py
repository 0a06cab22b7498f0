# SPDX-License-Identifier: Apache-2.0
"""Motions of a plane from displacements, against the motions that made them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from imgu_ros.errors import DegenerateConfiguration, NoConsensus, ShapeError
from imgu_ros.vision.projective.plane_motion import PlaneMotion
from imgu_ros.vision.projective.transform import transform

POINTS = np.random.default_rng(1).uniform((20, 50), (700, 500), (120, 2))
ALL = np.ones(len(POINTS), bool)
small = st.floats(-1e-3, 1e-3)


@given(st.lists(small, min_size=8, max_size=8), st.booleans())
def test_the_motion_that_moved_the_points_is_found(parameters: list[float], affine: bool) -> None:
    motions = PlaneMotion(POINTS, affine)
    motion = np.array(parameters)
    if affine:
        motion[6:] = 0
    moved = transform(motions.matrix(motion), POINTS) - POINTS
    found = motions.fit(moved, ALL)
    # To first order: what is left is of the size of the motion squared.
    assert_allclose(transform(motions.matrix(found.parameters), POINTS) - POINTS, moved, atol=2e-3)
    assert found.largest_px == pytest.approx(np.abs(moved).max(), abs=2e-3)
    assert_allclose(found.parameters, motion, atol=1e-5)


@pytest.mark.parametrize("wrong", [0.3, 0.45])
def test_most_displacements_decide(wrong: float) -> None:
    rng = np.random.default_rng(2)
    motions = PlaneMotion(POINTS)
    matrix = motions.matrix(rng.normal(0, 2e-3, 8))
    moved = transform(matrix, POINTS) - POINTS + rng.normal(0, 0.05, POINTS.shape)
    bad = rng.random(len(POINTS)) < wrong
    moved[bad] = rng.uniform(-5, 5, (bad.sum(), 2))
    found = motions.fit(moved, ALL)
    far = bad & (np.hypot(*(moved - transform(matrix, POINTS) + POINTS).T) > 0.5)
    assert found.agreeing[far].mean() < 0.05
    assert found.agreeing[~bad].mean() > 0.95
    assert_allclose(transform(motions.matrix(found.parameters), POINTS), transform(matrix, POINTS), atol=0.12)
    assert found.sigma_px == pytest.approx(0.05, rel=0.6 if wrong < 0.4 else 2.0)


def test_unusable_ones_do_not_count_and_the_first_ones_do_alone() -> None:
    motions = PlaneMotion(POINTS)
    moved = np.tile([0.4, -0.2], (len(POINTS), 1))
    usable = ALL.copy()
    usable[::2] = False
    moved[::2] = 100.0
    found = motions.fit(moved, usable)
    assert_allclose(
        transform(motions.matrix(found.parameters), POINTS) - POINTS, np.tile([0.4, -0.2], (len(POINTS), 1)), atol=1e-3
    )
    assert not found.agreeing[::2].any() and found.agreeing[1::2].all()
    first = motions.fit(moved[:30], usable[:30])
    assert len(first.agreeing) == 30
    again = motions.fit(moved, usable, before=first)
    assert_allclose(again.parameters, found.parameters, atol=1e-6)
    assert_allclose(motions.fit(moved, usable, before=found).parameters, found.parameters, atol=1e-6)


def test_too_few_and_misfitting_arrays_are_refused() -> None:
    motions = PlaneMotion(POINTS)
    with pytest.raises(NoConsensus, match="need 6"):
        motions.fit(np.zeros((5, 2)), np.ones(5, bool))
    with pytest.raises(ShapeError, match="up to 120"):
        motions.fit(np.zeros((121, 2)), np.ones(121, bool))
    with pytest.raises(ShapeError):
        PlaneMotion(np.zeros((0, 2)))


def test_the_inverse_takes_a_motion_back() -> None:
    motions = PlaneMotion(POINTS)
    motion = np.random.default_rng(2).normal(0, 0.05, 8)
    product = motions.inverse(motion) @ motions.matrix(motion)
    assert_allclose(product / product[2, 2], np.eye(3), atol=1e-9)
    for squeezed in ([-1.0, 0, 0, 0, 0, 0, 0, 0], [-2.0, 0, 0, 0, 0, 0, 0, 0]):
        with pytest.raises(DegenerateConfiguration, match="motion"):
            motions.inverse(np.array(squeezed))
