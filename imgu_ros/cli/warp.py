# SPDX-License-Identifier: Apache-2.0
"""Resize, rotate or warp an image file.

With --size alone the picture is resized. --rotate and --scale turn and scale it about a point; --matrix maps it by any
affine or projective transformation, from pixels of IN to pixels of OUT, (0, 0) the centre of the top left one. OUT is
as large as IN, or as --size says, or with --whole as large as the warped picture is.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.filter import BORDERS, kernel_of
from imgu_ros.cli.match import INTERPOLATIONS
from imgu_ros.cli.options import PICTURE_LIMITS, add_parameter_options, parameters_of
from imgu_ros.cli.terminal import warn
from imgu_ros.errors import FileError, ParameterError

if TYPE_CHECKING:
    from imgu_ros.types import Image, Matrix3

HELP = "resize, rotate or warp an image file"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("input", type=Path, metavar="IN", help="image: PNM, PNG, TIFF or JPEG, of any depth")
    parser.add_argument("output", type=Path, metavar="OUT", help="image of the same depth")
    parser.add_argument("--rotate", type=float, metavar="DEG", help="clockwise")
    parser.add_argument("--scale", type=float, metavar="S", help="factor; default: 1")
    parser.add_argument("--about", type=_point, metavar="X,Y", help="px, the point that stays; default: the centre")
    parser.add_argument("--matrix", type=_matrix, metavar='"A B C; D E F; G H I"', help="or two rows: affine")
    parser.add_argument("--size", type=_size, metavar="WxH", help="of OUT, px")
    parser.add_argument("--whole", action="store_true", help="all of the warped picture, whatever its size")
    parser.add_argument(
        "--interpolation", choices=INTERPOLATIONS,
        help="default: linear; area, the mean over a pixel's area and the default there, when resizing only",
    )  # fmt: skip
    parser.add_argument("--border", choices=BORDERS, help="what stands outside IN (constant: 0); default: constant")
    add_parameter_options(parser, PICTURE_LIMITS)


def run(arguments: argparse.Namespace) -> int:
    """Read, warp, write."""
    _check(arguments)
    from imgu_ros.image_files.images import check_image_file, read_image_file, write_image

    check_image_file(arguments.output)
    file = read_image_file(arguments.input, upright=True, limits=parameters_of(arguments).limits)
    image = file.pixels
    for note in file.notes:
        warn(f"{arguments.input}: {note}")
    check_image_file(arguments.output, image)
    write_image(arguments.output, _resized(image, arguments) if _only_resizes(arguments) else _warped(image, arguments))
    return 0


def _resized(image: Image, arguments: argparse.Namespace) -> Image:
    from imgu_ros.vision.processing.interpolation import resized

    return resized(image, arguments.size, arguments.interpolation or "area")


def _warped(image: Image, arguments: argparse.Namespace) -> Image:
    from imgu_ros.vision.processing.warping import warped, whole_picture

    H, size = _transformation(image, arguments), arguments.size
    if arguments.whole:
        canvas = whole_picture(H, (image.shape[1], image.shape[0]))
        H, size = canvas.H, canvas.size
    return warped(image, H, size, arguments.interpolation or "linear", arguments.border or "constant")


def _transformation(image: Image, arguments: argparse.Namespace) -> Matrix3:
    import numpy as np

    from imgu_ros.vision.processing.warping import rotation_about

    if arguments.matrix is not None:
        rows = arguments.matrix if len(arguments.matrix) == 3 else (*arguments.matrix, (0.0, 0.0, 1.0))
        return np.array(rows)
    centre = ((image.shape[1] - 1) / 2, (image.shape[0] - 1) / 2)
    scale = 1.0 if arguments.scale is None else arguments.scale
    return rotation_about(math.radians(arguments.rotate or 0.0), arguments.about or centre, scale)


def _only_resizes(arguments: argparse.Namespace) -> bool:
    return arguments.rotate is None and arguments.scale is None and arguments.matrix is None


def _check(arguments: argparse.Namespace) -> None:
    """Refuse options that say nothing together."""
    turned = arguments.rotate is not None or arguments.scale is not None
    if not (turned or arguments.matrix or arguments.size):
        raise ParameterError("warp: nothing to do; need --size, --rotate, --scale or --matrix")
    if arguments.matrix and (turned or arguments.about):
        raise ParameterError("--matrix: together with --rotate, --scale or --about; need one or the other")
    if arguments.whole and arguments.size:
        raise ParameterError("--whole: together with --size; need one of the two")
    if _only_resizes(arguments):
        for name in ("about", "whole", "border"):
            if getattr(arguments, name):
                raise ParameterError(f"--{name}: given with --size alone; need --rotate, --scale or --matrix")
    elif arguments.interpolation == "area":
        raise ParameterError("--interpolation: area; need nearest, linear or cubic, or --size alone")
    if not arguments.output.absolute().parent.is_dir():
        raise FileError(f"{arguments.output}: its folder does not exist; need a place that can be written")


def _matrix(text: str) -> tuple[tuple[float, ...], ...]:
    rows = kernel_of(text)
    if len(rows) not in (2, 3) or len(rows[0]) != 3:
        raise argparse.ArgumentTypeError(f"{text!r}; need two or three rows of three numbers")
    return rows


def _point(text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; need two numbers X,Y") from None
    return x, y


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r}; need WIDTHxHEIGHT, such as 640x480")
    return int(width), int(height)
