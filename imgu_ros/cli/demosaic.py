# SPDX-License-Identifier: Apache-2.0
"""Turn one raw or mosaicked image file (PGM, PNG, TIFF, or headerless) into a colour image of the same depth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from imgu_ros.cli.options import PICTURE_LIMITS, add_parameter_options, parameters_of
from imgu_ros.cli.terminal import warn
from imgu_ros.errors import FileError, ParameterError

if TYPE_CHECKING:
    from imgu_ros.config.parameters import Parameters
    from imgu_ros.types import Image

HELP = "turn a raw image file into a colour image"

_USED = ("demosaic.method", "raw.encoding", "raw.black_level", "raw.white_level", "raw.significant_bits", "raw.gains")
_DTYPES = {"uint8": "uint8", "uint16": "<u2", "uint16le": "<u2", "uint16be": ">u2"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from imgu_ros.config.parameters import declaration

    method = declaration("demosaic.method")
    parser.add_argument(
        "input", type=Path, metavar="IN", help="raw image: PGM, PNG or TIFF, 8 or 16 bit; or headerless"
    )
    parser.add_argument("output", type=Path, metavar="OUT", help="colour image: PPM, PNG or TIFF")
    parser.add_argument(
        "--pattern", choices=("rggb", "bggr", "grbg", "gbrg"), help="top-left 2x2 quad; needed without -p raw.encoding"
    )
    parser.add_argument("--method", choices=method.choices, help=f"default: {method.default}")
    levels = parser.add_argument_group("levels, applied to the raw values first")
    levels.add_argument("--black", type=float, metavar="N", help="raw value of no light")
    levels.add_argument("--white", type=float, metavar="N", help="raw value of full scale; default: the type's")
    levels.add_argument("--gains", type=_gains, metavar="R,G,B", help="white-balance gains")
    raw = parser.add_argument_group("headerless input, row by row without padding")
    raw.add_argument("--width", type=int, metavar="PX")
    raw.add_argument("--height", type=int, metavar="PX")
    raw.add_argument("--dtype", choices=tuple(_DTYPES), help="uint16 is little-endian")
    add_parameter_options(parser, (*_USED, *PICTURE_LIMITS))


def run(arguments: argparse.Namespace) -> int:
    """Read, develop, write."""
    parameters = _parameters(arguments)
    if not (arguments.pattern or parameters.raw.encoding):
        raise ParameterError("--pattern: none; need the mosaic's, such as --pattern rggb")
    raw = _read_raw(arguments, parameters)
    from imgu_ros.cli.picture_layout import picture_layout
    from imgu_ros.image_files.images import write_image
    from imgu_ros.vision.formation.demosaic import demosaic
    from imgu_ros.vision.formation.levels import with_levels

    pattern = picture_layout(arguments.input, raw, arguments.pattern, parameters.raw.encoding).pattern
    if pattern is None:
        raise ParameterError(f"raw.encoding: {parameters.raw.encoding}; need a Bayer encoding, such as bayer_rggb8")
    levels, top = parameters.raw, 2 ** (8 * raw.dtype.itemsize) - 1
    white = levels.white_level or (2.0**levels.significant_bits - 1 if levels.significant_bits else top)
    if not levels.black_level < white <= top:
        raise ParameterError(
            f"levels: black {levels.black_level:g}, white {white:g}; need black < white <= {top} ({raw.dtype})"
        )
    leveled = with_levels(raw, pattern, levels.black_level, white, levels.gains)
    write_image(arguments.output, demosaic(leveled, pattern, parameters.demosaic.method))
    return 0


def _parameters(arguments: argparse.Namespace) -> Parameters:
    """Return the parameters, with the short options over those of -p."""
    from imgu_ros.config.values import parameters_from

    short = {
        "demosaic.method": arguments.method,
        "raw.black_level": arguments.black,
        "raw.white_level": arguments.white,
        "raw.gains": arguments.gains,
    }
    given = {name: value for name, value in short.items() if value is not None}
    return parameters_from(given, parameters_of(arguments))


def _read_raw(arguments: argparse.Namespace, parameters: Parameters) -> Image:
    headerless = (arguments.width, arguments.height, arguments.dtype)
    if any(value is not None for value in headerless):
        if any(value is None for value in headerless):
            raise ParameterError("headerless input: got only some of --width, --height, --dtype; need all three")
        from imgu_ros.image_files.images import read_raw_image

        return read_raw_image(
            arguments.input, arguments.width, arguments.height, _DTYPES[arguments.dtype], limits=parameters.limits
        )
    from imgu_ros.image_files.images import read_image_file

    try:
        file = read_image_file(arguments.input, limits=parameters.limits)
    except FileError as error:
        if "not an image" not in str(error):
            raise
        raise FileError(f"{error}, or --width, --height and --dtype of a headerless file") from None
    raw = file.pixels
    for note in file.notes:
        warn(f"{arguments.input}: {note}")
    if raw.ndim != 2 or raw.dtype.name not in ("uint8", "uint16"):
        raise FileError(f"{arguments.input}: shape {raw.shape}, {raw.dtype}; need a one-channel 8- or 16-bit image")
    return raw


def _gains(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}; need three numbers R,G,B") from None
