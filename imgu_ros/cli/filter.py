# SPDX-License-Identifier: Apache-2.0
"""Smooth an image file, convolve it with any kernel, sharpen it, or find its edges.

mean, gaussian   smoothing
kernel           convolution with --kernel
detail           bands of a Laplacian pyramid times --gain, put together again
strength         length of the gradient, times --gain
direction        direction of the gradient as hue, its length times --gain as brightness
edges            white where the gradient is at least --threshold long
canny            edges one pixel wide, linked by two thresholds
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from imgu_ros.cli.options import PICTURE_LIMITS, add_parameter_options, parameters_of
from imgu_ros.cli.terminal import say, warn
from imgu_ros.errors import FileError, ParameterError

HELP = "smooth an image file, convolve it, or find its edges"

#: The options that each method knows.
METHODS: dict[str, tuple[str, ...]] = {
    "mean": ("size", "border"),
    "gaussian": ("sigma", "border"),
    "kernel": ("kernel", "border"),
    "detail": ("gain", "levels"),
    "strength": ("operator", "sigma", "gain", "border"),
    "direction": ("operator", "sigma", "gain", "border"),
    "edges": ("operator", "threshold", "overlay"),
    "canny": ("sigma", "low", "high", "overlay"),
}
# `vision.processing` has the same names; importing it would cost `--help` half a second.
BORDERS = ("reflected", "mirrored", "replicated", "periodic", "constant")
OPERATORS = ("sobel", "scharr", "gaussian")
_LARGEST_GAIN = 1000.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("input", type=Path, metavar="IN", help="image: PNM, PNG, TIFF or JPEG, of any depth")
    parser.add_argument("output", type=Path, metavar="OUT", help="image of the same size and depth")
    parser.add_argument("--method", choices=tuple(METHODS), required=True)
    add = parser.add_argument_group("options of the methods; grey values are those of the file").add_argument
    add("--size", type=int, metavar="PX", help="of `mean`: side of the square, odd; default: 3")
    add("--sigma", type=float, metavar="PX", help="of the Gaussian; default: 1")
    add("--kernel", type=kernel_of, metavar='"A B C; D E F; G H I"', help="weights, row by row; odd sides")
    add("--gain", type=float, metavar="G", help="default: 2 for `detail`, else 4")
    add("--levels", type=int, metavar="N", help="of `detail`: bands, an octave each; default: 3")
    add("--operator", choices=OPERATORS, help="derivative; default: sobel")
    add("--threshold", type=float, metavar="T", help="grey values per px; default: 10 %% of the range")
    add("--low", type=float, metavar="T", help="of `canny`: where an edge goes on; default: 2 %% of the range")
    add("--high", type=float, metavar="T", help="of `canny`: where an edge begins; default: 5 %% of the range")
    add("--overlay", action="store_true", default=None, help="edges in red over the picture")
    add("--border", choices=BORDERS, help="what stands outside the picture (constant: 0); default: reflected")
    add_parameter_options(parser, ("raw.grey_weights", *PICTURE_LIMITS))


def run(arguments: argparse.Namespace) -> int:
    """Read, filter, write."""
    parameters = parameters_of(arguments)
    given = _given(arguments)
    if arguments.method == "kernel" and "kernel" not in given:
        raise ParameterError('--kernel: none; need weights, such as --kernel "0 -1 0; -1 5 -1; 0 -1 0"')
    if not arguments.output.absolute().parent.is_dir():
        raise FileError(f"{arguments.output}: its folder does not exist; need a place that can be written")
    from imgu_ros.cli.filtering import FilterOptions, filtered
    from imgu_ros.image_files.images import check_image_file, read_image_file, write_image

    check_image_file(arguments.output)
    file = read_image_file(arguments.input, upright=True, limits=parameters.limits)
    image = file.pixels
    for note in file.notes:
        warn(f"{arguments.input}: {note}")
    if arguments.method == "kernel":
        from imgu_ros.cli.filtering import described_kernel

        say(*described_kernel(arguments.kernel).split("\n"))
    write_image(
        arguments.output,
        filtered(image, arguments.method, FilterOptions(**given), parameters.raw.grey_weights),
    )
    return 0


def kernel_of(text: str) -> tuple[tuple[float, ...], ...]:
    """Return the rows of a kernel, or of a matrix: `;` between rows, spaces or commas between numbers."""
    try:
        rows = tuple(tuple(float(number) for number in row.replace(",", " ").split()) for row in text.split(";"))
    except ValueError:
        rows = ()
    if not rows or not rows[0] or len({len(row) for row in rows}) != 1:
        raise argparse.ArgumentTypeError(f"{text!r}; need rows of equally many numbers, such as '1 2 1; 2 4 2; 1 2 1'")
    return rows


def _given(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options that are given; refuse those that the method does not know."""
    known = METHODS[arguments.method]
    every = {name for names in METHODS.values() for name in names}
    given = {name: getattr(arguments, name) for name in every if getattr(arguments, name) is not None}
    for name in sorted(given.keys() - set(known)):
        need = ", ".join(method for method, names in METHODS.items() if name in names)
        raise ParameterError(f"--{name}: given with --method {arguments.method}; need --method {need}")
    if "sigma" in given and "operator" in known and given.get("operator") != "gaussian":
        raise ParameterError(f"--sigma: {given['sigma']:g} without a Gaussian; need --operator gaussian")
    if not 0 <= given.get("gain", 0.0) <= _LARGEST_GAIN:
        raise ParameterError(f"--gain: {given['gain']:g}; need 0 to {_LARGEST_GAIN:g}")
    return given
