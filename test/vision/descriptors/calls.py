# SPDX-License-Identifier: Apache-2.0
"""A valid call of each public function of vision/descriptors, for test_hostile.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imgu_ros.types import Floats, Image, Points
from imgu_ros.vision.descriptors.brief import brief_pairs, describe_brief
from imgu_ros.vision.descriptors.describe import Descriptions, describe, empty_descriptors
from imgu_ros.vision.descriptors.described import Described, checked_corners
from imgu_ros.vision.descriptors.extractor import DetectorDescriptor, ExtractorOptions, make_extractor
from imgu_ros.vision.descriptors.orb import describe_orb
from imgu_ros.vision.descriptors.patch import describe_patch, sample_patches
from imgu_ros.vision.descriptors.sift import describe_rootsift, describe_sift
from imgu_ros.vision.keypoints.keypoints import Corners, Keypoints
from imgu_ros.vision.methods import DESCRIPTORS, DETECTORS
from imgu_ros.vision.scale_space.pyramid import build_pyramid

_Call = Callable[[np.random.Generator], dict[str, object]]


def with_each_array(describer: Callable[[Image, Corners], Described]) -> Callable[..., Described]:
    """The describer, taking the corners' arrays one by one, for each to be made hostile."""

    def described(image: Image, xy: Points, scale: Floats, angle: Floats, response: Floats) -> Described:
        return describer(image, Corners(xy, scale, angle, response))

    described.__qualname__ = f"{describer.__name__}_of_arrays"
    return described


def on_a_pyramid(kind: str) -> Callable[..., Descriptions]:
    def described(image: Image, xy: Points, scale: Floats, angle: Floats, octave: Floats) -> Descriptions:
        return describe(build_pyramid(image, levels=2), Keypoints(xy, scale, angle, scale, octave), kind)

    described.__qualname__ = f"describe_{kind}_on_a_pyramid"
    return described


def picture(rng: np.random.Generator) -> Image:
    return rng.integers(0, 256, (70, 64), np.uint8)


def arrays(rng: np.random.Generator) -> dict[str, object]:
    return {
        "image": picture(rng),
        "xy": rng.uniform(28, 36, (3, 2)),
        "scale": rng.uniform(1, 1.6, 3),
        "angle": rng.uniform(-3, 3, 3),
    }


def corners(rng: np.random.Generator) -> Corners:
    return Corners(rng.uniform(28, 36, (3, 2)), rng.uniform(1, 1.6, 3), rng.uniform(-3, 3, 3), np.ones(3))


def _of_corners(rng: np.random.Generator) -> dict[str, object]:
    return {"image": picture(rng), "corners": corners(rng)}


def _of_arrays(rng: np.random.Generator) -> dict[str, object]:
    return {**arrays(rng), "response": rng.uniform(size=3)}


def _on_a_pyramid(rng: np.random.Generator) -> dict[str, object]:
    return {**arrays(rng), "octave": np.array([0, 1, 0], np.int32)}


_DESCRIBERS = (describe_brief, describe_orb, describe_patch, describe_rootsift, describe_sift)

_HARRIS_PATCH = DetectorDescriptor(ExtractorOptions(DETECTORS["harris"], DESCRIPTORS["patch"]))

CALLS: dict[Callable[..., object], _Call] = {
    **dict.fromkeys(_DESCRIBERS, _of_corners),
    **dict.fromkeys([with_each_array(describer) for describer in _DESCRIBERS], _of_arrays),
    **dict.fromkeys([on_a_pyramid(kind) for kind in DESCRIPTORS], _on_a_pyramid),
    describe: lambda rng: {
        "pyramid": build_pyramid(picture(rng), levels=2),
        "keypoints": Keypoints(*[a for k, a in arrays(rng).items() if k != "image"], np.ones(3), np.zeros(3, np.int32)),
    },
    checked_corners: lambda rng: {"corners": corners(rng)},
    make_extractor: lambda rng: {"options": ExtractorOptions(DETECTORS["harris"], DESCRIPTORS["patch"])},
    DetectorDescriptor.detect: lambda rng: {
        "self": _HARRIS_PATCH,
        "pyramid": build_pyramid(picture(rng)),
        "max_count": 9,
    },
    DetectorDescriptor.extract: lambda rng: {
        "self": _HARRIS_PATCH,
        "pyramid": build_pyramid(picture(rng)),
        "max_count": 9,
    },
    DetectorDescriptor.describe: lambda rng: {
        "self": _HARRIS_PATCH,
        "pyramid": build_pyramid(picture(rng)),
        "keypoints": Keypoints(np.full((1, 2), 20.0), np.ones(1), np.ones(1), np.ones(1), np.zeros(1, np.int32)),
    },
    empty_descriptors: lambda rng: {"kind": "orb"},
    brief_pairs: lambda rng: {"seed": 3, "count": 5},
    sample_patches: lambda rng: {
        "image": picture(rng),
        "xy": rng.uniform(0, 60, (3, 2)),
        "step_px": rng.uniform(0.5, 2, 3),
        "angle": rng.uniform(-3, 3, 3),
        "side": 4,
    },
}
