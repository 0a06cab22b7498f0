# SPDX-License-Identifier: Apache-2.0
"""Demosaicking: quality on photographs and time for each Mpixel, ours beside OpenCV and colour-demosaicing, in one run.

    pip install imgu_ros[bench]
    python benchmarks/demosaicking.py --data ../shared/data --json demosaicking.json

Quality: the photographs are sampled as RGGB mosaics of 8 bits. CPSNR is 10 log10(255^2 / MSE), MSE the mean squared
error over pixels and the three channels of one photograph, 8 px border removed; the table gives the mean of the
photographs' CPSNR. Time: a 1920x1080 mosaic; methods take turns, each one's shortest time counts. The package
colour-demosaicing is left out when it is not installed.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic
from imgu_ros.vision.formation.demosaic import DemosaicMethod, demosaic

FOLDERS = ("kodak", "mcmaster")
PATTERN = BayerPattern.RGGB
Method = Callable[[Image], Image]


def methods() -> dict[str, Method]:
    """Return all methods, ours first; each takes an RGGB mosaic."""
    found: dict[str, Method] = {
        f"imgu {method}": partial(demosaic, pattern=PATTERN, method=method) for method in DemosaicMethod
    }
    for name, code in (
        ("OpenCV bilinear", cv2.COLOR_BayerBG2RGB),
        ("OpenCV edge-aware", cv2.COLOR_BayerBG2RGB_EA),
        ("OpenCV VNG", cv2.COLOR_BayerBG2RGB_VNG),
    ):
        found[name] = partial(cv2.cvtColor, code=code)
    try:
        import colour_demosaicing as other
    except ImportError:
        print("colour-demosaicing is not installed: left out")
        return found
    for name, function in (
        ("colour-demosaicing Malvar", other.demosaicing_CFA_Bayer_Malvar2004),
        ("colour-demosaicing Menon", other.demosaicing_CFA_Bayer_Menon2007),
    ):
        found[name] = partial(_by_colour_demosaicing, function)
    return found


def _by_colour_demosaicing(function: Callable[..., Image], raw: Image) -> Image:
    return np.clip(np.rint(function(raw.astype(np.float64), "RGGB")), 0, 255).astype(np.uint8)


def cpsnr(got: Image, truth: Image, border: int = 8) -> float:
    """Return the CPSNR in dB."""
    inner = (slice(border, -border), slice(border, -border))
    error = got[inner].astype(np.float64) - truth[inner]
    return float(10 * np.log10(255**2 / np.mean(error**2)))


def quality(data: Path) -> dict[str, dict[str, float]]:
    """Return each method's mean CPSNR on each folder."""
    table: dict[str, dict[str, float]] = {name: {} for name in methods()}
    for folder in FOLDERS:
        files = sorted(path for path in (data / folder).iterdir() if path.suffix in (".png", ".tif"))
        pictures = [np.ascontiguousarray(cv2.imread(str(file))[..., ::-1]) for file in files]
        for name, method in methods().items():
            table[name][folder] = float(np.mean([cpsnr(method(mosaic(rgb, PATTERN)), rgb) for rgb in pictures]))
        print(f"{folder}: {len(files)} photographs")
    return table


def speed(rounds: int) -> dict[str, float]:
    """Return each method's shortest time in ms for each Mpixel."""
    y, x = np.mgrid[:1080, :1920]
    light = 128 + 60 * np.sin(x * x / 9000 + y / 30) * np.cos(y * y / 7000)
    rgb = np.stack([0.9 * light, light, 0.8 * light + x / 40], axis=2)
    rgb += np.random.default_rng(0).normal(scale=3, size=rgb.shape)
    raw = mosaic(np.clip(rgb, 0, 255).astype(np.uint8), PATTERN)
    runs = methods()
    best = dict.fromkeys(runs, float("inf"))
    for k in range(rounds):
        for name, method in runs.items():
            if name.startswith("colour-demosaicing") and k >= max(2, rounds // 8):
                continue  # half a second each
            start = time.perf_counter()
            method(raw)
            best[name] = min(best[name], time.perf_counter() - start)
    return {name: 1000 * seconds / (raw.size / 1e6) for name, seconds in best.items()}


def main() -> None:
    """Print the table; write it as JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with kodak and mcmaster")
    parser.add_argument("--rounds", type=int, default=24, help="runs of each method (default: 24)")
    part = parser.add_mutually_exclusive_group()
    part.add_argument("--quality-only", action="store_true")
    part.add_argument("--speed-only", action="store_true")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, NumPy {np.__version__}, {cv2.getNumThreads()} threads, {platform.machine()}")
    figures: dict[str, dict[str, float]] = {name: {} for name in methods()}
    if not arguments.speed_only:
        for name, row in quality(arguments.data).items():
            figures[name] |= {f"{folder}_cpsnr_db": value for folder, value in row.items()}
    if not arguments.quality_only:
        times = speed(arguments.rounds)
        for name, value in times.items():
            figures[name] |= {"ms_per_mpixel": value, "times_vng": value / times["OpenCV VNG"]}
    _show(figures)
    if arguments.json:
        arguments.json.write_text(json.dumps({"opencv": cv2.__version__, "methods": figures}, indent=2) + "\n")


def _show(figures: dict[str, dict[str, float]]) -> None:
    heads = {"kodak_cpsnr_db": "Kodak dB", "mcmaster_cpsnr_db": "McMaster dB", "ms_per_mpixel": "ms/Mpixel"}
    heads["times_vng"] = "x VNG"
    columns = [key for key in heads if key in figures["OpenCV VNG"]]
    print(f"{'':26}" + "".join(f"{heads[key]:>13}" for key in columns))
    for name, row in figures.items():
        print(f"{name:26}" + "".join(f"{row[key]:13.2f}" for key in columns))
    menon, other = "imgu menon", "colour-demosaicing Menon"
    if "ms_per_mpixel" in figures[menon] and other in figures:
        ratio = figures[other]["ms_per_mpixel"] / figures[menon]["ms_per_mpixel"]
        print(f"Menon: {ratio:.1f} times as fast as colour-demosaicing's")


if __name__ == "__main__":
    main()
