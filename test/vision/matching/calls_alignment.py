# SPDX-License-Identifier: Apache-2.0
"""A valid call of the public functions of vision/matching that align patches, for test_hostile.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.types import Image, Indices, Points
from imgu_ros.vision.matching.patch_atlas import PatchAtlas
from imgu_ros.vision.matching.patch_bank import Displacements, LocalDistortion, PatchBank, Patches, as_grey

CENTRES = np.array([[10.0, 10.0], [20.0, 12.0], [15.0, 22.0], [25.0, 24.0]])
ORIGINS = np.array([[2.0, 2.0], [12.0, 4.0], [6.0, 14.0], [16.0, 16.0]])


def picture(rng: np.random.Generator, dtype: type = np.uint8) -> Image:
    return rng.integers(0, 256, (36, 40)).astype(dtype)


def patches(rng: np.random.Generator) -> Patches:
    return PatchBank(picture(rng), CENTRES, 7).select(np.arange(4))


def homography() -> np.ndarray:
    return np.array([[0.9, 0.1, 1.0], [-0.1, 0.95, 2.0], [1e-3, -5e-4, 1.0]])


def selected(image: Image, centres: Points, chosen: Indices, picture: Image, H: np.ndarray) -> Displacements:
    """All that a patch goes through."""
    some = PatchBank(image, centres, 7).select(chosen)
    return some.displacements(some.sampled(picture, H))


def through_a_lens(
    some: Patches, straight: Points, distorted: Points, by_straight: np.ndarray, picture: Image
) -> Image:
    return some.sampled(picture, np.eye(3), LocalDistortion(straight, distorted, by_straight))


def cut_and_sampled(origins: Points, image: Image, H: np.ndarray) -> Image:
    atlas = PatchAtlas(origins, 16)
    return patches(np.random.default_rng(1)).sampled(atlas.cut(image), H, atlas=atlas)


def from_an_atlas(some: Patches, squares: Image, H: np.ndarray) -> Image:
    return some.sampled(squares, H, atlas=PatchAtlas(ORIGINS, 16), first=3)


CALLS: dict[Callable[..., object], Callable[[np.random.Generator], dict[str, object]]] = {
    as_grey: lambda rng: {"image": picture(rng, np.float32), "name": "image"},
    PatchBank: lambda rng: {"image": picture(rng, np.uint16), "centres": CENTRES.copy(), "window_px": 7},
    PatchBank.select: lambda rng: {"self": PatchBank(picture(rng), CENTRES, 7), "chosen": np.array([2, 0])},
    Patches.sampled: lambda rng: {"self": patches(rng), "image": picture(rng), "H": homography()},
    Patches.displacements: lambda rng: {"self": patches(rng), "samples": rng.integers(0, 256, (4, 49), np.uint8)},
    selected: lambda rng: {
        "image": picture(rng, np.float32),
        "centres": CENTRES.copy(),
        "chosen": np.array([3, 1, 0]),
        "picture": picture(rng, np.float32),
        "H": np.eye(3),
    },
    through_a_lens: lambda rng: {
        "some": patches(rng),
        "straight": CENTRES.copy(),
        "distorted": CENTRES + rng.normal(size=(4, 2)),
        "by_straight": np.eye(2) + 0.1 * rng.normal(size=(4, 2, 2)),
        "picture": picture(rng, np.uint16),
    },
    cut_and_sampled: lambda rng: {"origins": ORIGINS.copy(), "image": picture(rng, np.float32), "H": homography()},
    from_an_atlas: lambda rng: {
        "some": patches(rng),
        "squares": PatchAtlas(ORIGINS, 16).cut(picture(rng)),
        "H": homography(),
    },
    PatchAtlas: lambda rng: {"origins": ORIGINS.copy(), "side": 16},
    PatchAtlas.cut: lambda rng: {"self": PatchAtlas(ORIGINS, 16), "image": picture(rng)},
}
