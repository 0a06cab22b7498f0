# SPDX-License-Identifier: Apache-2.0
"""Accuracy and covariance when channels differ in sensitivity, values follow a curve, or pixels are saturated.

    python benchmarks/camera_response.py --frames 25 --seeds 1,2,3,4,5,6 --json benchmarks/figures/camera_response.json

Single frames of the conditions of `imgu bench`, each with a pose and a noise of its own, pictures by seed. Every frame
is detected, then tracked a frame period later. The parameters are the defaults, and, where they differ, those that
`imgu simulate` writes beside such frames (gains, transfer function). All rows see the same poses, and light and noise
that differ by the condition alone.

Printed for every row: share that was detected or tracked, corner error p50 and p95 in px, squared error of the pose in
units of its covariance, p50 and mean (exact: 5.35 and 6), and the share of the poses inside the 95 % ellipsoid. The row
`camera` is all in one: sensitivities, the sRGB curve and 2 % saturated.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from imgu_ros.bench.machine import this_machine
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.replay.recording import raw_parameters
from imgu_ros.result import ReferenceResult, Status
from imgu_ros.simulate.capture import Capture
from imgu_ros.simulate.conditions import Condition, condition_named
from imgu_ros.simulate.scene import size_of
from imgu_ros.simulate.sequence import SimulatedFrame
from imgu_ros.simulate.trials import Trial, known_targets, trial_batches
from imgu_ros.simulate.truth import NEES_95, corner_error, normalised_squared_error
from imgu_ros.vision.formation.sensor import Sensor
from imgu_ros.vision.formation.transfer import TransferFunction

NAMES = (
    "plain", "no-white-balance", "transfer-srgb", "transfer-film", "saturated-2", "saturated-10", "saturated-30",
)  # fmt: skip
CAMERA = Condition(
    "camera",
    "sensitivities, sRGB curve, 2 % saturated",
    capture=Capture(saturated=0.02, sensitivities=(0.5, 1.0, 0.65), transfer=TransferFunction.SRGB),
)
_PERIOD_NS = 33_333_333


@dataclass(frozen=True)
class Row:
    """One condition with one set of parameters; shares of all frames, but `inside` of those with a pose."""

    condition: str
    parameters: str
    path: str
    frames: int
    found: float
    corner_p50_px: float | None
    corner_p95_px: float | None
    poses: int
    nees_p50: float | None
    nees_mean: float | None
    inside: float | None


def parameter_sets(condition: Condition) -> dict[str, Parameters]:
    """Return the defaults, and what matches the camera where that is something else."""
    matching = parameters_from(
        {f"raw.{key}": value for key, value in raw_parameters(Sensor(), condition.capture).items()}
    )
    uneven = matching.raw.transfer != "linear" or matching.raw.gains != Parameters().raw.gains
    return {"default": Parameters()} | ({"matching": matching} if uneven else {})


def measured(condition: Condition, size: tuple[int, int], frames: int, seeds: Sequence[int]) -> Iterator[Row]:
    """Measure one condition: two rows for each set of parameters."""
    sets = parameter_sets(condition)
    errors: dict[tuple[str, Status], list[tuple[float, float]]] = {
        (p, s): [] for p in sets for s in ("detected", "tracked")
    }
    for seed in seeds:
        trial = Trial(condition, *size, frames, seed, unrelated=True)
        (target,) = known_targets(trial)
        chains = {name: Localizer(p, prepare_references((target,), p)) for name, p in sets.items()}
        for simulated in (frame for batch in trial_batches(trial) for frame in batch):
            for name, chain in chains.items():
                chain.reset()
                again = replace(simulated.frame, stamp_ns=simulated.frame.stamp_ns + _PERIOD_NS)
                for path, frame in ((Status.DETECTED, simulated.frame), (Status.TRACKED, again)):
                    errors[name, path].append(errors_of(chain.process(frame).first, path, simulated, target))
    for (name, path), pairs in errors.items():
        yield row_of(condition.name, name, path, np.array(pairs))


def errors_of(
    result: ReferenceResult, path: Status, simulated: SimulatedFrame, target: TargetImage
) -> tuple[float, float]:
    """Return corner error, px, and normalised squared error; NaN where that path found nothing, or no pose."""
    (truth,) = simulated.truths
    pixels, camera = simulated.frame.image.pixels, simulated.frame.camera
    if result.status is not path or result.homography is None:
        return np.nan, np.nan
    corner = corner_error(result.homography.H, truth.H, size_of(target), (pixels.shape[1], pixels.shape[0]), camera)
    if result.pose is None or truth.pose is None:
        return corner, np.nan
    squared = normalised_squared_error(truth.pose, result.pose.transform, result.pose.covariance)
    return corner, np.nan if squared is None else squared


def row_of(condition: str, parameters: str, path: str, errors: np.ndarray) -> Row:
    """Return the figures of (N, 2) corner errors and squared errors."""
    corner, nees = (column[~np.isnan(column)] for column in errors.T)
    return Row(
        condition,
        parameters,
        path,
        len(errors),
        len(corner) / len(errors),
        float(np.median(corner)) if len(corner) else None,
        float(np.quantile(corner, 0.95)) if len(corner) else None,
        len(nees),
        float(np.median(nees)) if len(nees) else None,
        float(nees.mean()) if len(nees) else None,
        float((nees < NEES_95).mean()) if len(nees) else None,
    )


def printed(row: Row) -> str:
    """Return a line of the table."""
    line = f"{row.condition:17} {row.parameters:9} {row.path:9} {row.frames:6} {row.found:7.1%}"
    if row.corner_p50_px is not None and row.nees_p50 is not None:
        line += f" {row.corner_p50_px:7.4f} {row.corner_p95_px:7.4f} {row.nees_p50:6.2f} {row.nees_mean:7.2f}"
        line += f" {row.inside:7.1%}"
    return line


def main() -> None:
    """Measure all rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=25, help="of each seed (default 25)")
    parser.add_argument("--seeds", default="1,2,3,4,5,6", help="of pictures, poses and noise (default 1,2,3,4,5,6)")
    parser.add_argument("--size", default="1280x720", help="of the frames (default 1280x720)")
    parser.add_argument("--json", type=Path, help="write the figures to this JSON file")
    arguments = parser.parse_args()
    width, height = (int(part) for part in arguments.size.lower().split("x"))
    seeds = [int(part) for part in arguments.seeds.split(",")]
    rows: list[Row] = []
    print(this_machine().described())
    print(f"{'':37} frames   found     p50     p95   NEES    mean  inside", flush=True)
    for condition in (*map(condition_named, NAMES), CAMERA):
        for row in measured(condition, (width, height), arguments.frames, seeds):
            rows.append(row)
            print(printed(row), flush=True)
    if arguments.json:
        document = {
            "machine": asdict(this_machine()),
            "size": arguments.size,
            "seeds": seeds,
            "rows": [asdict(row) for row in rows],
        }
        arguments.json.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
