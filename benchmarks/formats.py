# SPDX-License-Identifier: Apache-2.0
"""Replay the same simulated scene from bags of every kind, and compare found frames and accuracy with 8-bit RGGB's.

    python benchmarks/formats.py --frames 60 --size 1280x720 --out formats.json

Kinds: the four Bayer phases, padded rows, 10, 12 and 16 bits in 16-bit encodings, big-endian, SQLite, zstd.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.values import parameters_from
from imgu_ros.replay.recording import PARAMETER_FILE, TRUTH_FILE, BagFormat, record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.vision.formation.sensor import Sensor


@dataclass(frozen=True)
class Kind:
    """One kind of bag."""

    name: str
    bag_format: BagFormat
    bits: int = 8


@dataclass(frozen=True)
class Figures:
    """What a replay gave; `ratio` compares the median corner error with the first kind's."""

    kind: str
    frames: int
    found: int
    corner_p50_px: float
    corner_p95_px: float
    ratio: float


KINDS = (
    Kind("rggb8", BagFormat("bayer_rggb8")),
    Kind("bggr8", BagFormat("bayer_bggr8")),
    Kind("grbg8", BagFormat("bayer_grbg8")),
    Kind("gbrg8", BagFormat("bayer_gbrg8")),
    Kind("rggb8, rows padded by 37 bytes", BagFormat("bayer_rggb8", row_padding=37)),
    Kind("rggb16, 10 bits", BagFormat("bayer_rggb16"), bits=10),
    Kind("rggb16, 12 bits", BagFormat("bayer_rggb16"), bits=12),
    Kind("rggb16, 16 bits", BagFormat("bayer_rggb16"), bits=16),
    Kind("rggb16, 12 bits, big-endian", BagFormat("bayer_rggb16", big_endian=True), bits=12),
    Kind("grbg16, 12 bits, padded, big-endian", BagFormat("bayer_grbg16", row_padding=6, big_endian=True), bits=12),
    Kind("rggb8, SQLite", BagFormat("bayer_rggb8", storage="sqlite3")),
    Kind("rggb8, MCAP, zstd", BagFormat("bayer_rggb8", compression="zstd")),
    Kind("rggb8, SQLite, zstd", BagFormat("bayer_rggb8", storage="sqlite3", compression="zstd")),
)


def measured(kind: Kind, size: tuple[int, int], frames: int, seed: int, auto_bits: bool) -> Figures:
    """Write a bag of this kind, replay it, and return the figures."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        simulation = Simulation(width=size[0], height=size[1], frames=frames, seed=seed, sensor=Sensor(bits=kind.bits))
        record_simulation(bag, simulation, kind.bag_format)
        values = read_parameter_file(bag / PARAMETER_FILE)
        if auto_bits:  # as a user who does not know how many bits his camera delivers
            values = {name: value for name, value in values.items() if not name.startswith("raw.")}
        summary = replay([bag], Path(folder) / "out", parameters_from(values), truth=bag / TRUTH_FILE)
        target = summary.targets[0]
        error = target.corner_error_px
        if error is None:
            raise SystemExit(f"{kind.name}: no frame was found")
        return Figures(kind.name, frames, target.found, error.p50, error.p95, 1.0)


def main() -> None:
    """Print the table; write it as JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="1280x720", help="WIDTHxHEIGHT")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--auto-bits", action="store_true", help="leave raw.* at its defaults")
    parser.add_argument("--out", type=Path, help="write the figures to this JSON file")
    arguments = parser.parse_args()
    width, height = (int(n) for n in arguments.size.split("x"))
    print(f"{'kind':38} {'found':>9} {'corner p50 / p95 px':>22} {'ratio':>6}")
    rows: list[Figures] = []
    for kind in KINDS:
        row = measured(kind, (width, height), arguments.frames, arguments.seed, arguments.auto_bits)
        first = rows[0].corner_p50_px if rows else row.corner_p50_px
        row = Figures(**{**asdict(row), "ratio": row.corner_p50_px / first})
        rows.append(row)
        accuracy = f"{row.corner_p50_px:.4f} / {row.corner_p95_px:.4f}"
        print(f"{row.kind:38} {row.found:4} / {row.frames:3} {accuracy:>22} {row.ratio:6.2f}", flush=True)
    if arguments.out:
        arguments.out.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


if __name__ == "__main__":
    main()
