# SPDX-License-Identifier: Apache-2.0
"""Wrong calibrations: are they found, and do poses stay inside their ellipsoids? Simulated frames of several prints.

    python benchmarks/calibration_misfit.py --json benchmarks/figures/calibration_misfit.json
    python benchmarks/calibration_misfit.py --part noise --frames 1000

- `focal`: sequences at tilts of 20 to 55 degrees, each replayed with focal lengths that are wrong by up to 5 %: frames
  until the warning, its figure, share of pose errors below 12.59 (95 % of chi-squared with 6 degrees of freedom) with
  the covariance that goes out and with the one that takes the calibration for exact;
- `frontal`: the same, after ten oblique frames the target is seen from the front, where no frame tells anything;
- `noise`: 1000 frames with the right calibration: the largest focal length told in standard deviations, the mean
  squared misfit of a view (2 by chance), and warnings, of which there must be none;
- `drawn`: calibrations as `imgu calibrate` makes them of simulated views of a chessboard, each with its own
  covariance: the share of pose errors below 12.59, and warnings, of which there must be none.

Targets are `--data`'s photographs beside procedural textures: nothing here was chosen to suit them.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from imgu_ros.bench.figures import NEES_95
from imgu_ros.bench.machine import this_machine
from imgu_ros.config.parameters import Parameters
from imgu_ros.frame import Frame
from imgu_ros.image_files.images import read_image
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import CalibrationFinding, ReferenceResult
from imgu_ros.simulate.chessboard import random_chessboard_view
from imgu_ros.simulate.placing import Placing, camera_before_target
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import arrange_scene
from imgu_ros.simulate.sequence import TYPICAL_LENSES, default_camera
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.types import Floats
from imgu_ros.vision.camera.calibration import calibrate
from imgu_ros.vision.camera.camera_covariance import with_covariance
from imgu_ros.vision.camera.chessboard import Chessboard
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import log_so3
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor, expose

_LAYOUT = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
_PERIOD_NS, _LAP_FRAMES = 33_333_333, 119
ERRORS = (0.0, 0.01, -0.01, 0.03, -0.03, 0.05, -0.05)
BOARD, BOARD_VIEWS, CORNER_PX = Chessboard(9, 6, 0.025), 15, 0.1


@dataclass(frozen=True, slots=True)
class Sequence30:
    """One sequence with one calibration.

    `below` and `below_exact` are shares of poses below the 95 % point, with the covariance that goes out and with that
    of a calibration that is taken for exact.
    """

    print_name: str
    lens: str
    tilt_deg: float
    error_percent: float
    poses: int
    warned_after: int | None
    warning: str
    below: float
    median: float
    below_exact: float
    focal_percent: float


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A print before a camera: what renders it, and the frames' truth."""

    name: str
    renderer: Renderer
    target: TargetImage
    camera: Camera

    def frame(self, progress: float, placing: Placing, path: int, rng: np.random.Generator) -> Floats:
        """Return raw pixels."""
        light = self.renderer.radiance(self.pose(progress, placing, path)) * np.float32(0.9)
        return expose(light, Sensor(), rng)

    def pose(self, progress: float, placing: Placing, path: int) -> RigidTransform:
        """Return camera_from_scene."""
        return camera_before_target(progress, placing, self.camera, self.renderer.scene, path)

    def truth(self, progress: float, placing: Placing, path: int) -> RigidTransform:
        """Return camera_from_target."""
        return self.pose(progress, placing, path).after(self.renderer.scene.poses[0])


def prints(folder: Path, seed: int, count: int) -> Iterator[tuple[str, Floats]]:
    """Yield procedural textures and photographs in turn."""
    files = (
        sorted((folder / "kodak").glob("*.png"))[seed % 5 :: 5] + sorted((folder / "mcmaster").glob("*"))[seed % 4 :: 4]
    )
    order = np.random.default_rng(seed).permutation(len(files))
    for index in range(count):
        if index % 3 == 0 or not len(files):
            yield f"texture {seed + 100 * index}", procedural_texture(seed=seed + 100 * index)
        else:
            file = files[order[index % len(files)]]
            yield file.stem, read_image(file)


def made(name: str, pixels: Floats, lens: str) -> Made:
    """Put a print before a camera."""
    camera = default_camera(1280, 720, lens or "plumb_bob", TYPICAL_LENSES[lens] if lens else ())
    target = TargetImage("print", pixels, 0.5)
    return Made(name, Renderer(arrange_scene([target]), camera, _LAYOUT), target, camera)


def with_focal_error(camera: Camera, share: float) -> Camera:
    """Return a camera whose focal lengths are too long by a share."""
    K = camera.K.copy()
    K[0, 0] *= 1 + share
    K[1, 1] *= 1 + share
    return replace(camera, K=K)


def squared_error(pose: Pose, truth: RigidTransform, covariance: Floats) -> float:
    """Return the squared error in units of a covariance."""
    error = np.concatenate((truth.t - pose.t, log_so3(truth.R @ pose.R.T)))
    return float(error @ np.linalg.solve(covariance, error))


def own_covariance(pose: Pose) -> Floats:
    """Return the covariance without what comes from the calibration."""
    return pose.covariance if pose.shared is None else pose.covariance - pose.shared @ pose.shared.T


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a chain said of frames."""

    results: list[tuple[ReferenceResult, RigidTransform]]
    findings: list[CalibrationFinding | None]

    def squared(self) -> Floats:
        """Return the poses' squared errors."""
        return np.array([squared_error(r.pose, t, r.pose.covariance) for r, t in self.results if r.pose is not None])

    def squared_exact(self) -> Floats:
        """Return the same with the calibration taken for exact."""
        return np.array(
            [squared_error(r.pose, t, own_covariance(r.pose)) for r, t in self.results if r.pose is not None]
        )


def run(chain: Localizer, frames: Sequence[tuple[Floats, RigidTransform]], camera: Camera) -> Run:
    """Let a chain work on frames."""
    chain.reset()
    results, findings = [], []
    for index, (pixels, truth) in enumerate(frames):
        result = chain.process(Frame(RawImage(pixels, _LAYOUT), index * _PERIOD_NS, "camera", camera))
        results.append((result.first, truth))
        findings.append(result.calibration)
    return Run(results, findings)


def sequence(view: Made, placings: Sequence[Placing], path: int, first: int = 0) -> list[tuple[Floats, RigidTransform]]:
    """Return consecutive frames at 30 Hz."""
    frames = []
    for index, placing in enumerate(placings):
        progress = (first + index) / _LAP_FRAMES
        rng = np.random.default_rng([path, first + index, 0x15F])
        frames.append((view.frame(progress, placing, path, rng), view.truth(progress, placing, path)))
    return frames


def focal(folder: Path, seed: int, count: int, frames: int, frontal: bool) -> list[Sequence30]:
    """Measure wrong focal lengths."""
    found = []
    for index, (name, pixels) in enumerate(prints(folder, seed, count)):
        lens = ("", "plumb_bob")[index % 2]
        view = made(name, pixels, lens)
        rng = np.random.default_rng([seed, index])
        tilt, share = float(rng.uniform(20, 55)), float(rng.uniform(0.25, 0.5))
        placing = Placing(tilt_rad=math.radians(tilt), width_share=share)
        placings = [placing] * frames
        if frontal:
            placings = [placing] * 10 + [replace(placing, tilt_rad=math.radians(8))] * (frames - 10)
        shown = sequence(view, placings, seed + index)
        parameters = Parameters()
        chain = Localizer(parameters, prepare_references([view.target], parameters))
        for error in ERRORS:
            done = run(chain, shown, with_focal_error(view.camera, error))
            part = slice(10, None) if frontal else slice(None)
            done = replace(done, results=done.results[part])
            squared, exact = done.squared(), done.squared_exact()
            warned = next((i for i, f in enumerate(done.findings) if f is not None and f.warning), None)
            last = next((f for f in reversed(done.findings) if f is not None), None)
            one = Sequence30(
                name, lens or "none", round(tilt, 1), 100 * error, len(squared), warned,
                "" if warned is None else done.findings[warned].warning.partition(":")[0],  # type: ignore[union-attr]
                round(float((squared < NEES_95).mean()), 3), round(float(np.median(squared)), 2),
                round(float((exact < NEES_95).mean()), 3),
                0.0 if last is None else round(last.focal_percent, 2),
            )  # fmt: skip
            found.append(one)
            print(
                f"{name:>12} {one.lens:>9} {tilt:4.0f} deg {100 * error:+5.1f} %: warned after {warned}, told "
                f"{one.focal_percent:+.2f} %; below {one.below:.3f} (median {one.median:.2f}), calibration taken for "
                f"exact {one.below_exact:.3f}  {one.warning[:90]}",
                flush=True,
            )
    for error in ERRORS:
        rows = [row for row in found if row.error_percent == 100 * error]
        weights = [row.poses for row in rows]
        after = [row.warned_after for row in rows]
        below, exact = (
            np.average([getattr(r, key) for r in rows], weights=weights) for key in ("below", "below_exact")
        )
        print(
            f"{100 * error:+5.1f} %: warned {sum(a is not None for a in after)} of {len(rows)}, after at most "
            f"{max((a for a in after if a is not None), default=None)}; below {below:.3f}, exact {exact:.3f}"
        )
    return found


def noise(folder: Path, seed: int, frames: int) -> list[dict[str, object]]:
    """Measure right calibrations: 1000 frames in all tilts and distances, of one print after the other."""
    rows = []
    for lens in ("", "plumb_bob"):
        for name, pixels in prints(folder, seed, 3):
            view = made(name, pixels, lens)
            parameters = Parameters()
            chain = Localizer(parameters, prepare_references([view.target], parameters))
            worst, squared, warnings, inflated, errors = 0.0, [], 0, 0, []
            for index in range(frames // 3):
                lap, rng = index // _LAP_FRAMES, np.random.default_rng([seed, index, 0xA])
                turn = 2 * math.pi * index / _LAP_FRAMES
                placing = Placing(
                    tilt_rad=math.radians(30 - 28 * math.cos(turn + lap)), width_share=0.4 + 0.12 * math.sin(1.7 * turn)
                )
                pixels_now = view.frame(index / _LAP_FRAMES, placing, seed, rng)
                result = chain.process(Frame(RawImage(pixels_now, _LAYOUT), index * _PERIOD_NS, "camera", view.camera))
                target, said = result.first, result.calibration
                if target.calibration is not None:
                    squared.append(target.calibration.chi_squared)
                if target.pose is not None:
                    inflated += target.pose.shared is not None
                    truth = view.truth(index / _LAP_FRAMES, placing, seed)
                    errors.append(squared_error(target.pose, truth, target.pose.covariance))
                if said is not None:
                    warnings += bool(said.warning)
                    if said.views >= 3:
                        worst = max(worst, abs(said.focal_percent) / said.focal_sigma_percent)
            row = {
                "print": name, "lens": lens or "none", "frames": frames // 3, "frames_with_warning": warnings,
                "frames_inflated": inflated, "largest_focal_sigmas": round(worst, 2),
                "mean_chi_squared": round(float(np.mean(squared)), 2),
                "below": round(float((np.array(errors) < NEES_95).mean()), 3),
            }  # fmt: skip
            print(row, flush=True)
            rows.append(row)
    return rows


def drawn(folder: Path, seed: int, count: int, frames: int) -> dict[str, object]:
    """Measure calibrations as `imgu calibrate` makes them, each with its covariance."""
    squared, exact, warned, sigma = [], [], 0, []
    views: list[tuple[Made, list[tuple[Floats, RigidTransform]], Localizer]] = []
    for index, (name, pixels) in enumerate(prints(folder, seed + 7, 4)):
        view = made(name, pixels, "plumb_bob")
        rng = np.random.default_rng([seed, index, 3])
        shown = []
        for tilt in (5, 20, 35, 50):
            placing = Placing(tilt_rad=math.radians(tilt), width_share=float(rng.uniform(0.25, 0.5)))
            shown += sequence(view, [placing] * frames, seed + index, 30 * tilt)
        parameters = Parameters()
        views.append((view, shown, Localizer(parameters, prepare_references([view.target], parameters))))
    for index in range(count):
        view, shown, chain = views[index % len(views)]
        rng = np.random.default_rng([seed, index, 4])
        corners = [random_chessboard_view(BOARD, view.camera, rng).corners for _ in range(BOARD_VIEWS)]
        corners = [seen + rng.normal(0, CORNER_PX, seen.shape) for seen in corners]
        found = calibrate(BOARD.corners(), corners, view.camera.width, view.camera.height, "plumb_bob")
        sigma.append(100 * found.sigma[0] / found.camera.K[0, 0])
        done = run(chain, shown, with_covariance(found.camera, found.covariance))
        squared.append(done.squared())
        exact.append(done.squared_exact())
        warned += any(f is not None and f.warning for f in done.findings)
    all_of, all_exact = np.concatenate(squared), np.concatenate(exact)
    row = {
        "calibrations": count, "poses": len(all_of), "sigma_focal_percent": round(float(np.median(sigma)), 3),
        "below": round(float((all_of < NEES_95).mean()), 3), "median": round(float(np.median(all_of)), 2),
        "below_exact": round(float((all_exact < NEES_95).mean()), 3), "calibrations_with_warning": warned,
        "below_by_calibration": [round(float((s < NEES_95).mean()), 3) for s in squared],
    }  # fmt: skip
    print(row)
    return row


def main() -> None:
    """Measure the parts that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=("focal", "frontal", "noise", "drawn"), action="append", help="default: all")
    parser.add_argument("--prints", type=int, default=6)
    parser.add_argument(
        "--frames", type=int, default=0, help="default: 30 in a sequence, 1000 of `noise`, 4 of `drawn`"
    )
    parser.add_argument("--calibrations", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    parts = arguments.part or ["focal", "frontal", "noise", "drawn"]
    # Parts that are not measured anew stay in the file.
    old = json.loads(arguments.json.read_text()) if arguments.json and arguments.json.exists() else {}
    document: dict[str, object] = {**old, "machine": asdict(this_machine()), "seed": arguments.seed}
    for part in parts:
        if part in ("focal", "frontal"):
            rows = focal(arguments.data, arguments.seed, arguments.prints, arguments.frames or 30, part == "frontal")
            document[part] = [asdict(row) for row in rows]
        elif part == "noise":
            document[part] = noise(arguments.data, arguments.seed, arguments.frames or 1000)
        else:
            document[part] = drawn(arguments.data, arguments.seed, arguments.calibrations, arguments.frames or 4)
        if arguments.json:
            arguments.json.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
