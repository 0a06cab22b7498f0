"""A valid call of every public function of vision/projective, for test_hostile.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.vision.projective.transform import faces_camera, local_jacobian, normalised_homography, transform

H = np.array([[1.2, 0.1, 5.0], [-0.2, 0.9, 3.0], [1e-4, 2e-4, 1.0]])


def _points(rng: np.random.Generator, count: int = 8) -> np.ndarray:
    return rng.uniform(0, 100, (count, 2))


CALLS: dict[Callable[..., object], Callable[[np.random.Generator], dict[str, object]]] = {
    transform: lambda rng: {"H": H.copy(), "points": _points(rng)},
    local_jacobian: lambda rng: {"H": H.copy(), "points": _points(rng)},
    normalised_homography: lambda rng: {"H": H.copy()},
    faces_camera: lambda rng: {"H": H.copy(), "points": _points(rng)},
}
