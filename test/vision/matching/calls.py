# SPDX-License-Identifier: Apache-2.0
"""A valid call of each public function of vision/matching, for test_hostile.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.types import Image
from imgu_ros.vision.matching.gallery import Gallery, Places, find_places, prepare_gallery
from imgu_ros.vision.matching.guided import guided_homography, match_guided
from imgu_ros.vision.matching.hamming import BinaryRows, binary_rows, hamming_distance
from imgu_ros.vision.matching.index import DescriptorIndex, build_index
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.matching.metrics import (
    checked_rows,
    comparable_rows,
    metric_for,
    metric_of_rows,
    metrics_of,
    require_index,
)
from imgu_ros.vision.matching.near import near_pairs
from imgu_ros.vision.matching.nearest import match, match_to_gallery
from imgu_ros.vision.matching.numbers import NumberRows, number_rows
from imgu_ros.vision.matching.patches import ncc, ssd, zmssd


def match_numbers(src: Image, dst: Image, dst_xy: ArrayLike, ratio: float) -> Matches:
    return match(src, dst, "ncc", ratio, True, dst_xy)


def match_euclidean(src: Image, dst: Image, same_place_px: float) -> Matches:
    return match(src, dst, "euclidean", same_place_px=same_place_px)


def prepared(rows: Image, xy: ArrayLike, same_place_px: float) -> Gallery:
    return prepare_gallery(rows, "auto", xy, same_place_px)


def guided_numbers(src: Image, dst: Image, src_xy: ArrayLike, dst_xy: ArrayLike, H_dst_src: ArrayLike) -> Matches:
    return match_guided(src, dst, src_xy, dst_xy, H_dst_src, 9.0, "zmssd", 1.0)


def bits(rng: np.random.Generator, n: int) -> Image:
    return rng.integers(0, 256, (n, 8), np.uint8)


def numbers(rng: np.random.Generator, n: int) -> Image:
    return rng.normal(size=(n, 9)).astype(np.float32)


def places(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform(0, 90, (n, 2))


def guided(rng: np.random.Generator, rows: Image) -> dict[str, object]:
    xy = places(rng, len(rows))
    return {"src": rows, "dst": rows.copy(), "src_xy": xy, "dst_xy": xy + 1 + rng.normal(0, 0.3, xy.shape)}


def homography(rng: np.random.Generator) -> np.ndarray:
    return np.eye(3) + np.array([[0.01, 0.01, 0.5], [0.01, 0.01, 0.5], [1e-5, 1e-5, 0]]) * rng.normal(size=(3, 3))


CALLS: dict[Callable[..., object], Callable[[np.random.Generator], dict[str, object]]] = {
    hamming_distance: lambda rng: {"a": bits(rng, 6), "b": bits(rng, 6)},
    match: lambda rng: {"src": bits(rng, 6), "dst": bits(rng, 7), "dst_xy": places(rng, 7)},
    match_numbers: lambda rng: {
        "src": numbers(rng, 6),
        "dst": numbers(rng, 7),
        "dst_xy": places(rng, 7),
        "ratio": 0.9,
    },
    match_euclidean: lambda rng: {"src": numbers(rng, 6), "dst": numbers(rng, 7), "same_place_px": 3.0},
    match_to_gallery: lambda rng: {"src": bits(rng, 6), "gallery": prepare_gallery(bits(rng, 5)), "ratio": 0.9},
    prepare_gallery: lambda rng: {"descriptors": numbers(rng, 5), "xy": places(rng, 5), "same_place_px": 3.0},
    prepared: lambda rng: {"rows": bits(rng, 5), "xy": places(rng, 5), "same_place_px": 3.0},
    match_guided: lambda rng: {
        **guided(rng, bits(rng, 7)),
        "H_dst_src": homography(rng),
        "radius_px": 9.0,
        "ratio": 0.9,
        "same_place_px": 2.0,
    },
    guided_numbers: lambda rng: {**guided(rng, numbers(rng, 7)), "H_dst_src": homography(rng)},
    guided_homography: lambda rng: {
        **guided(rng, bits(rng, 8)),
        "start": homography(rng),
        "threshold_px": 3.0,
        "ratio": 0.9,
        "max_rounds": 2,
    },
    checked_rows: lambda rng: {"rows": numbers(rng, 4), "name": "rows"},
    metric_of_rows: lambda rng: {"rows": bits(rng, 4)},
    metrics_of: lambda rng: {"kind": "orb"},
    metric_for: lambda rng: {"kind": "orb", "metric": "auto"},
    comparable_rows: lambda rng: {"src": bits(rng, 4), "columns": 8, "dtype": np.uint8},
    require_index: lambda rng: {"index": rng.integers(0, 9, 5), "length": 5, "count": 9},
    binary_rows: lambda rng: {"rows": bits(rng, 5)},
    BinaryRows.tables: lambda rng: {"self": binary_rows(bits(rng, 5)), "src": bits(rng, 4)},
    BinaryRows.distances: lambda rng: {
        "self": binary_rows(bits(rng, 5)),
        "src": bits(rng, 4),
        "index": rng.integers(0, 5, 4),
    },
    number_rows: lambda rng: {"rows": numbers(rng, 5), "metric": "ncc"},
    NumberRows.tables: lambda rng: {"self": number_rows(numbers(rng, 5), "euclidean"), "src": numbers(rng, 4)},
    NumberRows.distances: lambda rng: {
        "self": number_rows(numbers(rng, 5), "cosine"),
        "src": numbers(rng, 4),
        "index": rng.integers(0, 5, 4),
    },
    build_index: lambda rng: {"pictures": [bits(rng, 5), bits(rng, 4)], "seed": 1},
    DescriptorIndex.votes: lambda rng: {"self": build_index([bits(rng, 9), bits(rng, 9)]), "rows": bits(rng, 4)},
    near_pairs: lambda rng: {"a_xy": places(rng, 9), "b_xy": places(rng, 5), "radius_px": 20.0, "most": 99},
    find_places: lambda rng: {"xy": places(rng, 9), "radius_px": 20.0},
    Places.at: lambda rng: {"self": find_places(places(rng, 9), 20.0), "points": rng.integers(0, 9, 4)},
    ssd: lambda rng: {"a": rng.uniform(size=(3, 4)), "b": rng.uniform(size=(3, 4))},
    zmssd: lambda rng: {"a": rng.uniform(size=(3, 4)), "b": rng.uniform(size=(3, 4))},
    ncc: lambda rng: {"a": rng.uniform(size=(3, 4)), "b": rng.uniform(size=(3, 4))},
}
