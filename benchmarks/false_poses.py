# SPDX-License-Identifier: Apache-2.0
"""Is anything found that is not there? Photographs, their warps, look-alikes; the known target is never in view.

    python benchmarks/false_poses.py --data ../shared/data --frames 10000 --json false_poses.json

Known targets are photographs and procedural pictures in turn, one at a time. Frames are Bayer mosaics of the other
photographs, from anywhere, with noise; before every third stands a picture that has the upper 30 % of the target and
nothing else of it. Every frame is worked on alone. Whatever is found is false; how much of the target the frame must
have shown for that (`confirmed_share`) is told of the nearest misses too.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2

from imgu_ros.bench.machine import this_machine
from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.config.parameters import Parameters
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.negatives import absent_frames
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.types import Image

#: Folders of the open data with photographs.
FOLDERS = ("kodak", "mcmaster")
_WIDTH_M = 0.5


@dataclass(frozen=True)
class Known:
    """A target that is not in view, and the photographs that are."""

    target: TargetImage
    photographs: tuple[Image, ...]


@dataclass(frozen=True)
class Counts:
    """What was found of one target in so many frames; `false_at` are the frames' numbers, of seed `seed`."""

    target: str
    seed: int
    frames: int
    false_at: tuple[int, ...]
    ms: float


def main() -> None:
    """Measure, print, and store."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="the open data")
    parser.add_argument("--frames", type=int, default=10_000, help="in all")
    parser.add_argument("--targets", type=int, default=20, help="how many, half of them photographs")
    parser.add_argument("--size", default="1280x720", help="of the frames")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="file for the figures")
    add_parameter_options(parser)
    args = parser.parse_args()
    parameters = parameters_of(args, {"tracking.enabled": False})
    width, height = (int(side) for side in args.size.split("x"))
    rows = []
    for number, known in enumerate(make_references(args.data, args.targets)):
        count = args.frames * (number + 1) // args.targets - args.frames * number // args.targets
        rows.append(counted(known, (width, height), count, args.seed + number, parameters))
        row = rows[-1]
        print(
            f"{row.target:20s} {row.frames:6d} frames  {len(row.false_at):4d} false  {row.ms:6.1f} ms a frame",
            flush=True,
        )
    found, frames = sum(len(row.false_at) for row in rows), sum(row.frames for row in rows)
    print(f"{'all':20s} {frames:6d} frames  {found:4d} false")
    if args.json:
        told = {"machine": asdict(this_machine()), "size": args.size, "frames": frames, "false": found}
        args.json.write_text(json.dumps({**told, "targets": [asdict(row) for row in rows]}, indent=1) + "\n")


def counted(known: Known, size: tuple[int, int], count: int, seed: int, parameters: Parameters) -> Counts:
    """Work on `count` frames that do not show the target."""
    chain = Localizer(parameters, prepare_references([known.target], parameters))
    chain.prepare()
    false_at: list[int] = []
    took = 0.0
    pixels = known.target.pixels
    for index, simulated in enumerate(absent_frames(known.photographs, pixels, size, count, seed)):
        start = time.perf_counter()
        result = chain.process(simulated.frame)
        took += time.perf_counter() - start
        if any(target.homography is not None for target in result):
            false_at.append(index)
    return Counts(known.target.name, seed, count, tuple(false_at), 1e3 * took / max(count, 1))


def make_references(data: Path, count: int) -> Iterator[Known]:
    """Yield photographs and procedural pictures in turn, each with the photographs that it is not."""
    files = sorted(path for folder in FOLDERS for path in (data / folder).iterdir())
    read = [(path.stem, cv2.imread(str(path), cv2.IMREAD_COLOR)) for path in files]
    photographs = {name: cv2.cvtColor(image, cv2.COLOR_BGR2RGB) for name, image in read if image is not None}
    names = list(photographs)
    for number in range(count):
        if number % 2:
            yield Known(
                TargetImage(f"procedural_{number}", procedural_texture(seed=1000 + number), _WIDTH_M),
                tuple(photographs.values()),
            )
            continue
        name = names[number // 2 * max(1, 2 * len(names) // max(count, 1)) % len(names)]
        others = tuple(image for other, image in photographs.items() if other != name)
        yield Known(TargetImage(name, photographs[name], _WIDTH_M), others)


if __name__ == "__main__":
    main()
