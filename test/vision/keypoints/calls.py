# SPDX-License-Identifier: Apache-2.0
"""A valid call of every public function of the room, for the hostile test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from imgu_ros.vision.keypoints.detect import detect, level_shares
from imgu_ros.vision.keypoints.dog import detect_dog
from imgu_ros.vision.keypoints.dog_centres import refined_centres
from imgu_ros.vision.keypoints.dominant import dominant_orientations
from imgu_ros.vision.keypoints.fast import FastParameters, detect_fast, fast_detector
from imgu_ros.vision.keypoints.harris import detect_harris, harris_response
from imgu_ros.vision.keypoints.keypoints import Corners, Keypoints, on_level
from imgu_ros.vision.keypoints.moravec import detect_moravec, moravec_response
from imgu_ros.vision.keypoints.mser import detect_mser, find_regions
from imgu_ros.vision.keypoints.opencv import (
    corners_from_opencv,
    opencv_keypoints,
    positions,
    require_describable,
)
from imgu_ros.vision.keypoints.orb import detect_orb
from imgu_ros.vision.keypoints.orientation import centroid_orientation, scaled_orientation
from imgu_ros.vision.keypoints.peaks import find_peaks
from imgu_ros.vision.keypoints.repeatability import repeatability
from imgu_ros.vision.keypoints.spreading import spread
from imgu_ros.vision.scale_space.pyramid import build_pyramid

Generator = np.random.Generator


def picture(rng: Generator, side: int = 40) -> np.ndarray:
    return cv2.GaussianBlur(rng.integers(0, 256, (side, side + 8), np.uint8), (0, 0), 1.0)


def five_corners(rng: Generator) -> Corners:
    return Corners(rng.uniform(0, 30, (5, 2)), np.full(5, 2.0), rng.uniform(-3, 3, 5), rng.random(5))


def five_keypoints(rng: Generator) -> Keypoints:
    c = five_corners(rng)
    return Keypoints(c.xy, c.scale, c.angle, c.response, np.zeros(5, np.int32))


CALLS: dict[Callable[..., Any], Callable[[Generator], dict[str, Any]]] = {
    repeatability: lambda rng: {
        "src_xy": rng.uniform(0, 99, (9, 2)),
        "dst_xy": rng.uniform(0, 99, (8, 2)),
        "H_dst_src": [[1.1, 0.1, 3], [-0.1, 1, 2], [1e-4, 0, 1]],
        "src_size": (100, 100),
        "radius_px": 9.0,
    },
    detect: lambda rng: {"pyramid": build_pyramid(picture(rng)), "detector": "harris", "max_count": 20},
    level_shares: lambda rng: {"pyramid": build_pyramid(picture(rng)), "max_count": 20},
    fast_detector: lambda rng: {"parameters": FastParameters(arc=12)},
    detect_dog: lambda rng: {"image": picture(rng), "max_count": 20},
    refined_centres: lambda rng: {
        "image": picture(rng),
        "xy": rng.uniform(4, 20, (5, 2)),
        "scale": rng.uniform(1, 3, 5),
    },
    detect_fast: lambda rng: {"image": picture(rng), "max_count": 20, "arc": 11},
    detect_harris: lambda rng: {"image": picture(rng), "max_count": 20},
    detect_moravec: lambda rng: {"image": picture(rng), "max_count": 20},
    detect_mser: lambda rng: {"image": picture(rng), "max_count": 20},
    detect_orb: lambda rng: {"image": picture(rng), "max_count": 20},
    harris_response: lambda rng: {"image": picture(rng).astype(np.float32) / 255, "window_sigma": 1.5, "k": 0.04},
    moravec_response: lambda rng: {"image": picture(rng).astype(np.float32) / 255, "window": 5},
    find_regions: lambda rng: {"image": picture(rng), "max_share": 0.1, "max_variation": 0.5},
    find_peaks: lambda rng: {"response": picture(rng).astype(np.float32), "quality": 0.1, "border": 2},
    centroid_orientation: lambda rng: {"image": picture(rng), "xy": rng.uniform(0, 39, (5, 2)), "radius": 7},
    scaled_orientation: lambda rng: {
        "image": picture(rng).astype(np.float32),
        "xy": rng.uniform(0, 39, (5, 2)),
        "scale": rng.uniform(1, 9, 5),
    },
    dominant_orientations: lambda rng: {
        "image": picture(rng),
        "xy": rng.uniform(0, 39, (5, 2)),
        "scale": rng.uniform(1, 9, 5),
    },
    spread: lambda rng: {"xy": rng.uniform(0, 39, (9, 2)), "response": rng.random(9), "size": (40, 40), "count": 5},
    on_level: lambda rng: {"keypoints": five_keypoints(rng), "level": build_pyramid(picture(rng)).levels[0]},
    corners_from_opencv: lambda rng: {
        "found": [cv2.KeyPoint(3.0, 4.0, 7.0, 90.0, 0.5)],
        "sigma_per_size": 0.5,
        "with_angle": True,
    },
    opencv_keypoints: lambda rng: {
        "xy": rng.uniform(0, 30, (5, 2)),
        "size": np.full(5, 7.0),
        "angle": rng.uniform(-3, 3, 5),
        "response": rng.random(5),
    },
    positions: lambda rng: {"found": [cv2.KeyPoint(3.0, 4.0, 7.0)]},
    require_describable: lambda rng: {"corners": five_corners(rng)},
    Corners.chosen: lambda rng: {"self": five_corners(rng), "which": np.array([0, 2])},
    Keypoints.chosen: lambda rng: {"self": five_keypoints(rng), "which": np.array([0, 2])},
}
