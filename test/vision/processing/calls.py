# SPDX-License-Identifier: Apache-2.0
"""A valid call of each public function of the room, for `test_hostile.py`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.vision.processing import (
    borders,
    convolution,
    derivatives,
    edges,
    histograms,
    interpolation,
    points,
    quadrilaterals,
    remapping,
    separability,
    thresholding,
    warping,
)


def _grey(rng: np.random.Generator) -> np.ndarray:
    return rng.integers(0, 256, (8, 9)).astype(np.uint8)


def _real(rng: np.random.Generator) -> np.ndarray:
    return rng.random((8, 9), np.float32)


def gradient_magnitude(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return magnitude and direction."""
    slope = derivatives.gradient(image)
    return slope.magnitude, slope.direction


def warped_color(image: np.ndarray, H: np.ndarray) -> np.ndarray:
    """Warp three channels."""
    return warping.warped(image, H, (7, 6), "cubic", "periodic")


def equalised_16(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Equalise 16 bits both ways."""
    return histograms.equalised(image), histograms.equalised_locally(image, 3.0, 2)


CALLS: dict[Callable, Callable[[np.random.Generator], dict[str, object]]] = {
    borders.padded: lambda rng: {
        "image": _real(rng), "margin_x": 3, "margin_y": 2, "border": "constant", "value": 0.5,
    },
    borders.border_values: lambda rng: {"dtype": np.dtype(np.uint8), "border": borders.Border.CONSTANT, "value": 3.0},
    borders.source_index: lambda rng: {"index": rng.integers(-9, 9, (3, 4)), "size": 5, "border": "reflected"},
    points.adjust: lambda rng: {"image": _real(rng), "contrast": 1.5, "brightness": 0.1},
    points.gamma_corrected: lambda rng: {"image": _grey(rng), "exponent": 0.7},
    points.grey_from_rgb: lambda rng: {"image": rng.random((5, 6, 3), np.float32), "weights": np.full(3, 0.3)},
    points.full_scale: lambda rng: {"dtype": np.dtype(np.uint16)},
    points.require_range: lambda rng: {"image": _real(rng), "gain": 2.0},
    histograms.histogram: lambda rng: {"image": _real(rng), "bins": 10},
    histograms.equalised: lambda rng: {"image": _grey(rng)},
    histograms.equalised_locally: lambda rng: {"image": _grey(rng), "clip": 2.0, "tiles": 2},
    equalised_16: lambda rng: {"image": rng.integers(0, 65536, (8, 9)).astype(np.uint16)},
    thresholding.thresholded: lambda rng: {"image": _real(rng), "value": 0.5},
    thresholding.otsu_threshold: lambda rng: {"image": _grey(rng), "bins": 100},
    separability.split: lambda rng: {"kernel": rng.normal(size=(3, 5)), "tolerance": 1e-7},
    separability.is_separable: lambda rng: {"kernel": rng.normal(size=(3, 5)), "tolerance": 1e-7},
    separability.as_kernel: lambda rng: {"kernel": rng.normal(size=(3, 5))},
    convolution.convolve: lambda rng: {"image": _real(rng), "kernel": rng.normal(size=(3, 5))},
    convolution.convolve_separable: lambda rng: {
        "image": _grey(rng), "column": rng.normal(size=3), "row": rng.normal(size=5), "border": "constant", "value": 9,
    },
    convolution.mean_filtered: lambda rng: {"image": _real(rng), "size": 3, "border": "periodic"},
    derivatives.gradient: lambda rng: {"image": _real(rng), "operator": "gaussian", "sigma": 1.0},
    gradient_magnitude: lambda rng: {"image": _real(rng)},
    edges.edge_strength: lambda rng: {"image": _real(rng), "operator": "scharr", "sigma": 1.0},
    edges.edge_map: lambda rng: {"image": _real(rng), "threshold": 0.1},
    edges.canny: lambda rng: {"image": _real(rng), "low": 0.05, "high": 0.1, "sigma": 1.0},
    quadrilaterals.find_quadrilaterals: lambda rng: {
        "channels": tuple(rng.integers(0, 256, (40, 50)).astype(np.uint8) for _ in range(2)), "most": 7,
    },
    interpolation.resized: lambda rng: {"image": _real(rng), "size": (5, 12), "interpolation": "cubic"},
    interpolation.checked_size: lambda rng: {"size": (3, 4)},
    interpolation.sampled: lambda rng: {
        "image": _real(rng), "xy": rng.uniform(-2, 9, (5, 2)), "interpolation": "cubic", "value": 0.0,
    },
    remapping.remapped: lambda rng: {
        "image": _real(rng), "xy": rng.uniform(-2, 9, (5, 6, 2)), "interpolation": "cubic", "value": 0.5,
    },
    warping.warped: lambda rng: {
        "image": _real(rng), "H": np.eye(3) + 0.01 * rng.normal(size=(3, 3)), "size": (7, 6), "value": 0.5,
    },
    warped_color: lambda rng: {"image": rng.random((5, 6, 3), np.float32), "H": np.eye(3)},
    warping.rotated: lambda rng: {"image": _grey(rng), "angle": 0.3, "centre": rng.uniform(0, 9, 2), "whole": True},
    warping.rotation_about: lambda rng: {"angle": 0.3, "centre": rng.uniform(0, 9, 2), "scale": 1.1},
    warping.whole_picture: lambda rng: {"H": np.eye(3) + 0.01 * rng.normal(size=(3, 3)), "size": (7, 6)},
}  # fmt: skip
