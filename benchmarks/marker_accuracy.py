# SPDX-License-Identifier: Apache-2.0
"""Errors in x, y and z of the pose of a marker of 50 mm, beside two other programs on the same frames.

    pip install apriltag-python mitsuba
    python benchmarks/marker_accuracy.py --views 128 --json benchmarks/figures/marker_accuracy.json

The conditions are those of arXiv 2601.07723: one marker of 50 mm, 640x480, 0.5 to 1.5 m away, poses of a
low-discrepancy sequence (Sobol), rendered by a program that is not this project's (Mitsuba 3, `foreign_renderer.py`).
Distance, place in the image, tilt up to 60 degrees, its direction and the roll are spread evenly; focal length 680 px;
a lamp, a sky, a wall and boxes behind it. Raw 10 bits of a Bayer sensor that go with the light, or 8 bits after white
balance and the curve of sRGB. The others get the demosaicked grey, as in `markers.py`.

For x to the right, y down and z away from the camera: sigma, the standard deviation of the errors, and bias, their mean
with its own standard deviation. A few poses of the wrong side of a plane would decide a standard deviation alone; so
the spread by the quartiles is there, too (0.7413 times their difference, sigma of a normal distribution). A pose of
ours that is reported as ambiguous counts with its better solution.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from foreign_renderer import ForeignRenderer
from foreign_scenes import BayerSensor, RayOptics, RoomLamp, RoomScene, RoomShape, exposed, linear, mosaic, placed
from marker_views import CAMERA, FOCAL_PX, MarkerView, _corners, _homography, _placed, encoded, grey_of, marker_print
from markers import _INSIDE, FAMILY, Finder, _angle, others
from numpy.typing import NDArray
from print_views import BITS, BLACK_LEVEL, GAINS, HEIGHT, RAW_PARAMETERS, WIDTH, mapped
from scipy.stats import qmc

from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.marker import marker_image
from imgu_ros.reference_kinds import make_references
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

Floats = NDArray[np.floating]

WIDTH_M, DISTANCES_M, MOST_TILT_DEG, COUNT = 0.05, (0.5, 1.5), 60.0, 587
SENSOR = BayerSensor("rggb", BITS, BLACK_LEVEL, GAINS)
OPTICS = RayOptics(FOCAL_PX, FOCAL_PX, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
_LAYOUT = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
#: Samples of a pixel, side x side: about the marker their noise is a tenth of the sensor's; elsewhere it is no matter.
_FINE, _COARSE = 20, 4
#: White paper, share of the full well.
_BRIGHT = 0.8
#: Of a normal distribution the difference of the quartiles times this is sigma.
_OF_QUARTILES = 0.7413


@dataclass
class PoseErrors:
    """What one program made of the frames: errors (N, 3) m, squared errors by the covariance, and counts."""

    found: int = 0
    ambiguous: int = 0
    flips: int = 0
    errors: list[Floats] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)

    def row(self) -> dict[str, object]:
        """Return the figures by name, mm."""
        if not self.errors:
            return {"found": 0}
        errors = 1e3 * np.array(self.errors).reshape(-1, 3)
        low, high = np.percentile(errors, (25, 75), axis=0)

        def shown(values: Floats) -> list[float]:
            return [round(float(value), 4) for value in values]

        return {
            "found": self.found,
            "ambiguous": self.ambiguous,
            "flips": self.flips,
            "sigma_mm": shown(errors.std(axis=0)),
            "quartile_sigma_mm": shown(_OF_QUARTILES * (high - low)),
            "bias_mm": shown(errors.mean(axis=0)),
            "bias_sigma_mm": shown(errors.std(axis=0) / math.sqrt(len(errors))),
            "median_mm": round(float(np.median(np.linalg.norm(errors, axis=1))), 4),
            "nees_p50": round(float(np.median(self.nees)), 2) if self.nees else None,
            "inside": round(float(np.mean(np.array(self.nees) < _INSIDE)), 3) if self.nees else None,
        }


def poses(seed: int, count: int) -> Iterator[tuple[Floats, Floats, float]]:
    """Yield camera_from_marker, R and t, of markers that are wholly in view, and their tilt, degrees."""
    sequence, made = qmc.Sobol(6, seed=seed), 0
    shown = marker_print(FAMILY, 0, WIDTH_M)
    while made < count:
        for a, u, v, tilt, axis, roll in sequence.random(64):
            distance = DISTANCES_M[0] + a * (DISTANCES_M[1] - DISTANCES_M[0])
            turns = math.radians(MOST_TILT_DEG * tilt), 2 * math.pi * axis, 2 * math.pi * roll
            R, t = _placed(distance, *turns, np.array((u * WIDTH, v * HEIGHT)))
            seen = mapped(_homography(shown, R, t), _corners(len(shown.pixels), 0))
            if made < count and ((seen > 2) & (seen < (WIDTH - 3, HEIGHT - 3))).all():
                made += 1
                yield R, t, MOST_TILT_DEG * tilt


def scene_of(picture: NDArray[np.uint8], width_m: float, rng: np.random.Generator) -> RoomScene:
    """Return a sheet before a wall and boxes, x right, y down, z into the print."""
    shapes = [RoomShape("rectangle", placed((0, 0, 0), (width_m, width_m, 2)), picture=linear(picture))]
    wall = tuple(rng.uniform(0.25, 0.6, 3))
    shapes.append(RoomShape("rectangle", placed((0, 0, 0.25), (8, 8, 2)), wall))
    for _ in range(12):
        angle, radius = rng.uniform(0, 2 * math.pi), rng.uniform(0.12, 0.5)
        centre = (radius * math.cos(angle), radius * math.sin(angle), rng.uniform(0.1, 0.25))
        turn, _ = cv2.Rodrigues(rng.uniform(-1.5, 1.5, 3))
        shapes.append(
            RoomShape("cube", placed(centre, rng.uniform(0.02, 0.12, 3), turn), tuple(rng.uniform(0.1, 0.8, 3)))
        )
    lamp = (rng.choice((-1, 1)) * rng.uniform(0.6, 1.2), -rng.uniform(0.5, 1.2), -rng.uniform(1.8, 2.4))
    radiance = 15.0 * math.hypot(*lamp) ** 2
    sky = tuple(float(value) for value in rng.uniform(0.04, 0.09) * np.array((1.0, 1.05, 1.15)))
    return RoomScene(shapes, RoomLamp(lamp, 0.15, (radiance,) * 3), sky)


def views(seed: int, count: int) -> Iterator[MarkerView]:
    """Yield frames of 10 bits that go with the light, and their truth."""
    for index, (R, t, tilt) in enumerate(poses(seed, count)):
        rng = np.random.default_rng([seed, index])
        number = int(rng.integers(COUNT))
        shown = marker_print(FAMILY, number, WIDTH_M)
        renderer = ForeignRenderer(scene_of(shown.pixels, shown.width_m, rng))
        R_world = R @ np.diag((1.0, -1.0, -1.0))
        H, side = _homography(shown, R, t), len(shown.pixels)
        seen = mapped(H, _corners(side, 0))
        left, top = np.maximum(np.floor(seen.min(axis=0)).astype(int) - 4, 0)
        right, bottom = np.minimum(np.ceil(seen.max(axis=0)).astype(int) + 5, (WIDTH, HEIGHT))
        part = replace(
            OPTICS, cx=OPTICS.cx - left, cy=OPTICS.cy - top, width=int(right - left), height=int(bottom - top)
        )

        def path(_: float, R: Floats = R_world, t: Floats = t) -> tuple[Floats, Floats]:
            return R, t

        light = renderer.light(OPTICS, path, 0.0, _COARSE, 2 * index)
        light[top:bottom, left:right] = renderer.light(part, path, 0.0, _FINE, 2 * index + 1)
        white = float(np.quantile(light[top:bottom, left:right], 0.98))
        raw = exposed(mosaic(light, SENSOR) * (_BRIGHT / white), SENSOR, rng)
        frame = Frame(RawImage(raw, _LAYOUT), 1_000_000_000 * (index + 1), "camera", CAMERA)
        margin = (side - side * WIDTH_M / shown.width_m) / 2
        yield MarkerView(frame, number, R, t, WIDTH_M, mapped(H, _corners(side, margin)), tilt)


def add_own(figures: PoseErrors, view: MarkerView, linear_light: bool) -> None:
    """Add what this package makes of a view."""
    assert view.R is not None and view.t is not None and view.number is not None
    parameters = parameters_from(RAW_PARAMETERS if linear_light else {})
    images = [marker_image("marker", FAMILY, view.number, WIDTH_M)]
    found = Localizer(parameters, make_references(images, parameters)).process(view.frame).first
    if not found.solutions:
        return
    figures.found += 1
    pose = found.solutions[0]
    turn = view.R @ pose.R.T
    figures.errors.append(pose.t - view.t)
    if found.pose is None:
        figures.ambiguous += 1
        return
    figures.flips += _angle(turn) > 0.3
    error = np.concatenate((view.t - pose.t, cv2.Rodrigues(turn)[0].ravel()))
    figures.nees.append(float(error @ np.linalg.solve(pose.covariance, error)))


def add_other(figures: PoseErrors, find: Finder, view: MarkerView) -> None:
    """Add what another program makes of a view."""
    assert view.R is not None and view.t is not None
    half = view.width_m / 2
    square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    for number, corners in find(grey_of(view.frame)):
        if number != view.number:
            continue
        figures.found += 1
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            square, np.ascontiguousarray(corners).reshape(4, 1, 2), CAMERA.K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        figures.errors.append(shifts[0].ravel() - view.t)
        figures.flips += _angle(view.R @ cv2.Rodrigues(turns[0])[0].T) > 0.3


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=7723, help="of the sequence, the scenes and the noise")
    parser.add_argument("--views", type=int, default=128)
    parser.add_argument("--show", type=Path, help="write the first frame, PNG")
    parser.add_argument("--json", type=Path, help="write the figures")
    arguments = parser.parse_args()
    finders = others()
    figures = {light: {name: PoseErrors() for name in ("imgu_ros", *finders)} for light in ("linear", "sRGB")}
    for index, view in enumerate(views(arguments.seed, arguments.views)):
        if arguments.show and index == 0:
            cv2.imwrite(str(arguments.show), grey_of(replace(view, frame=encoded(view.frame)).frame))
        for light, by_name in figures.items():
            shown = view if light == "linear" else replace(view, frame=replace(encoded(view.frame), camera=CAMERA))
            add_own(by_name["imgu_ros"], shown, light == "linear")
            for name, find in finders.items():
                add_other(by_name[name], find, shown)
    rows = []
    for light, by_name in figures.items():
        rows += [{"light": light, "by": name, **each.row()} for name, each in by_name.items()]
    for row in rows:
        print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)
    if arguments.json:
        document = {"seed": arguments.seed, "views": arguments.views, "rows": rows}
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
