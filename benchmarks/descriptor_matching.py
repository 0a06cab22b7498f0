# SPDX-License-Identifier: Apache-2.0
"""Matching a frame's descriptors to a target's: time, ours beside cv2.BFMatcher, with the same tests in one run.

    python benchmarks/descriptor_matching.py [--json FILE]

Both get the nearest, the second nearest for the ratio test, and the mutual check; ours also leaves out rivals at the
same place when it knows where the target's keypoints lie.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.vision.matching.gallery import prepare_gallery
from imgu_ros.vision.matching.nearest import match_to_gallery

FRAME, TARGET, RATIO = 1000, 3000, 0.85


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="also write the figures here")
    parser.add_argument("--runs", type=int, default=25)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    figures = {}
    print(f"{FRAME} descriptors to {TARGET}, median of {arguments.runs} interleaved runs, ms")
    for name, norm, (src, dst) in (
        ("256 bits", cv2.NORM_HAMMING, _bits(rng)),
        ("SIFT's 128 whole numbers", cv2.NORM_L2, _numbers(rng)),
    ):
        xy = rng.uniform(0, 1000, (TARGET, 2))
        ways = {
            "ours": _ours(src, dst, None),
            "ours, places known": _ours(src, dst, xy),
            "cv2.BFMatcher": lambda src=src, dst=dst, norm=norm: _opencv(src, dst, norm),
        }
        counts = {way: call() for way, call in ways.items()}
        times: dict[str, list[float]] = {way: [] for way in ways}
        for _ in range(arguments.runs):
            for way, call in ways.items():
                start = time.perf_counter()
                call()
                times[way].append(1e3 * (time.perf_counter() - start))
        for way, measured in times.items():
            figures[f"{name}, {way}"] = {"ms": float(np.median(measured)), "matches": counts[way]}
            print(f"{name:26} {way:20} {np.median(measured):8.1f} {counts[way]:6} matches")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")


def _bits(rng: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    dst = rng.integers(0, 256, (TARGET, 32), np.uint8)
    src = rng.integers(0, 256, (FRAME, 32), np.uint8)
    seen = rng.permutation(TARGET)[: FRAME // 2]
    src[: FRAME // 2] = dst[seen] ^ np.packbits(rng.random((FRAME // 2, 256)) < 0.15, axis=1)
    return src, dst


def _numbers(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    dst = np.abs(rng.normal(0, 45, (TARGET, 128)))
    src = np.abs(rng.normal(0, 45, (FRAME, 128)))
    src[: FRAME // 2] = np.abs(dst[rng.permutation(TARGET)[: FRAME // 2]] + rng.normal(0, 12, (FRAME // 2, 128)))
    return np.rint(src).astype(np.float32), np.rint(dst).astype(np.float32)


def _ours(src: NDArray[np.generic], dst: NDArray[np.generic], xy: NDArray[np.float64] | None) -> Callable[[], int]:
    gallery = prepare_gallery(dst, xy=xy)
    return lambda: len(match_to_gallery(src, gallery, RATIO))


def _opencv(src: NDArray[np.generic], dst: NDArray[np.generic], norm: int) -> int:
    matcher = cv2.BFMatcher(norm)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(dst, src)}
    pairs = matcher.knnMatch(src, dst, k=2)
    return sum(m.distance < RATIO * n.distance and back[m.trainIdx] == m.queryIdx for m, n in pairs)


if __name__ == "__main__":
    main()
