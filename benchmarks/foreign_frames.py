# SPDX-License-Identifier: Apache-2.0
"""Frames of a path tracer that nobody here wrote, judged by exact truth: the pipeline beside SIFT and ORB.

    python benchmarks/foreign_frames.py --cache frames                # one seed, 8 frames of each row, some minutes
    python benchmarks/foreign_frames.py --cache frames --seeds 21 22 --rows photograph lens --frames 24
    python benchmarks/foreign_frames.py --cache frames --full --json figures.json --markdown page.md --plot plot.png

Mitsuba 3 renders a picture on a plane in a room (`foreign_rows.py`): a wall with photographs, boxes, shadows, light of
a lamp, the sky and other surfaces. Frames are 640x480, 10 bits, raw Bayer; the pattern changes with the seed. Channels
have gains that no white balance takes back; the full well is 9000 electrons, read noise 3 electrons.
Lens, rolling shutter, motion blur and depth of field are exact: every ray is made here (`foreign_renderer.py`). A
seed changes picture, path, room, lamp and sensor. Photographs are those of `$IMGU_DATA`; text and labels are drawn.

Truth is checked first: a print with dots is rendered with the camera and the motion of each row and seed, and the
dots' centroids are compared with where the truth has them. Beyond 0.02 px rms nothing is judged.

The pipeline is told black level, white level, K, the distortion and the time of a row, and nothing else; it tracks
except in the row `hand`. The recipes are those of `imgu bench` and get the same frames in 8 bits: black level
subtracted, scaled to the white level, sRGB.

- found, wrong: H goes out, and the corner error is at most 10 px, or more.
- corner px: root of the mean squared error of the four outer corners, in ideal pixels; p50 and p90 of the found ones.
- NEES: squared error of a published pose in units of its covariance, p50: 5.35 when the covariance is right. inside:
  share of published poses inside the 95 % ellipsoid. Wrong ones count.
- ms, cpu ms: of a frame, median: wall time, and processor time of all cores.

With a rolling shutter, stamp and truth are of the middle row. With it and with long exposures no single pose is exact.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from foreign_cache import DOTS_INDEX, ForeignFrame, FrameStore
from foreign_report import markdown_page, table, write_plot
from foreign_rows import FRAMES, ROWS, ForeignTake, take
from foreign_scenes import RATE_HZ, TARGET_WIDTH_M, film
from foreign_truth import MOST_PX, dot_errors
from print_judging import FOUND_PX, NEES_95, squared_error

from imgu_ros.bench.machine import this_machine
from imgu_ros.bench.methods import Answer
from imgu_ros.bench.recipes import DETECTION, ORB, SIFT, TRACKING, make_method
from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.reference.templates import TargetImage
from imgu_ros.types import Floats, Image
from imgu_ros.vision.camera.distortion_model import DistortionModel
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

#: The pipeline's name in tables; the recipes have their own.
OURS = "imgu"
METHODS = (OURS, SIFT, ORB)
FULL_SEEDS, QUICK_FRAMES = (1, 2, 3, 4), 8


@dataclass(frozen=True)
class ForeignOutcome:
    """What one method said of one frame.

    Attributes
    ----------
    corner_px : rms error of the corners; None: no H went out
    nees : of the pose; None: no pose, or none with a covariance
    """

    row: str
    seed: int
    method: str
    index: int
    status: str
    corner_px: float | None
    nees: float | None
    ms: float
    cpu_ms: float


@dataclass(frozen=True)
class TakeFacts:
    """What was shown: error of the dots, rms px, and means over the frames."""

    row: str
    seed: int
    frames: int
    pattern: str
    truth_rms_px: float
    saturated: float
    covered: float


@dataclass(frozen=True)
class MethodFigures:
    """One method's figures in one row; see above."""

    row: str
    title: str
    method: str
    frames: int
    found: int
    wrong: int
    corner_p50_px: float | None
    corner_p90_px: float | None
    poses: int
    nees_p50: float | None
    inside: float | None
    ms: float
    cpu_ms: float
    statuses: dict[str, int]


def corner_rms(H: Floats, true_H: Floats, size: tuple[int, int]) -> float:
    """Return the root of the mean squared distance of the four outer corners, px; infinite behind the camera."""
    w, h = size
    corners = np.array([[-0.5, -0.5, 1], [w - 0.5, -0.5, 1], [w - 0.5, h - 0.5, 1], [-0.5, h - 0.5, 1]])
    estimate, truth = corners @ H.T, corners @ true_H.T
    # Of either sign.
    if not np.isfinite(estimate).all() or abs(np.sign(estimate[:, 2]).sum()) < 4:
        return math.inf
    error = estimate[:, :2] / estimate[:, 2:] - truth[:, :2] / truth[:, 2:]
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def raw_levels(shown: ForeignTake) -> tuple[float, float]:
    """Return black level and white level of what is published."""
    sensor = shown.sensor
    if shown.row.film:
        black, white = film(np.array([sensor.black, sensor.white], np.uint16), sensor)
        return float(black), float(white)
    return float(sensor.black), float(sensor.white)


def shown_to_recipes(pixels: Image, black: float, white: float) -> Image:
    """Return a mosaic in 8 bits, sRGB."""
    v = np.clip((pixels.astype(np.float32) - np.float32(black)) / np.float32(white - black), 0, 1)
    srgb = np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** np.float32(1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * srgb), np.uint8)


def measured(
    shown: ForeignTake, frames: Sequence[ForeignFrame], parameters: Parameters, methods: Sequence[str]
) -> Iterator[ForeignOutcome]:
    """Yield what each method says of each frame."""
    black, white = raw_levels(shown)
    levels = {
        "raw.black_level": black,
        "raw.white_level": white,
        "raw.significant_bits": 0 if shown.row.film else shown.sensor.bits,
        "camera.row_time_us": shown.optics.row_time_s * 1e6,
    }
    target = TargetImage("target", shown.target, TARGET_WIDTH_M)
    optics = shown.optics
    distortion = np.array(optics.distortion)
    camera = Camera(optics.K, distortion, DistortionModel.PLUMB_BOB, optics.width, optics.height)
    layout = PixelLayout(ColorModel.BAYER, BayerPattern(shown.sensor.pattern))
    names = {OURS: TRACKING if shown.row.tracking else DETECTION}
    own = parameters_from(levels, parameters)
    makers = {name: make_method(names.get(name, name), [target], own) for name in methods}
    for index, frame in enumerate(frames):
        for name, method in makers.items():
            wall, cpu = time.perf_counter(), time.process_time()
            pixels = frame.pixels
            if name != OURS and not shown.row.film:
                pixels = shown_to_recipes(pixels, black, white)
            answer = method.answer(Frame(RawImage(pixels, layout), frame.stamp_ns, "camera", camera)).answers[0]
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            corner_px, nees = judged(answer, frame, shown.size)
            yield ForeignOutcome(
                shown.row.name, shown.seed, name, index, answer.status, corner_px, nees, wall * 1e3, cpu * 1e3
            )


def judged(answer: Answer, frame: ForeignFrame, size: tuple[int, int]) -> tuple[float | None, float | None]:
    """Return the corner error and the NEES of an answer."""
    corner_px = None if answer.H is None else corner_rms(np.asarray(answer.H), frame.H, size)
    if answer.pose is None or answer.covariance is None:
        return corner_px, None
    return corner_px, squared_error(answer.pose.R, answer.pose.t, answer.covariance, frame.R, frame.t)


def figures_of(row: str, title: str, method: str, outcomes: Sequence[ForeignOutcome]) -> MethodFigures:
    """Sum up one method's outcomes."""
    errors = [o.corner_px for o in outcomes if o.corner_px is not None]
    found = [e for e in errors if e <= FOUND_PX]
    nees = [o.nees for o in outcomes if o.nees is not None]
    return MethodFigures(
        row,
        title,
        method,
        len(outcomes),
        len(found),
        len(errors) - len(found),
        float(np.quantile(found, 0.5)) if found else None,
        float(np.quantile(found, 0.9)) if found else None,
        len(nees),
        float(np.median(nees)) if nees else None,
        float(np.mean(np.array(nees) < NEES_95)) if nees else None,
        float(np.median([o.ms for o in outcomes])),
        float(np.median([o.cpu_ms for o in outcomes])),
        dict(Counter(o.status for o in outcomes)),
    )


def checked_truth(store: FrameStore) -> float:
    """Return the rms error of the dots, px.

    Raises
    ------
    SystemExit
        If it is more than `MOST_PX`.
    """
    shown, light = store.dots()
    errors = dot_errors(shown, light, DOTS_INDEX / RATE_HZ)
    rms = float(np.sqrt((errors**2).sum(axis=1).mean()))
    if rms > MOST_PX:
        raise SystemExit(
            f"truth: {shown.row.name}, seed {shown.seed}: dots are {rms:.3f} px off; need {MOST_PX} or less"
        )
    return rms


def main() -> None:
    """Render, check the truth, measure, print and store."""
    names = [row.name for row in ROWS]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder in which frames are kept")
    parser.add_argument("--rows", nargs="+", choices=names, default=names, metavar="ROW", help=f"of {', '.join(names)}")
    parser.add_argument("--seeds", type=int, nargs="+", help="(default 1; --full: 1 to 4)")
    parser.add_argument("--frames", type=int, help="of each row and seed, 1 to 24 (default 8; --full: 24)")
    parser.add_argument("--full", action="store_true", help="four seeds, 24 frames of each row")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS, metavar="METHOD")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--records", type=Path, help="write what was said of every frame to this file")
    parser.add_argument("--markdown", type=Path, help="write a page with the table to this file")
    parser.add_argument("--plot", type=Path, help="draw the figures into this PNG file")
    add_parameter_options(parser)
    arguments = parser.parse_args()
    seeds = arguments.seeds or (FULL_SEEDS if arguments.full else (1,))
    count = arguments.frames or (FRAMES if arguments.full else QUICK_FRAMES)
    if not 1 <= count <= FRAMES:
        parser.error(f"--frames: {count}; need 1 to {FRAMES}")
    parameters = parameters_of(arguments)
    outcomes: list[ForeignOutcome] = []
    facts: list[TakeFacts] = []
    figures: list[MethodFigures] = []
    for row in (row for row in ROWS if row.name in arguments.rows):
        for seed in seeds:
            store = FrameStore(take(row, seed), arguments.cache)
            rms = checked_truth(store)
            frames = [store.frame(index) for index in range(count)]
            saturated, covered = (
                float(np.mean([getattr(f, name) for f in frames])) for name in ("saturated", "covered")
            )
            facts.append(TakeFacts(row.name, seed, count, store.take.sensor.pattern, rms, saturated, covered))
            outcomes += measured(store.take, frames, parameters, arguments.methods)
        for method in arguments.methods:
            of = [o for o in outcomes if (o.row, o.method) == (row.name, method)]
            figures.append(figures_of(row.name, row.title, method, of))
        print(table(figures[-len(arguments.methods) :], header=len(facts) == len(seeds)), flush=True)
    document = {
        "machine": asdict(this_machine()),
        "seeds": list(seeds),
        "frames": count,
        "figures": [asdict(each) for each in figures],
        "takes": [asdict(each) for each in facts],
    }
    for path, text in (
        (arguments.json, json.dumps(document, indent=1) + "\n"),
        (arguments.records, json.dumps([asdict(each) for each in outcomes]) + "\n"),
        (arguments.markdown, markdown_page(document, figures, __doc__ or "")),
    ):
        if path:
            path.write_text(text, encoding="utf-8")
    if arguments.plot:
        write_plot(arguments.plot, figures, outcomes)


if __name__ == "__main__":
    main()
