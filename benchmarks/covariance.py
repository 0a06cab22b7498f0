# SPDX-License-Identifier: Apache-2.0
"""Is the pose's covariance honest? Independent simulated frames in nine bins of distance and tilt.

    python benchmarks/covariance.py --frames 200 --json benchmarks/covariance.json
    python benchmarks/covariance.py --path tracking

The error e = (t_true - t, log(R_true R^T)), as the covariance C is defined, gives e^T C^-1 e. When C is right that is
chi-squared with 6 degrees of freedom: 95 % of the frames lie below 12.59, half below 5.35. Every frame has a pose, a
noise and one of several pictures of its own; no frame follows from another. With `--path tracking` each is preceded by
one that shows the camera a thirtieth of a second before, in which the target is detected.

Printed for every bin: share below 12.59, median, share without a pose because both planar solutions fit, share found.
"""

from __future__ import annotations

import argparse
import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from imgu_ros.bench.machine import this_machine
from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import PoseStatus
from imgu_ros.simulate.placing import Placing, camera_before_target
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import arrange_scene
from imgu_ros.simulate.sequence import default_camera
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import NEES_95, NEES_MEDIAN
from imgu_ros.types import Floats
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import log_so3
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor, expose

#: Width of the target over the frame's, near to far, and tilt in degrees.
WIDTH_SHARES = ((0.55, 0.41), (0.41, 0.31), (0.31, 0.23))
TILTS = ((0.0, 20.0), (20.0, 40.0), (40.0, 60.0))
AXES = ("x", "y", "z", "rx", "ry", "rz")
#: Medians of chi-squared with 6 and with 3 degrees of freedom.
MEDIAN_3 = 2.366
_LAYOUT = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
_PERIOD_NS = 33_333_333
_LAP_FRAMES = 119
_BATCH = 24


@dataclass(frozen=True)
class Bin:
    """One bin; shares of all frames, but `below` of those with a pose.

    `spread` is the standard deviation of each axis' error in units of its own: 1 when it is right.
    """

    width_share: tuple[float, float]
    tilt_deg: tuple[float, float]
    frames: int
    found: float
    tracked: float
    ambiguous: float
    poses: int
    below: float | None
    median: float | None
    median_position: float | None
    median_rotation: float | None
    spread: dict[str, float]
    nees: list[float]


@dataclass(frozen=True)
class Setting:
    """What every bin is measured with."""

    camera: Camera
    renderers: list[Renderer]
    chains: list[Localizer]
    seed: int
    tracking: bool


def squared_errors(pose: Pose, truth: RigidTransform) -> tuple[Floats, Floats]:
    """Return (3,) e^T C^-1 e of the pose, of the position and of the rotation alone; and (6,) errors in sigmas."""
    error = np.concatenate((truth.t - pose.t, log_so3(truth.R @ pose.R.T)))
    C = pose.covariance
    parts = [slice(0, 6), slice(0, 3), slice(3, 6)]
    squared = np.array([error[p] @ np.linalg.solve(C[p, p], error[p]) for p in parts])
    return squared, error / np.sqrt(np.diag(C))


def frames_of(setting: Setting, width_share: tuple[float, float], tilt: tuple[float, float], index: int) -> list[Frame]:
    """Return the frame, after the one before it when tracking; see `view_of` for its truth."""
    renderer = setting.renderers[index % len(setting.renderers)]
    frames = []
    for before in (1, 0) if setting.tracking else (0,):
        pose = view_of(setting, width_share, tilt, index, before)
        rng = np.random.default_rng([setting.seed, index, before, *_key(width_share, tilt), 0x15E])
        pixels = expose(renderer.radiance(pose) * np.float32(0.9), Sensor(), rng)
        stamp = (2 * index + 1 - before) * _PERIOD_NS
        frames.append(Frame(RawImage(pixels, _LAYOUT), stamp, "camera", setting.camera))
    return frames


def view_of(
    setting: Setting, width_share: tuple[float, float], tilt: tuple[float, float], index: int, before: int = 0
) -> RigidTransform:
    """Return `camera_from_target` of frame `index` of a bin, or of that many frame periods before it."""
    rng = np.random.default_rng([setting.seed, index, *_key(width_share, tilt), 0xB14])
    far, near = sorted(width_share)
    share = math.exp(rng.uniform(math.log(far), math.log(near)))
    placing = Placing(tilt_rad=math.radians(rng.uniform(*tilt)), width_share=share)
    progress, seed = float(rng.random()), int(rng.integers(1 << 31))
    scene = setting.renderers[index % len(setting.renderers)].scene
    return camera_before_target(progress - before / _LAP_FRAMES, placing, setting.camera, scene, seed)


def measured(setting: Setting, width_share: tuple[float, float], tilt: tuple[float, float], count: int) -> Bin:
    """Measure one bin."""
    squared, sigmas = [], []
    found = tracked = ambiguous = 0
    with ThreadPoolExecutor(2) as pool:
        for first in range(0, count, _BATCH):
            indices = range(first, min(first + _BATCH, count))
            made = list(pool.map(lambda i: frames_of(setting, width_share, tilt, i), indices))
            for index, frames in zip(indices, made, strict=True):
                chain = setting.chains[index % len(setting.chains)]
                chain.reset()
                target = [chain.process(frame) for frame in frames][-1].first
                found += target.status.found
                tracked += target.status.value == "tracked"
                ambiguous += target.pose_status is PoseStatus.AMBIGUOUS
                if target.pose is not None:
                    s, z = squared_errors(target.pose, view_of(setting, width_share, tilt, index))
                    squared.append(s)
                    sigmas.append(z)
    table, z = np.array(squared).reshape(-1, 3), np.array(sigmas).reshape(-1, 6)
    medians = [float(m) for m in np.median(table, axis=0)] if len(table) else [None] * 3
    return Bin(
        width_share=width_share,
        tilt_deg=tilt,
        frames=count,
        found=found / count,
        tracked=tracked / count,
        ambiguous=ambiguous / count,
        poses=len(table),
        below=float((table[:, 0] < NEES_95).mean()) if len(table) else None,
        median=medians[0],
        median_position=medians[1],
        median_rotation=medians[2],
        spread={a: float(np.sqrt((z[:, i] ** 2).mean())) for i, a in enumerate(AXES)} if len(z) else {},
        nees=[round(float(n), 3) for n in table[:, 0]],
    )


def setting_of(arguments: argparse.Namespace, parameters: Parameters) -> Setting:
    """Prepare cameras, pictures and chains."""
    width, height = (int(part) for part in arguments.size.lower().split("x"))
    camera = default_camera(width, height)
    targets = [
        TargetImage("target", procedural_texture(seed=arguments.seed + 31 * i), 0.5) for i in range(arguments.pictures)
    ]
    tracking = arguments.path == "tracking"
    parameters = parameters_from({"tracking.enabled": tracking}, parameters)
    return Setting(
        camera,
        [Renderer(arrange_scene([t]), camera, _LAYOUT) for t in targets],
        [Localizer(parameters, prepare_references([t], parameters)) for t in targets],
        arguments.seed,
        tracking,
    )


def printed(bins: list[Bin], path: str) -> None:
    """Print the nine bins as a table."""
    print(f"{path}; exact: 95 % below {NEES_95}, median {NEES_MEDIAN} (position, rotation alone: {MEDIAN_3})")
    print(
        f"{'width':>9} {'tilt deg':>8} {'frames':>6} {'found':>6} {'tracked':>7} {'ambiguous':>9} {'below':>6} "
        f"{'median':>6} {'pos.':>5} {'rot.':>5}  rms error in sigmas ({' '.join(AXES)})"
    )
    for b in bins:
        line = f"{b.width_share[0]:.2f}-{b.width_share[1]:.2f} {b.tilt_deg[0]:4.0f}-{b.tilt_deg[1]:2.0f} {b.frames:7}"
        line += f" {b.found:6.1%} {b.tracked:7.1%} {b.ambiguous:9.1%}"
        if b.below is not None:
            line += f" {b.below:6.1%} {b.median:6.2f} {b.median_position:5.2f} {b.median_rotation:5.2f}  "
            line += " ".join(f"{s:.2f}" for s in b.spread.values())
        print(line)


def main() -> None:
    """Measure all bins."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=200, help="in each of the nine bins (default 200)")
    parser.add_argument("--size", default="1280x720", help="of the frames (default 1280x720)")
    parser.add_argument(
        "--path", choices=("detection", "tracking"), default="detection", help="which part of the pipeline"
    )
    parser.add_argument("--pictures", type=int, default=8, help="different targets (default 8)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the figures to this JSON file")
    add_parameter_options(parser)
    arguments = parser.parse_args()
    setting = setting_of(arguments, parameters_of(arguments))
    bins = [measured(setting, share, tilt, arguments.frames) for share in WIDTH_SHARES for tilt in TILTS]
    print(this_machine().described())
    printed(bins, f"{arguments.size}, {arguments.path}")
    if arguments.json:
        document = {
            "machine": asdict(this_machine()),
            "path": arguments.path,
            "size": arguments.size,
            "seed": arguments.seed,
            "bins": [asdict(b) for b in bins],
        }
        arguments.json.write_text(json.dumps(document, indent=1) + "\n")


def _key(width_share: tuple[float, float], tilt: tuple[float, float]) -> tuple[int, int]:
    return round(1000 * width_share[0]), round(10 * tilt[0])


if __name__ == "__main__":
    main()
