# SPDX-License-Identifier: Apache-2.0
"""A valid call of the public functions of vision/projective that take correspondences, for test_hostile.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.vision.projective.checks import checked_pairs, finite
from imgu_ros.vision.projective.dlt import design_matrix, homography_dlt, normalisation
from imgu_ros.vision.projective.errors import (
    algebraic_error,
    reprojection_error,
    sampson_error,
    symmetric_transfer_error,
    transfer_error,
)
from imgu_ros.vision.projective.estimate import estimate_homography
from imgu_ros.vision.projective.fit import fit_homography, require_spread
from imgu_ros.vision.projective.homography import tangent_basis
from imgu_ros.vision.projective.inhomogeneous import homography_inhomogeneous
from imgu_ros.vision.projective.minimal import HomographyModel
from imgu_ros.vision.projective.refine import derivative_by_h, stepped
from imgu_ros.vision.projective.reprojection import corrected_points
from imgu_ros.vision.projective.robust import (
    RansacParameters,
    UsacParameters,
    ransac_estimator,
    usac_magsac_estimator,
    usac_then_ransac_estimator,
)
from imgu_ros.vision.projective.transform import transform

H = np.array([[1.2, 0.1, 5.0], [-0.2, 0.9, 3.0], [1e-4, 2e-4, 1.0]])


def _pairs(rng: np.random.Generator) -> dict[str, object]:
    src = np.array([[0, 0], [100, 4], [95, 90], [3, 99], [50, 40], [70, 20], [20, 60]]) + rng.normal(0, 2, (7, 2))
    return {"src": src, "dst": transform(H, src) + rng.normal(0, 0.3, (7, 2))}


def _with_h(rng: np.random.Generator) -> dict[str, object]:
    return {"H": H.copy(), **_pairs(rng)}


CALLS: dict[Callable[..., object], Callable[[np.random.Generator], dict[str, object]]] = {
    checked_pairs: _with_h,
    finite: lambda rng: {"values": rng.normal(size=4), "name": "values"},
    design_matrix: _pairs,
    homography_dlt: lambda rng: {**_pairs(rng), "weights": rng.uniform(0.5, 1, 7)},
    normalisation: lambda rng: {"points": rng.uniform(0, 100, (6, 3))},
    algebraic_error: _with_h,
    transfer_error: _with_h,
    symmetric_transfer_error: _with_h,
    reprojection_error: _with_h,
    sampson_error: _with_h,
    corrected_points: _with_h,
    estimate_homography: lambda rng: {**_pairs(rng), "rng": rng, "threshold_px": 3.0, "confidence": 0.9},
    fit_homography: lambda rng: {
        **_pairs(rng),
        "start": H.copy(),
        "noise_px": 0.5,
        "correlation": np.eye(7),
        "error": "reprojection",
    },
    require_spread: lambda rng: {"points": rng.uniform(0, 100, (6, 2)), "name": "points"},
    homography_inhomogeneous: lambda rng: {**_pairs(rng), "covariance": np.tile(np.eye(2), (7, 1, 1))},
    HomographyModel: _pairs,
    HomographyModel.normalised: lambda rng: {
        "self": HomographyModel(**_pairs(rng)),
        "H": H.copy(),
        "inliers": np.ones(7, bool),
    },
    ransac_estimator: lambda rng: {"parameters": RansacParameters()},
    usac_then_ransac_estimator: lambda rng: {"parameters": RansacParameters()},
    usac_magsac_estimator: lambda rng: {"parameters": UsacParameters()},
    derivative_by_h: lambda rng: {"H": H.copy(), "points": rng.uniform(0, 100, (5, 2))},
    stepped: lambda rng: {"H": H.copy(), "delta": rng.normal(size=8) * 0.1},
    tangent_basis: lambda _: {"H": H.copy()},
}
