# SPDX-License-Identifier: Apache-2.0
"""A valid call of the public functions of vision/projective that fit motions to displacements, for test_hostile.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.types import Floats, Mask, Matrix3, Points
from imgu_ros.vision.projective.homography import HomographyNormalEquations, homography_normal_equations
from imgu_ros.vision.projective.logarithm import exponential, logarithm
from imgu_ros.vision.projective.plane_motion import BlurGain, Motion, PlaneMotion

POINTS = np.array([[x + 3.0 * (y == 50), y] for y in (0.0, 50.0, 100.0) for x in (0.0, 40.0, 80.0, 120.0)])
H = np.array([[1.2, 0.1, 5.0], [-0.2, 0.9, 3.0], [1e-4, 2e-4, 1.0]])
FROM_SRC = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1]])


def displaced(rng: np.random.Generator) -> Points:
    return POINTS @ np.array([[0.01, 0.02], [-0.01, 0.02]]) + 0.5 + rng.normal(0, 0.05, POINTS.shape)


def fitted(points: Points, displacements: Points, usable: Mask) -> Motion:
    return PlaneMotion(points).fit(displacements, usable)


def fitted_twice(displacements: Points, usable: Mask, floor_px: float) -> Motion:
    motions = PlaneMotion(POINTS, affine=True)
    before = motions.fit(displaced(np.random.default_rng(0))[:8], np.ones(8, bool))
    return motions.fit(displacements, usable, floor_px, motions.fit(displacements, usable, floor_px, before))


def condensed(displacements: Points, H: Matrix3, from_src: Matrix3, correlation: Floats) -> HomographyNormalEquations:
    """Condensed, from a motion that was told by other displacements."""
    motions = PlaneMotion(POINTS)
    start = motions.fit(displaced(np.random.default_rng(0)), np.ones(12, bool))
    return homography_normal_equations(motions, displacements, start, H, from_src, correlation)


def one_left_out(displacements: Points, H: Matrix3, correlation: Floats) -> HomographyNormalEquations:
    motions = PlaneMotion(POINTS)
    start = motions.fit(displaced(np.random.default_rng(0)), np.arange(12) != 5)
    return homography_normal_equations(motions, displacements, start, H, np.eye(3), correlation)


def learned(applied: Points, change: Points, measured: Points) -> Points:
    response = BlurGain()
    response.learn(applied, change)
    return response.corrected(measured)


def small(rng: np.random.Generator) -> Points:
    return rng.normal(0, 0.3, (7, 2))


CALLS: dict[Callable[..., object], Callable[[np.random.Generator], dict[str, object]]] = {
    PlaneMotion: lambda rng: {"points": POINTS.copy()},
    PlaneMotion.fit: lambda rng: {
        "self": PlaneMotion(POINTS),
        "displacements": displaced(rng),
        "usable": np.arange(12) != 7,
        "floor_px": 0.01,
    },
    exponential: lambda rng: {"L": rng.normal(0, 0.3, (3, 3))},
    logarithm: lambda rng: {"H": np.eye(3) + rng.normal(0, 0.05, (3, 3))},
    PlaneMotion.inverse: lambda rng: {"self": PlaneMotion(POINTS), "motion": rng.normal(0, 0.01, 8)},
    PlaneMotion.matrix: lambda rng: {"self": PlaneMotion(POINTS), "motion": rng.normal(0, 0.01, 8)},
    fitted: lambda rng: {"points": POINTS.copy(), "displacements": displaced(rng), "usable": np.ones(12, bool)},
    fitted_twice: lambda rng: {"displacements": displaced(rng), "usable": np.ones(12, bool), "floor_px": 0.1},
    homography_normal_equations: lambda rng: {
        "motions": PlaneMotion(POINTS),
        "displacements": displaced(rng),
        "start": PlaneMotion(POINTS).fit(displaced(rng), np.ones(12, bool)),
        "H_dst_points": H.copy(),
        "points_from_src": FROM_SRC.copy(),
    },
    condensed: lambda rng: {
        "displacements": displaced(rng),
        "H": H.copy(),
        "from_src": FROM_SRC.copy(),
        "correlation": np.eye(12),
    },
    one_left_out: lambda rng: {
        "displacements": displaced(rng),
        "H": H.copy(),
        "correlation": 0.9 * np.eye(12) + 0.1,
    },
    BlurGain.learn: lambda rng: {"self": BlurGain(), "applied": small(rng), "change": small(rng)},
    BlurGain.corrected: lambda rng: {"self": BlurGain(), "measured": small(rng)},
    learned: lambda rng: {"applied": small(rng), "change": small(rng), "measured": small(rng)},
}
