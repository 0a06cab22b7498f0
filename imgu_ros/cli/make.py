# SPDX-License-Identifier: Apache-2.0
"""Write a PDF that prints a target at its exact size.

TARGET is an image file, a marker such as tag36h11:7, a board file such as board.yaml, or `random`: a texture made to be
found, whose picture is written beside the PDF. W is the width of the picture, or of a marker's black square, about
which a cell of white belongs to it; a board is as large as its file says, and scaled to W where that is given.
The page has cutting marks, a ruler to check the printer's scale, and what to enter as parameters. What is larger than
the paper is printed in tiles that overlap.

With --measure, TARGET is markers of one size on a rigid thing, such as tag36h11:0-4,7, and BAG a recording of it with a
calibrated camera: a board file is written that says where they are, with the first marker's frame as the thing's. Move
around it, so that each marker is often in view beside others.
"""

from __future__ import annotations

import argparse
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.options import PICTURE_LIMITS, add_parameter_options, parameters_of
from imgu_ros.cli.terminal import say, warn
from imgu_ros.errors import FileError, ParameterError

if TYPE_CHECKING:
    from imgu_ros.config.parameters import Parameters
    from imgu_ros.files.print_pages import PrintJob
    from imgu_ros.reference.marker import MarkerImage
    from imgu_ros.reference.marker_layout import PlacedMarker
    from imgu_ros.reference.templates import TargetImage

HELP = "write a PDF that prints a target at its exact size"

RANDOM = "random"
#: What a measurement uses; a print uses `PICTURE_LIMITS` alone.
_MEASURE_PARAMETERS = ("image_topic", "camera_info_topic", "camera", "raw", "demosaic", "pose", "limits")
_PAPERS = ("auto", "a4", "a3", "letter", "fit")
#: Longer side of a random texture, px: the finest of its shapes are then a hundredth of a print's width and less.
_RANDOM_PX = 1280
#: Shorter side of it, px.
_LEAST_PX = 16
_OVERLAP_MM = 10.0
_SMALLEST_M, _LARGEST_M = 1e-3, 100.0
#: Markers of one thing.
_MOST_MARKERS = 100
#: Squared residuals in units of the covariances from which on something is said.
_CONTRADICTING = 2.0
#: Prints of fewer px a mm show their pixels as steps.
_COARSE_PX_MM = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("target", metavar="TARGET", help="an image file, tag36h11:7, board.yaml, or random")
    parser.add_argument("--width-m", type=float, metavar="W", help="of the print, edge to edge; not needed for a board")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="a .pdf; with --measure a .yaml")
    parser.add_argument(
        "--paper", choices=_PAPERS,
        help="auto (default): A4 or A3, whichever it fits, else A4 in tiles; fit: one page of the size it needs",
    )  # fmt: skip
    parser.add_argument("--overlap-mm", type=float, metavar="MM", help="of tiles; default: 10")
    parser.add_argument(
        "--measure", nargs="+", type=Path, metavar="BAG", help="write where markers are on a thing, by a recording"
    )
    texture = parser.add_argument_group("of random")
    texture.add_argument("--height-m", type=float, metavar="H", help="default: three quarters of the width")
    texture.add_argument("--seed", type=int, metavar="N", help="another number, another texture; default: 0")
    add_parameter_options(parser, _MEASURE_PARAMETERS)


def run(arguments: argparse.Namespace) -> int:
    """Draw the pages, write them, and say what to do with them."""
    if arguments.measure:
        return _measure(arguments)
    arguments.used_parameters = PICTURE_LIMITS
    _check(arguments)
    from imgu_ros.file_access.atomic_files import write_whole
    from imgu_ros.files.print_pages import print_pages, tiles_of
    from imgu_ros.image_files.images import write_image

    out: Path = arguments.out
    if arguments.target == RANDOM:
        image, entry = _random(arguments), str(out.with_suffix(".png"))
    else:
        image, entry = _target(arguments, parameters_of(arguments)), arguments.target
    jobs = _jobs(image, entry, arguments.width_m)
    tiles = [tiles_of(job.size_mm, arguments.paper, arguments.overlap_mm) for job in jobs]
    content = print_pages(list(zip(jobs, tiles, strict=True)), arguments.overlap_mm)
    if arguments.target == RANDOM:
        _require_unused(Path(entry), image)
        write_image(Path(entry), image.pixels)
    write_whole(out, content)
    for job, own in zip(jobs, tiles, strict=True):
        density = image.pixels.shape[1] / job.size_mm[0]
        if not job.cells and density < _COARSE_PX_MM:
            warn(f"{entry}: {density:.2g} px a mm; its pixels will show as steps")
        page = " x ".join(f"{side:.4g}" for side in own[0].page_mm)
        pages = "a page" if len(own) == 1 else f"{len(own)} pages ({own[0].columns} x {own[0].rows} tiles)"
        say(f"{out}: {job.words[0]}; on {pages} of {page} mm")
    say("Print it at 100 %, not fitted to the page, and measure its ruler.")
    width = "" if _has_own_size(image) and arguments.width_m is None else f" -p targets.widths_m:={image.width_m:g}"
    say(f"parameters: -p targets.images:={entry}{width}")
    return 0


def _jobs(image: TargetImage, entry: str, width_m: float | None) -> list[PrintJob]:
    """Return what is printed of a target, and the words beside it: of a bundle each of its markers."""
    from imgu_ros.files.print_pages import PrintJob
    from imgu_ros.reference.bundle import BundleImage
    from imgu_ros.reference.marker import MarkerImage
    from imgu_ros.shown_text import shown

    if isinstance(image, BundleImage):
        return [
            _marker_job(part, f"size of {part.name} in the file", [f"targets.images: [{entry}]"])
            for part in image.parts
        ]
    width = "" if _has_own_size(image) and width_m is None else f"   targets.widths_m: [{image.width_m:g}]"
    if isinstance(image, MarkerImage):
        return [_marker_job(image, "width_m", [f"targets.images: [{shown(entry)}]{width}"])]
    width_mm = 1000 * image.width_m
    height_mm = width_mm * image.pixels.shape[0] / image.pixels.shape[1]
    said = (
        f"{image.name}: {width_mm:.4g} x {height_mm:.4g} mm, edge to edge",
        f"targets.images: [{shown(Path(entry).name)}]{width}",
    )
    return [PrintJob(image.pixels, (width_mm, height_mm), image.width_m, said)]


def _marker_job(image: MarkerImage, width_name: str, words: list[str]) -> PrintJob:
    from imgu_ros.files.print_pages import PrintJob
    from imgu_ros.reference.marker import BoardImage
    from imgu_ros.reference.marker_layout import CellBlock, MarkerLayout

    layout, cells = image.layout, list[CellBlock]()
    left, top, right, bottom = layout.box
    scale, margin = 1000 * image.width_m / (right - left), layout.margin
    if isinstance(layout, MarkerLayout):
        cells = [block.moved(left - margin, top + margin, scale) for block in layout.blocks]
    width_mm, height_mm = scale * (right - left), scale * (top - bottom)
    what = "what is black" if isinstance(image, BoardImage) else "the black square"
    size = f"{width_mm:.4g} x {height_mm:.4g} mm, outer edge to outer edge of {what}; leave the white about it"
    size_mm = width_mm + 2 * scale * margin, height_mm + 2 * scale * margin
    return PrintJob(image.pixels, size_mm, image.width_m, (f"{image.name}: {size}", *words), width_name, cells)


def _has_own_size(image: TargetImage) -> bool:
    """Whether its file says how large it is."""
    from imgu_ros.reference.bundle import BundleImage
    from imgu_ros.reference.marker import BoardImage

    return isinstance(image, BoardImage | BundleImage)


def _measure(arguments: argparse.Namespace) -> int:
    """Measure where markers are on a thing, write a board file, and say how well they are known."""
    import numpy as np

    from imgu_ros.cli.progress import Progress
    from imgu_ros.file_access.text_files import write_text
    from imgu_ros.files.board_file import BOARD_SUFFIXES, bundle_text
    from imgu_ros.reference.bundle import BundleMarker
    from imgu_ros.replay.bundle_recording import connections, measure_recording

    for name, value in (
        ("--height-m", arguments.height_m), ("--seed", arguments.seed), ("--paper", arguments.paper),
        ("--overlap-mm", arguments.overlap_mm),
    ):  # fmt: skip
        if value is not None:
            raise ParameterError(f"{name}: of a print; a measurement has none")
    if arguments.out.suffix.lower() not in BOARD_SUFFIXES:
        raise FileError(f"--out: {arguments.out}; need a name that ends with .yaml")
    if arguments.width_m is None or not _SMALLEST_M <= arguments.width_m <= _LARGEST_M:
        raise ParameterError("--width-m: need the width of the markers' black squares, 0.001 to 100 m")
    markers = _markers_of(arguments.target, arguments.width_m)
    with Progress("measure") as progress:
        measured = measure_recording(
            arguments.measure,
            markers,
            parameters_of(arguments),
            on_progress=progress,
            on_warning=lambda text: progress.say(f"imgu: warning: {text}"),
        )
    remarks, bundle = {}, []
    for marker, found in zip(markers, measured.markers.values(), strict=True):
        sigma = np.sqrt(found.place.covariance.diagonal())
        known = f"{1e3 * np.linalg.norm(sigma[:3]):.3f} mm, {np.degrees(np.linalg.norm(sigma[3:])):.3f} degrees"
        left_out = f", {found.left_out} left out" if found.left_out else ""
        uncertainty = "the origin" if marker is markers[0] else f"known to {known}"
        remarks[str(marker)] = (
            f"{marker}: {uncertainty}; {found.frames} poses{left_out}, residuals of {found.rms:.2f} standard deviations"
        )
        bundle.append(BundleMarker(marker, found.place))
    together = "; ".join(f"{a} and {b} {count}" for a, b, count in connections(measured) if count)
    head = [f"Measured in {measured.frames} frames. Frames that show two together: {together}."]
    if measured.scale > _CONTRADICTING:
        head.append(
            f"Poses contradict each other {measured.scale:.1f} times as much as their covariances say, by which the "
            "uncertainties are larger: the camera's calibration, the markers' size, or a thing that is not rigid."
        )
    write_text(arguments.out, bundle_text(bundle, remarks, head))
    say(*head, *remarks.values())
    say(f"parameters: -p targets.images:={arguments.out}")
    return 0


def _markers_of(text: str, size: float) -> list[PlacedMarker]:
    """Return the markers that `family:0,3,5-8` names."""
    from imgu_ros.reference.marker_layout import PlacedMarker
    from imgu_ros.vision.markers import marker_cells

    match = re.fullmatch(r"([A-Za-z]\w*):((?:\d{1,6}(?:-\d{1,6})?)(?:,\d{1,6}(?:-\d{1,6})?)*)", text, re.ASCII)
    if match is None:
        raise ParameterError(f"{text}: no markers; need family and ids, such as tag36h11:0,3,5-8")
    numbers: list[int] = []
    for part in match.group(2).split(","):
        first, _, last = part.partition("-")
        if int(last or first) - int(first) >= _MOST_MARKERS:
            raise ParameterError(f"{text}: more than {_MOST_MARKERS} markers; need those of one thing")
        numbers += range(int(first), int(last or first) + 1)
    if len(set(numbers)) < max(len(numbers), 2) or len(numbers) > _MOST_MARKERS:
        raise ParameterError(f"{text}: need 2 to {_MOST_MARKERS} different ids")
    for number in numbers:
        marker_cells(match.group(1), number)
    return [PlacedMarker(match.group(1), number, size) for number in numbers]


def _check(arguments: argparse.Namespace) -> None:
    from imgu_ros.files.board_file import BOARD_SUFFIXES

    arguments.paper = arguments.paper or "auto"
    arguments.overlap_mm = _OVERLAP_MM if arguments.overlap_mm is None else arguments.overlap_mm
    if arguments.out.suffix.lower() != ".pdf":
        raise FileError(f"--out: {arguments.out}; need a name that ends with .pdf")
    for name, value in (("--width-m", arguments.width_m), ("--height-m", arguments.height_m)):
        if value is not None and not _SMALLEST_M <= value <= _LARGEST_M:
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
    from imgu_ros.reference.family import FamilyImage

    targets = TargetsParameters(images=(arguments.target,), widths_m=(arguments.width_m or 0.0,))
    (image,) = load_target_images(targets, warn, limits=parameters.limits)
    if isinstance(image, FamilyImage):
        raise ParameterError(f"{arguments.target}: all ids of a family; need one, {image.family}:7")
    return image


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
