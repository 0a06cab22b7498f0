# SPDX-License-Identifier: Apache-2.0
"""Write a PDF that prints a target at its exact size.

TARGET is an image file, a marker such as tag36h11:7, a board file such as board.yaml, or `random`: a texture made to be
found, whose picture is written beside the PDF. W is the width of the picture, or of a marker's black square, about
which a cell of white belongs to it; a board is as large as its file says, and scaled to W where that is given.
The page has cutting marks, a ruler to check the printer's scale, and what to enter as parameters. What is larger than
the paper is printed in tiles that overlap.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.options import PICTURE_LIMITS, add_parameter_options, parameters_of
from imgu_ros.cli.terminal import say, warn
from imgu_ros.errors import FileError, ParameterError

if TYPE_CHECKING:
    from imgu_ros.config.parameters import Parameters
    from imgu_ros.files.print_pages import PrintJob
    from imgu_ros.reference.marker_layout import CellBlock
    from imgu_ros.reference.templates import TargetImage

HELP = "write a PDF that prints a target at its exact size"

RANDOM = "random"
_PAPERS = ("auto", "a4", "a3", "letter", "fit")
#: Longer side of a random texture, px: the finest of its shapes are then a hundredth of a print's width and less.
_RANDOM_PX = 1280
#: Shorter side of it, px.
_LEAST_PX = 16
#: Prints of fewer px a mm show their pixels as steps.
_COARSE_PX_MM = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("target", metavar="TARGET", help="an image file, tag36h11:7, board.yaml, or random")
    parser.add_argument("--width-m", type=float, metavar="W", help="of the print, edge to edge; not needed for a board")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.pdf")
    parser.add_argument(
        "--paper", choices=_PAPERS, default="auto",
        help="auto: A4 or A3, whichever it fits, else A4 in tiles; fit: one page of the size it needs",
    )  # fmt: skip
    parser.add_argument("--overlap-mm", type=float, default=10.0, metavar="MM", help="of tiles; default: 10")
    texture = parser.add_argument_group("of random")
    texture.add_argument("--height-m", type=float, metavar="H", help="default: three quarters of the width")
    texture.add_argument("--seed", type=int, metavar="N", help="another number, another texture; default: 0")
    add_parameter_options(parser, PICTURE_LIMITS)


def run(arguments: argparse.Namespace) -> int:
    """Draw the pages, write them, and say what to do with them."""
    _check(arguments)
    from imgu_ros.file_access.atomic_files import write_whole
    from imgu_ros.files.print_pages import print_pages, tiles_of
    from imgu_ros.image_files.images import write_image

    out: Path = arguments.out
    if arguments.target == RANDOM:
        image, entry = _random(arguments), str(out.with_suffix(".png"))
    else:
        image, entry = _target(arguments, parameters_of(arguments)), arguments.target
    job = _job(image, entry)
    tiles = tiles_of(job.size_mm, arguments.paper, arguments.overlap_mm)
    content = print_pages([(job, tiles)], arguments.overlap_mm)
    if arguments.target == RANDOM:
        _require_unused(Path(entry), image)
        write_image(Path(entry), image.pixels)
    write_whole(out, content)
    density = image.pixels.shape[1] / job.size_mm[0]
    if not job.cells and density < _COARSE_PX_MM:
        warn(f"{entry}: {density:.2g} px a mm; its pixels will show as steps")
    page = " x ".join(f"{side:.4g}" for side in tiles[0].page_mm)
    pages = "a page" if len(tiles) == 1 else f"{len(tiles)} pages ({tiles[0].columns} x {tiles[0].rows} tiles)"
    say(f"{out}: {job.words[0]}; on {pages} of {page} mm")
    say("Print it at 100 %, not fitted to the page, and measure its ruler.")
    say(f"parameters: -p targets.images:={entry}{_width_parameter(image, arguments.width_m)}")
    return 0


def _job(image: TargetImage, entry: str) -> PrintJob:
    """Return what is printed of a target, and the words beside it."""
    from imgu_ros.files.print_pages import PrintJob
    from imgu_ros.reference.marker import BoardImage, MarkerImage
    from imgu_ros.shown_text import shown

    width_mm = 1000 * image.width_m
    height_mm = width_mm * image.pixels.shape[0] / image.pixels.shape[1]
    cells: list[CellBlock] = []
    if isinstance(image, MarkerImage):
        layout = image.layout
        left, top, right, bottom = layout.box
        scale, margin = width_mm / (right - left), layout.margin
        cells = [block.moved(left - margin, top + margin, scale) for block in layout.blocks]
        size = f"{width_mm:.4g} x {scale * (top - bottom):.4g} mm, outer edge to outer edge of "
        size += (
            "what is black" if isinstance(image, BoardImage) else "the black square"
        ) + "; leave the white about it"
        width_mm, height_mm = (scale * (side + 2 * margin) for side in (right - left, top - bottom))
    else:
        size = f"{width_mm:.4g} x {height_mm:.4g} mm, edge to edge"
        entry = Path(entry).name
    parameters = f"targets.images: [{shown(entry)}]   targets.widths_m: [{image.width_m:g}]"
    words = f"{image.name}: {size}", parameters
    return PrintJob(image.pixels, (width_mm, height_mm), image.width_m, words, cells)


def _width_parameter(image: TargetImage, width_m: float | None) -> str:
    """Return the parameter that says the width; a board's file says its own."""
    from imgu_ros.reference.marker import BoardImage

    is_known = isinstance(image, BoardImage) and width_m is None
    return "" if is_known else f" -p targets.widths_m:={image.width_m:g}"


def _check(arguments: argparse.Namespace) -> None:
    from imgu_ros.files.board_file import BOARD_SUFFIXES

    if arguments.out.suffix.lower() != ".pdf":
        raise FileError(f"--out: {arguments.out}; need a name that ends with .pdf")
    for name, value in (("--width-m", arguments.width_m), ("--height-m", arguments.height_m)):
        if value is not None and not 1e-3 <= value <= 100:
            raise ParameterError(f"{name}: {value:g} m; need 0.001 to 100 m")
    if arguments.width_m is None and Path(arguments.target).suffix.lower() not in BOARD_SUFFIXES:
        raise ParameterError("--width-m: not given; need the width of the print in metres")
    if arguments.target != RANDOM and (arguments.height_m is not None or arguments.seed is not None):
        given = "--seed" if arguments.height_m is None else "--height-m"
        raise ParameterError(f"{given}: of the target {RANDOM} alone; {arguments.target} is another")
    if not math.isfinite(arguments.overlap_mm):
        raise ParameterError(f"--overlap-mm: {arguments.overlap_mm:g}; need a number")


def _target(arguments: argparse.Namespace, parameters: Parameters) -> TargetImage:
    """Return the target as the pipeline knows it: a picture is upright, and on white where it is transparent."""
    from imgu_ros.config.parameters import TargetsParameters
    from imgu_ros.files.target_images import load_target_images

    targets = TargetsParameters(images=(arguments.target,), widths_m=(arguments.width_m or 0.0,))
    return load_target_images(targets, warn, limits=parameters.limits)[0]


def _random(arguments: argparse.Namespace) -> TargetImage:
    from imgu_ros.reference.templates import TargetImage
    from imgu_ros.simulate.texture import procedural_texture

    height_m = 0.75 * arguments.width_m if arguments.height_m is None else arguments.height_m
    scale = _RANDOM_PX / max(arguments.width_m, height_m)
    width, height = (round(side * scale) for side in (arguments.width_m, height_m))
    if min(width, height) < _LEAST_PX:
        most = _RANDOM_PX // _LEAST_PX
        raise ParameterError(f"--height-m: {height_m:g} m; need sides that differ by a factor of at most {most}")
    pixels = procedural_texture(width, height, arguments.seed or 0)
    return TargetImage(arguments.out.stem, pixels, arguments.width_m)


def _require_unused(path: Path, image: TargetImage) -> None:
    """Refuse to replace a picture of somebody's by a random one."""
    import numpy as np

    from imgu_ros.image_files.images import read_image

    if path.exists() and not np.array_equal(read_image(path), image.pixels):
        raise FileError(f"{path}: is there and shows something else; need another name for --out")
