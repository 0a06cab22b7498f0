# SPDX-License-Identifier: Apache-2.0
"""Time of Gaussian smoothing against sigma: recursive, sampled and discrete kernels on the same picture, in one run.

    python benchmarks/gaussian.py --json gaussian.json

Each figure is the least of several interleaved calls, ms. The recursive kernel is to cost about the same from sigma 1
to 50; the others' time grows with sigma. Also: how separable kernels gain by their split.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.types import Image
from imgu_ros.vision.processing.borders import padded
from imgu_ros.vision.processing.convolution import convolve
from imgu_ros.vision.processing.separability import split
from imgu_ros.vision.scale_space.gaussian import smooth
from imgu_ros.vision.scale_space.kernels import sampled_gaussian

SIGMAS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
KERNELS = ("sampled", "discrete", "recursive")
KERNEL_SIDES = (5, 7, 9, 11, 15, 21)


@dataclass(frozen=True)
class Smoothing:
    """Times of the three kernels for one sigma, ms."""

    sigma: float
    sampled_ms: float
    discrete_ms: float
    recursive_ms: float


@dataclass(frozen=True)
class Split:
    """A Gaussian kernel of n x n taken whole and taken apart: multiplications for each pixel, ms."""

    side: int
    whole_multiplications: int
    split_multiplications: int
    whole_ms: float
    split_ms: float


def least_ms(calls: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return the least time of each call; they take turns, so that other load hits all alike. The first warms up."""
    best = dict.fromkeys(calls, float("inf"))
    for _ in range(rounds + 1):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            best[name] = min(best[name], 1000 * (time.perf_counter() - start))
    return best


def smoothing(image: Image, rounds: int) -> list[Smoothing]:
    """Time the three kernels for every sigma."""
    calls = {f"{k} {sigma}": partial(smooth, image, sigma, k) for sigma in SIGMAS for k in KERNELS}
    times = least_ms(calls, rounds)
    return [Smoothing(sigma, *(times[f"{k} {sigma}"] for k in KERNELS)) for sigma in SIGMAS]


def splitting(image: Image, side: int, rounds: int) -> Split:
    """Time `convolve`, which splits, beside OpenCV's filter2D with the whole kernel, borders alike."""
    weights = np.outer(*2 * (sampled_gaussian(side / 6, side // 2),))

    def whole() -> Image:
        return cv2.filter2D(padded(image, side // 2, side // 2), cv2.CV_32F, weights)

    times = least_ms({"whole": whole, "split": lambda: convolve(image, weights)}, rounds)
    return Split(side, weights.size, split(weights).multiplications, times["whole"], times["split"])


def main() -> None:
    """Print the tables; write them as JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="1920x1080", help="of the picture, WIDTHxHEIGHT")
    parser.add_argument("--rounds", type=int, default=5, help="calls of each")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to FILE")
    arguments = parser.parse_args()
    width, height = (int(side) for side in arguments.size.split("x"))
    image = np.random.default_rng(0).random((height, width), np.float32)
    print(f"OpenCV {cv2.__version__}, {cv2.getNumThreads()} threads, {width}x{height} float32, ms")
    print(f"{'sigma px':>9} {'sampled':>9} {'discrete':>9} {'recursive':>10} {'sampled / recursive':>20}")
    rows = smoothing(image, arguments.rounds)
    for r in rows:
        ratio = r.sampled_ms / r.recursive_ms
        print(f"{r.sigma:9g} {r.sampled_ms:9.1f} {r.discrete_ms:9.1f} {r.recursive_ms:10.1f} {ratio:20.2f}")
    times = [r.recursive_ms for r in rows]
    print(f"recursive, slowest / fastest over sigma: {max(times) / min(times):.2f}\n")
    print(f"{'kernel':>9} {'weights':>9} {'split':>9} {'filter2D':>10} {'convolve':>9}")
    splits = [splitting(image, side, arguments.rounds) for side in KERNEL_SIDES]
    for s in splits:
        whole, parts = s.whole_multiplications, s.split_multiplications
        print(f"{s.side:6}^2 {whole:10} {parts:9} {s.whole_ms:10.1f} {s.split_ms:9.1f}")
    if arguments.json:
        figures = {"smoothing": [asdict(r) for r in rows], "splitting": [asdict(s) for s in splits]}
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
