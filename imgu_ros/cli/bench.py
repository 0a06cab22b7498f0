# SPDX-License-Identifier: Apache-2.0
"""Measure this machine: the pipeline beside what people write with OpenCV (ORB and SIFT recipes), on the same frames.

Frames are simulated Bayer mosaics with exact truth. Every method sees each frame in turn, in one process, with the same
number of OpenCV threads; times are medians of a single frame, from Bayer to pose, on the wall clock and of all
processors together (cpu), which other processes disturb less; it says when they took too much of the machine. Suites:

  table       smooth sequences at several sizes: time, accuracy, memory (the default: a few minutes)
  tracking    a sequence under each condition: occlusion, blur, light, lenses, sizes, tilts, copies, look-alikes
  detection   unrelated single frames under each condition
  robustness  both
  negatives   frames without the target: what is found in them is false
  targets     3 targets in view, 3 and 100 known
  resolution  from 320x240 to 3840x2160
  length      memory over a long sequence
  all         all of them (hours with the default number of frames)
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.cli.terminal import say

if TYPE_CHECKING:
    from imgu_ros.bench.machine import Machine, ProcessorUse
    from imgu_ros.bench.suites import Options, Row
    from imgu_ros.replay.output_folder import RunFolder
    from imgu_ros.types import Image

HELP = "measure this machine: ours beside the usual OpenCV chains, on the same frames"

SUITES = ("table", "tracking", "detection", "robustness", "negatives", "targets", "resolution", "length", "all")
JSON, TABLE, PLOT = "bench.json", "bench.md", "bench.png"
_PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".ppm"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    # fmt: off
    add = parser.add_argument
    add("--suite", choices=SUITES, default="table", help="what is measured (default: %(default)s)")
    add("--sizes", type=_sizes, default=((640, 480), (1280, 720), (1920, 1080)), metavar="WxH[,WxH...]",
        help="of the frames (default 640x480,1280x720,1920x1080)")
    add("--frames", type=int, default=120, metavar="N",
        help="of each sequence, which goes once through its motion in 120; and as many single ones (default 120)")
    add("--seeds", type=_seeds, default=(0,), metavar="N[,N...]", help="one run for each (default 0)")
    add("--conditions", type=_words, default=(), metavar="NAME[,NAME...]",
        help="rows of tracking and detection (default: all)")
    add("--methods", type=_words, default=(), metavar="NAME[,NAME...]",
        help="of tracking, detection, ORB, SIFT (default: all that the suite compares)")
    add("--sift-every", type=int, default=4, metavar="N",
        help="show SIFT every n-th frame of a sequence only, for it takes most of the time (default 4)")
    add("--negatives", type=int, default=500, metavar="N", help="frames without a target (default 500)")
    add("--photographs", type=Path, metavar="DIR", action="append", default=[],
        help="folder of pictures that frames without a target show; may be repeated (default: textures)")
    add("--length-frames", type=int, default=2000, metavar="N", help="frames of the suite `length` (default 2000)")
    add("--out", type=Path, metavar="DIR", help=f"write {JSON}, {TABLE} and {PLOT} into DIR")
    add("--markdown", action="store_true", help="print the tables as Markdown")
    add_parameter_options(parser, without=("camera.info_file", "camera.covariance", "camera.rectified", "raw.encoding"))
    # fmt: on


def run(arguments: argparse.Namespace) -> int:
    """Measure, print the tables, write the files."""
    options = _options(arguments)
    from imgu_ros.bench.machine import processor_times, processor_use, this_machine
    from imgu_ros.bench.suites import check_options, run_suite
    from imgu_ros.bench.tables import tables
    from imgu_ros.cli.progress import Progress

    check_options(options)
    machine, begin = this_machine(), processor_times()
    rows: list[Row] = []
    use: ProcessorUse | None = None
    with _output_folder(arguments.out) as folder:
        with Progress("bench", "rows") as progress:
            for row in run_suite(arguments.suite, options):
                rows.append(row)
                progress(len(rows), None)
                now = processor_times()
                use = processor_use(begin, now) if begin and now else None
                if folder is not None:  # what is measured is kept, whatever happens to the rest
                    folder.renew()
                    _write_json(arguments, machine, use, rows)
        where = f"{machine.described()}\n{use.described() if use else 'what else the machine did is not known'}"
        say(*where.split("\n"), "", *tables(rows, markdown=arguments.markdown).split("\n"))
        if folder is not None:
            folder.renew()
            _write_rest(folder.path, where, rows)
            say("", f"{folder.path}: {', '.join(n for n in (JSON, TABLE, PLOT) if (folder.path / n).exists())}")
    return 0


def _options(arguments: argparse.Namespace) -> Options:
    parameters = parameters_of(arguments)
    from imgu_ros.bench.recipes import METHODS
    from imgu_ros.bench.suites import Options
    from imgu_ros.simulate.conditions import CONDITIONS, condition_named

    conditions = tuple(condition_named(name) for name in arguments.conditions) or CONDITIONS
    return Options(
        sizes=arguments.sizes,
        frames=arguments.frames,
        seeds=arguments.seeds,
        conditions=conditions,
        methods=arguments.methods or tuple(METHODS),
        sift_every=arguments.sift_every,
        negatives=arguments.negatives,
        photographs=tuple(picture for folder in arguments.photographs for picture in _photographs(folder)),
        length_frames=arguments.length_frames,
        parameters=parameters,
    )


def _photographs(folder: Path) -> tuple[Image, ...]:
    """Return the colour pictures of a folder, those of its folders too."""
    from imgu_ros.errors import FileError
    from imgu_ros.image_files.images import read_image

    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in _PICTURES)
    pictures = [read_image(path) for path in paths]
    pictures = [p for p in pictures if p.ndim == 3 and p.shape[2] == 3 and p.dtype.itemsize == 1]
    if not pictures:
        raise FileError(f"{folder}: no colour picture of 8 bits; need at least one")
    return tuple(pictures)


@contextlib.contextmanager
def _output_folder(out: Path | None) -> Iterator[RunFolder | None]:
    """Replace the files of an earlier measurement, nothing else."""
    if out is None:
        yield None
        return
    from imgu_ros.replay.output_folder import OutputFiles, output_folder

    with output_folder(out, OutputFiles("bench", (JSON, TABLE, PLOT), JSON), overwrite=True) as folder:
        yield folder


def _write_json(arguments: argparse.Namespace, machine: Machine, use: ProcessorUse | None, rows: list[Row]) -> None:
    from dataclasses import asdict

    from imgu_ros.file_access.text_files import write_text

    kinds = {"Figures": "figures", "PeakMemory": "memory", "Growth": "growth"}
    document: dict[str, object] = {
        "machine": asdict(machine),
        "processor_use": None if use is None else {**asdict(use), "quiet": use.quiet},
        "suite": arguments.suite,
        "frames": arguments.frames,
        "seeds": list(arguments.seeds),
        "sift_every": arguments.sift_every,
        "parameters_set": [text for _, text in arguments.overrides or ()],
    }
    for kind, name in kinds.items():
        document[name] = [asdict(row) for row in rows if type(row).__name__ == kind]
    write_text(arguments.out / JSON, json.dumps(document, indent=1, allow_nan=False) + "\n")


def _write_rest(out: Path, where: str, rows: list[Row]) -> None:
    from imgu_ros.bench.figures import Figures
    from imgu_ros.bench.plots import write_plot
    from imgu_ros.bench.tables import tables
    from imgu_ros.file_access.text_files import write_text

    write_text(out / TABLE, f"{where}\n\n{tables(rows, markdown=True)}\n")
    write_plot(out / PLOT, [row for row in rows if isinstance(row, Figures)])


def _sizes(text: str) -> tuple[tuple[int, int], ...]:
    return tuple(_size(part) for part in text.split(","))


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r}; need WIDTHxHEIGHT, such as 1280x720")
    return int(match[1]), int(match[2])


def _seeds(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; need whole numbers, separated by commas, such as 0,1,2") from None


def _words(text: str) -> tuple[str, ...]:
    return tuple(part for part in text.split(",") if part)
