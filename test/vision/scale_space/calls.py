# SPDX-License-Identifier: Apache-2.0
"""A valid call of each public function of the room, for `test_hostile.py`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.vision.scale_space import gaussian, kernels, laplacian, pyramid, recursive


def _grey(rng: np.random.Generator) -> np.ndarray:
    return rng.integers(0, 256, (20, 24)).astype(np.uint8)


def _real(rng: np.random.Generator) -> np.ndarray:
    return rng.random((8, 9), np.float32)


def bands_of(image: np.ndarray) -> pyramid.Pyramid:
    """Return the levels' bands."""
    return pyramid.band_passed(pyramid.Pyramid((pyramid.Level(image, np.ones(2)),)))


def reconstructed_from(band: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Put a picture together."""
    return laplacian.reconstructed(laplacian.LaplacianPyramid((band,), base))


def there_and_back(xy: np.ndarray) -> np.ndarray:
    """Map points to full resolution and back."""
    level = pyramid.Level(np.zeros((4, 4), np.uint8), np.array([2.0, 3.0]))
    return level.from_full(level.to_full(xy))


CALLS: dict[Callable, Callable[[np.random.Generator], dict[str, object]]] = {
    gaussian.smooth: lambda rng: {
        "image": _real(rng), "sigma": 1.5, "kernel": "sampled", "border": "constant", "value": 0.5,
    },
    kernels.sampled_gaussian: lambda rng: {"sigma": 1.5},
    kernels.discrete_gaussian: lambda rng: {"sigma": 1.5},
    kernels.discrete_reach: lambda rng: {"sigma": 1.5, "missing": 1e-3},
    recursive.smooth_recursively: lambda rng: {"image": _real(rng), "sigma": 1.5, "value": 0.5, "border": "constant"},
    pyramid.build_pyramid: lambda rng: {"image": _grey(rng), "kind": "laplacian", "levels": 2, "min_side_px": 4},
    pyramid.reduced: lambda rng: {"image": _real(rng), "factor": 1.5, "kernel": "discrete"},
    pyramid.enlarged: lambda rng: {"image": _real(rng), "size": (20, 30)},
    pyramid.band_passed: lambda rng: {"pyramid": pyramid.build_pyramid(_grey(rng), "coarse", 2, min_side_px=4)},
    bands_of: lambda rng: {"image": _real(rng)},
    pyramid.PixelScaling: lambda rng: {"step": np.array([2.0, 3.0])},
    pyramid.AlignedPixels.to_full: lambda rng: {"self": pyramid.PixelScaling(2.0), "xy": rng.uniform(0, 9, (5, 2))},
    pyramid.AlignedPixels.from_full: lambda rng: {"self": pyramid.PixelScaling(2.0), "xy": rng.uniform(0, 9, (5, 2))},
    there_and_back: lambda rng: {"xy": rng.uniform(0, 9, (5, 2))},
    laplacian.laplacian_pyramid: lambda rng: {"image": _real(rng), "levels": 2},
    laplacian.reconstructed: lambda rng: {"pyramid": laplacian.laplacian_pyramid(_grey(rng), 2)},
    reconstructed_from: lambda rng: {
        "band": rng.normal(size=(8, 10)).astype(np.float32), "base": rng.random((4, 5), np.float32),
    },
}  # fmt: skip
