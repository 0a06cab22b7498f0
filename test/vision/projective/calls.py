# SPDX-License-Identifier: Apache-2.0
"""A valid call of the public functions of vision/projective that need no correspondences, for test_hostile.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.vision.projective.cross_ratio import cross_ratio, cross_ratio_of_lines
from imgu_ros.vision.projective.decomposition import decompose_affine, decompose_homography
from imgu_ros.vision.projective.hierarchy import classify
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.points_and_lines import (
    cartesian,
    homogeneous,
    join,
    line_distances,
    meet,
    normalised_lines,
    normalised_points,
    points_at_infinity,
    transform_lines,
    transform_points,
)
from imgu_ros.vision.projective.transform import area_factor, faces_camera, inverse3, local_jacobian, transform
from imgu_ros.vision.projective.transformations import (
    affine,
    cofactors,
    compose,
    euclidean,
    inverse,
    projective,
    require_regular,
    rotation,
    scaling,
    shear_x,
    shear_y,
    similarity,
    translation,
)

H = np.array([[1.2, 0.1, 5.0], [-0.2, 0.9, 3.0], [1e-4, 2e-4, 1.0]])


def _points(rng: np.random.Generator, count: int = 8) -> np.ndarray:
    return rng.uniform(1, 100, (count, 2))


def _rows(rng: np.random.Generator, count: int = 8) -> np.ndarray:
    return rng.normal(size=(count, 3))


def composed(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return compose(first, second)


CALLS: dict[Callable[..., object], Callable[[np.random.Generator], dict[str, object]]] = {
    transform: lambda rng: {"H": H.copy(), "points": _points(rng)},
    inverse3: lambda rng: {"matrix": H.copy()},
    area_factor: lambda rng: {"H": H.copy(), "point": _points(rng)[0]},
    local_jacobian: lambda rng: {"H": H.copy(), "points": _points(rng)},
    normalised_homography: lambda rng: {"H": H.copy()},
    faces_camera: lambda rng: {"H": H.copy(), "points": _points(rng)},
    translation: lambda rng: {"t": rng.normal(size=2)},
    rotation: lambda rng: {"angle_rad": 0.3, "about": rng.normal(size=2)},
    euclidean: lambda rng: {"angle_rad": 0.3, "t": rng.normal(size=2)},
    similarity: lambda rng: {"scale": 2.0, "angle_rad": 0.3, "t": rng.normal(size=2)},
    scaling: lambda rng: {"x": 2.0, "y": 0.3},
    shear_x: lambda rng: {"factor": 2.0},
    shear_y: lambda rng: {"factor": 2.0},
    affine: lambda rng: {"A": H[:2, :2].copy(), "t": rng.normal(size=2)},
    projective: lambda rng: {"A": H[:2, :2].copy(), "t": rng.normal(size=2), "v": 0.01 * rng.normal(size=2)},
    composed: lambda rng: {"first": H.copy(), "second": H.T.copy()},
    compose: lambda rng: {},
    inverse: lambda rng: {"H": H.copy()},
    cofactors: lambda rng: {"H": H.copy()},
    require_regular: lambda rng: {"matrix": H.copy(), "size": 3, "name": "H"},
    classify: lambda rng: {"H": H.copy(), "tolerance": 1e-6, "extent": 100.0},
    join: lambda rng: {"points": _points(rng), "others": _rows(rng)},
    meet: lambda rng: {"lines": _rows(rng), "others": _rows(rng)},
    homogeneous: lambda rng: {"points": _points(rng)},
    cartesian: lambda rng: {"points": _rows(rng)},
    points_at_infinity: lambda rng: {"directions": _points(rng)},
    normalised_points: lambda rng: {"points": _rows(rng)},
    normalised_lines: lambda rng: {"lines": _rows(rng)},
    transform_points: lambda rng: {"H": H.copy(), "points": _rows(rng)},
    transform_lines: lambda rng: {"H": H.copy(), "lines": _rows(rng)},
    line_distances: lambda rng: {"points": _points(rng), "lines": _rows(rng)},
    cross_ratio: lambda rng: {"points": np.outer([1.0, 2, 4, 7], rng.normal(size=2)) + 5, "tolerance": 1e-6},
    cross_ratio_of_lines: lambda rng: {
        "lines": np.array([1.0, 2, 4, 7])[:, None] * rng.normal(size=3) + rng.normal(size=3),
        "tolerance": 1e-6,
    },
    decompose_homography: lambda rng: {"H": H.copy()},
    decompose_affine: lambda rng: {"A": H[:2, :2].copy()},
}
